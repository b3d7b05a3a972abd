"""The contract of shapes: intersection, surface frame, sampling for area lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f
from djpt.core.numeric import non_negative
from djpt.core.records import DirectionSample3f, PositionSample3f
from djpt.core.transforms import ScalarTransform4f, as_transform
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import name_of
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import AxisPool, ProjectedRay, SignedAxis
from djpt.shapes.mitsuba_api import ShapeQuestions

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Face", "Hit", "Shape", "Surface", "towards"]


@dataclass
class Surface:
    """A point on a surface."""

    p: Point3f
    n: Vector3f
    """Geometric normal."""
    sh_frame: Frame3f
    uv: Point2f
    dp_du: Vector3f
    dp_dv: Vector3f
    prim_uv: Point2f
    """Barycentric weights of a triangle's second and third corner; 0 on other shapes."""


@dataclass(frozen=True)
class Face:
    """A flat face: its normals and the direction of dp/du, along axes of the scene's pool."""

    normal: SignedAxis
    """The geometric normal, dp/du x dp/dv, which a mirroring transform reverses."""
    shading: SignedAxis
    """The shading normal: the local normal transformed, which stays on the outer side."""
    tangent: SignedAxis


@dataclass
class Hit:
    """The intersection of a ray with a shape; where `hit` is false, the other fields are unspecified."""

    hit: Bool
    t: Float
    number: UInt32
    """The scene-wide number of the face."""


MISSING_INTERIOR = (
    "has 'subsurface', so the shape needs an 'interior', a medium in which light is scattered; "
    "djpt.subsurface(base_color, radius, weight=0.5) gives both"
)
"""The message about a shape that light enters, and whose BSDF expects a medium inside."""


class Shape(ShapeQuestions):
    """A surface that rays can hit; may carry a BSDF and an area light.

    Parameters of all shapes: `to_world` (default identity), `flip_normals` (default false), `bsdf`, `emitter`,
    `sensor`, the media `interior` and `exterior`, `priority` (a number; default: none, which counts as 0 where bodies
    overlap, see `djpt.geometry.overlapping`), and `silhouette_sampling_weight` (at least 0, default 1).

    Two kinds of methods read a shape's `values`: `intersect` is unrolled per instance, on
    opaque values; `surface`, `sample_position` and the like are traced once per class, with
    values looked up per lane (see `djpt.dispatch.ensemble`).
    """

    kind: ClassVar[str] = "shape"
    sides: ClassVar[int] = 1
    """The number of faces that `intersect` distinguishes."""
    closed: ClassVar[bool] = False
    """Whether shapes of this class enclose a volume: see `is_closed`."""
    has_area: ClassVar[bool] = True
    """Whether the area is known, so that points can be sampled uniformly; else only directions are."""
    has_parameterization: ClassVar[bool] = False
    """Whether each (u, v) of the unit square belongs to one point, so that `at_uv` exists."""
    canonical: ClassVar[str | None] = None
    """The name in `djpt.geometry.canonical` of the shape that `to_world` maps to this one; None if there is none."""
    of_triangles: ClassVar[bool] = False
    """Whether the shape is a mesh, whose triangles stand in the scene's BVH."""
    one_sided: ClassVar[bool] = False
    """Of meshes: whether rays that come from behind pass through."""
    faces_per_primitive: int = 1
    """Of meshes: how many triangles have one number in `SurfaceInteraction3f.prim_index`."""
    in_pieces: ClassVar[bool] = False
    """Whether the shape consists of many pieces, which stand in the BVH: see `djpt.geometry.curve_segments`."""
    area: Float
    """The total area in world space, of shapes that have this value."""

    priority: float | None = None
    """The priority of the body that the surface bounds, where bodies overlap; None, which counts as 0, if not given."""
    deforms: bool = False
    """Of meshes: whether the vertices move, see `djpt.shapes.deforming`."""
    in_group: bool = False
    """Whether the shape belongs to a `shapegroup`: it is visible through instances only, and has no derivatives."""
    _axes: Any = None
    """The axes that `place` found last in the pool of its scene; None at first, and for shapes without any."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self._bsdf = props.child("bsdf")
        self._emitter = props.child("emitter")
        self._sensor = props.child("sensor")
        self._interior = props.plugin("interior", "medium", None)
        self._exterior = props.plugin("exterior", "medium", None)
        if self._bsdf is not None and self._bsdf.needs_interior and self._interior is None:
            raise props.error("bsdf", MISSING_INTERIOR)
        if "priority" in props:
            self.priority = props.float("priority")
        self.take_textures(props)
        self.flip_normals = props.boolean("flip_normals", False)
        self.silhouette_weight = props.float("silhouette_sampling_weight", 1.0, low=0.0)
        self.motion = props.animation("to_world")
        self.to_world = props.transform("to_world")
        if self.motion is not None:
            with props.naming("to_world"):
                self.check_motion()

    # ---- parameters -------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        for name, nested in (("bsdf", self._bsdf), ("emitter", self._emitter), ("sensor", self._sensor)):
            if nested is not None:
                callback.put(name, nested)
        callback.put("silhouette_sampling_weight", self.silhouette_weight, attribute="silhouette_weight")
        for name, medium in (("interior_medium", self._interior), ("exterior_medium", self._exterior)):
            if medium is not None:
                callback.put(name, medium)
        self.traverse_geometry(callback)
        if self.motion is not None:
            callback.put("to_world", self.motion)
        self.report_textures(callback)

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        """Report the parameters that place the shape, beside the animated transform of one that moves.

        By default it is `to_world`.
        """
        if self.motion is None:
            callback.put("to_world", self.to_world, self.motion_flags())

    @property
    def moves(self) -> bool:
        """Whether rays of different times see it in different places."""
        return self.motion is not None or self.deforms

    @property
    def own_bsdf(self) -> Any:
        """The BSDF of the description; None if it has none."""
        return self._bsdf

    def check_motion(self) -> None:
        """Raise `SceneError` if the shape can't be moved by its animation."""
        if self.in_pieces:
            raise SceneError("can't move curves and ellipsoids: nest them in a 'shapegroup' and animate an instance")
        if self._interior is not None or self._exterior is not None or self.priority is not None:
            raise SceneError("can't move a shape that bounds a medium or has a priority")
        self.motion.demand("unmirrored", "must not mirror a shape: mirror what moves")
        if self._emitter is not None:
            self.motion.demand("similar", "must scale uniformly: the shape emits light")
        if self._sensor is not None:
            self.motion.demand("similar", "must scale uniformly: the shape carries a sensor")
        if self.misfit(np.diag([1.0, 2.0, 3.0, 1.0])):
            self.motion.demand("similar", f"must scale uniformly: the shape is a '{name_of(type(self))}'")

    def motion_flags(self) -> ParamFlags:
        """The flags of a parameter that places the shape: there are derivatives if its silhouettes are followed."""
        followed = self.can_be_followed()
        return ParamFlags.Discontinuous | (ParamFlags.Differentiable if followed else ParamFlags.NonDifferentiable)

    def can_be_followed(self) -> bool:
        """Whether there are derivatives by the place of the shape: its silhouettes are known, and it has one place."""
        return self.silhouette_discontinuity_types() != 0 and not self.in_group

    def check_parameter(self, name: str, value: Any) -> Any:
        if dr.grad_enabled(value):
            return self.attached_parameter(name, value)
        if name == "silhouette_sampling_weight":
            return non_negative(value)
        if name != "to_world":
            return value
        transform = as_transform(value)
        if problem := self.misfit(transform.matrix):
            raise ParameterError(f"{self.id()}.to_world: {problem}")
        return transform

    def misfit(self, matrix: NDArray[np.float64]) -> str | None:
        """Why the shape can't be mapped by a matrix; None if it can."""
        return None

    def stretch(self, local: ScalarTransform4f, node: str) -> None:
        """Append `local` to the `to_world` of the description: it is applied first."""
        self.to_world = self.to_world @ local
        if problem := self.misfit(self.to_world.matrix):
            raise SceneError(f"{node}: {problem}")

    def attached_parameter(self, name: str, value: Any) -> Any:
        """The form in which a parameter with gradients is kept.

        Raises:
            ParameterError: there are no gradients with respect to this parameter.
        """
        from djpt.core.transforms.lanes import Transform4f
        from djpt.shapes.silhouettes.moving import AttachedTransform

        if name != "to_world" or not self.can_be_followed():
            raise ParameterError(f"{self.id()}.{name}: gradients with respect to this parameter aren't available")
        transform = AttachedTransform(Transform4f(value))
        as_transform(transform)  # raises if it can't be used
        return transform

    def stand_alone(self) -> None:
        self.place(AxisPool())
        self.bsdf()  # reported by `traverse`
        for nested in (self._emitter, self._sensor):
            if nested is not None and nested.shape is None:
                nested.set_shape(self)

    # ---- working frames ----------------------------------------------------------

    def move_into(self, frame: Frame) -> None:
        """By default the `to_world` moves, which places the shape and all its lengths."""
        self.leave()
        self.move_nested(frame)
        self.to_world = frame.moved(self.to_world)

    def move_nested(self, frame: Frame) -> None:
        self._bsdf = frame.copy_of(self.bsdf())
        self._emitter, self._sensor = frame.copy_of(self._emitter), frame.copy_of(self._sensor)
        self._interior, self._exterior = frame.copy_of(self._interior), frame.copy_of(self._exterior)
        for nested in (self._emitter, self._sensor):
            if nested is not None:
                nested.shape = self

    def leave(self) -> None:
        """Forget the original's scene, in a copy that is made for another one."""
        self.forget_alone()
        self._axes = None

    # ---- on the host: where the shape is -----------------------------------------

    def place(self, pool: AxisPool) -> None:
        """Compute the values that kernels read, and find the axes; called again after each edit. By default nothing."""

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        """The smallest and largest coordinate of the shape's points along `direction`."""
        raise NotImplementedError

    def world_box(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The corners of the axis-aligned box around the shape in world space, (3,) each; infinite for planes."""
        low, high = np.array([self.interval(unit) for unit in np.eye(3)], np.float64).T
        return low, high

    def plane(self) -> tuple[NDArray[np.float64], float] | None:
        """(normal, offset) if the whole shape lies in one plane, else None."""
        return None

    def is_closed(self) -> bool:
        """Whether the shape encloses a volume, so that crossing its surface means going in or out."""
        return self.closed

    def faces(self) -> Sequence[Face]:
        """The frames of the faces; empty for curved shapes, which compute theirs in `surface`."""
        return ()

    # ---- in kernels, unrolled per instance ---------------------------------------

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        """The closest intersection with 0 < t < maxt; `numbers[k]` is the scene-wide number of face k."""
        raise NotImplementedError

    def occludes(self, ray: ProjectedRay, numbers: Sequence[int]) -> Bool:
        """Whether there is any intersection with 0 < t < maxt."""
        return self.intersect(ray, ray.ray.maxt, numbers).hit

    # ---- in kernels, once per class ----------------------------------------------

    def normal_at(self, p: Point3f) -> Vector3f:
        """The unit normal at a surface point; for curved shapes."""
        raise NotImplementedError

    def tangent_at(self, p: Point3f) -> Vector3f:
        """The unit direction of dp/du at a surface point, perpendicular to the normal; for curved shapes."""
        raise NotImplementedError

    def frame_at(self, p: Point3f, d: Vector3f | None = None) -> tuple[Vector3f, Frame3f]:
        """The geometric normal and the shading frame of a curved shape at a surface point.

        Of a shape that shines the ray's direction `d` is given as well: densities divide by the cosine (see `tilted`).
        """
        n, s = self.normal_at(p), self.tangent_at(p)
        if d is not None:
            n = tilted(n, d)
        return n, Frame3f(s, dr.cross(n, s), n)

    def surface_area(self) -> Float:
        """The total area in world space; by default the value `area`. Raises `SceneError` if it isn't known."""
        area: Float | None = getattr(self, "area", None)
        if area is None:
            raise SceneError(f"{self.id()}: the area of this shape isn't known")
        return area

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        """Sample a point uniformly by area: pdf = 1 / area. Raises `SceneError` if the shape has no way to."""
        raise SceneError(f"{self.id()}: points of this shape aren't sampled")

    def at_uv(self, uv: Point2f) -> PositionSample3f:
        """The point with the texture coordinates (u, v) in the unit square, if the shape `has_parameterization`.

        `pdf` is the density per unit area of points whose uv are uniform: 1 / norm(dp/du x dp/dv), or 0
        where that is infinite.
        """
        raise NotImplementedError

    def draw_direction(self, ref: Point3f, sample: Point2f) -> DirectionSample3f:
        """Sample a point of the shape as seen from `ref`; by default with `draw_point`.

        pdf = dist^2 / (area abs(cos)), the area density converted to solid angle at `ref`.
        """
        return towards(self.draw_point(sample), self.surface_area(), ref)

    def direction_density(self, ref: Point3f, ds: DirectionSample3f) -> Float:
        """The density of `draw_direction` at `ds`, per unit solid angle at `ref`."""
        pdf = dr.square(ds.dist) * dr.rcp(dr.abs(dr.dot(ds.d, ds.n)) * self.surface_area())
        return dr.select(dr.isfinite(pdf), pdf, 0)

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        """The texture coordinates and dp/du, dp/dv at a point of the surface."""
        raise NotImplementedError

    def triangle(self, face: UInt32, uv: Point2f) -> UInt32:
        """Mitsuba's number of the primitive at a point; 0 for shapes of a single primitive."""
        return UInt32(0)


GRAZING = 2**-12
"""The least cosine between a ray and a curved surface that single precision can resolve."""


def tilted(n: Vector3f, d: Vector3f) -> Vector3f:
    """The normal of a curved surface where a ray along `d` hits it, turned until abs(cos) is at least `GRAZING`.

    Where a ray grazes a sphere, the discriminant R^2 cos^2 of its hit is a difference of numbers near R^2: float32
    gives 0 or at least 2^-24 R^2. If it is 0, the hit lies where the ray is closest to the centre, and the cosine there
    is a rounding error, thousands of times too small; so densities by area, which divide by it, would be as many times
    too large. To turn the normal by 2^-12 is to move the hit along the ray within the rounding of its place.
    """
    cos = dr.dot(n, d)
    turn = dr.select(dr.abs(cos) < GRAZING, dr.mulsign(Float(GRAZING), cos) - cos, 0)
    return dr.fma(d, turn, n)


def towards(ps: PositionSample3f, inverse_pdf: Float, ref: Point3f) -> DirectionSample3f:
    """Turn a point sampled on a surface into a direction sample at `ref`; `inverse_pdf` is 1 / (density per unit area).

    pdf = dist^2 / (inverse_pdf abs(cos)), per unit solid angle at `ref`.
    """
    to_p = ps.p - ref
    dist_squared = dr.squared_norm(to_p)
    inv_dist = dr.rsqrt(dist_squared)
    # Where the points coincide, any direction will do.
    d = dr.select(dist_squared > 0, to_p * inv_dist, ps.n)
    weight = dr.abs(dr.dot(d, ps.n)) * dr.square(inv_dist) * inverse_pdf
    ok = (weight > 0) & (dist_squared > 0)
    return DirectionSample3f.of(
        ps.p,
        ps.n,
        ps.uv,
        d,
        dist_squared * inv_dist,
        dr.select(ok, dr.rcp(weight), 0),
        dr.select(ok, weight, 0),
        Bool(False),
        UInt32(0),
    )

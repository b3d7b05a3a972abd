"""Points that light is sampled for, points on surfaces and in media, and the hits of rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records.rays import Ray3f
from djpt.core.records.record import (
    Record,
    SceneRef,
    assignable,
    latest_scene_ref,
    no_wavelengths,
    of_scene,
    only,
    optional,
    scene_of,
)
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector2f, Vector3f

__all__ = [
    "GRAZING",
    "RAY_EPSILON",
    "SHADOW_EPSILON",
    "Interaction3f",
    "MediumInteraction3f",
    "Observer",
    "PreliminaryIntersection3f",
    "Reference",
    "SceneView",
    "SurfaceInteraction3f",
]

RAY_EPSILON = 1500 * 2.0**-24
"""Offset of a spawned ray along the normal, relative to 1 + the largest coordinate (Mitsuba's value)."""

SHADOW_EPSILON = 10 * RAY_EPSILON
"""A shadow ray stops short of the light by this fraction of its length."""

GRAZING = 1e-3
"""The cosine at a surface below which points on it count as fixed when images are differentiated.

It is that of a millionth of a ball's picture. How far hits slide grows like the inverse cosine, and rounding decides
about the last digits of so small ones.
"""


@dataclass
class Reference:
    """A point that light is sampled for."""

    p: Point3f
    n: Vector3f | None
    """The geometric normal of the surface there, of either sign; None if the choice of emitters doesn't look at it."""


class Clock:
    """What is known about the time of a point while it runs through loops: that it is 0 in all lanes, or nothing.

    All clocks are equal. So Dr.Jit mixes points of both kinds; it keeps the clock of the first argument of a select,
    and that of the state that a loop begins with.
    """

    def __init__(self, at_zero: bool) -> None:
        self.at_zero = at_zero

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Clock)

    def __hash__(self) -> int:
        return hash(Clock)


class Interaction3f(Record):
    """A point of a ray: ``Interaction3f()``, ``Interaction3f(it)``, ``Interaction3f(t, time, wavelengths, p, n=0)``."""

    title = "Interaction"

    t: Float
    """Distance along the ray, in units of its `d`; infinity if there is no such point."""
    time: Float
    clock: dict[Clock, tuple[()]]
    """Whether the time is known to be 0; behind `time`, which resets it."""
    p: Point3f
    n: Normal3f
    """Geometric normal; 0 if there is no surface."""

    def __init__(
        self, t: Any = None, time: Any = None, wavelengths: Any = None, p: Any = None, n: Any = None, **fields: Any
    ) -> None:
        no_wavelengths(wavelengths)
        if isinstance(t, Interaction3f):
            self.assign(t)
            t = None
        given = {"t": t, "time": time, "p": p, "n": n, **fields}
        super().__init__(None, **{name: value for name, value in given.items() if value is not None})

    def default(self, name: str) -> Any:
        if name == "clock":
            return {Clock(False): ()}
        return Float(dr.inf) if name == "t" else super().default(name)

    def zero_(self, size: int = 1) -> None:
        """Complete `dr.zeros`: no interaction, at infinity."""
        self.fill_with_zeros(size)
        self.t = dr.full(Float, dr.inf, size)

    def is_valid(self) -> Bool:
        """True where there is a point: `t` is finite."""
        known = self.__dict__.get("_valid")
        return self.t < dr.inf if known is None else known

    def found_at(self, t: Float, valid: Bool) -> None:
        """Set `t`, and what `is_valid` returns, so that kernels needn't find out again."""
        self.t = t
        self.__dict__["_valid"] = valid

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "t":
            self.__dict__.pop("_valid", None)
        if name == "time":
            self.__dict__.pop("clock", None)
        super().__setattr__(name, value)

    def arrived_with(self, ray: Ray3f) -> None:
        """Take over the time of a ray; rays that leave have none if it has none, also in later turns of a loop."""
        if ray.times:
            self.time = ray.time
        else:
            self.clock = {Clock(True): ()}

    def offset_p(self, d: Vector3f) -> Point3f:
        """The point moved off the surface, to the side that `d` points to.

        The step is RAY_EPSILON (1 + max abs(p)) along the geometric normal, as in Mitsuba.
        """
        a = dr.abs(self.p)
        largest = dr.select(a.x > a.y, a.x, a.y)
        largest = dr.select(largest > a.z, largest, a.z)
        step = dr.fma(largest, RAY_EPSILON, RAY_EPSILON)
        return dr.fma(self.n, dr.mulsign(step, dr.dot(self.n, d)), self.p)

    def spawn_ray(self, d: Vector3f) -> Ray3f:
        """An unbounded ray that leaves the surface in direction `d`."""
        return self._along(self.offset_p(d), d, Float(dr.inf), d)

    def spawn_ray_to(self, t: Point3f) -> Ray3f:
        """The segment to the point `t`: `d` is not normalised, `maxt` is just short of 1."""
        o = self.offset_p(t - self.p)
        return self._along(o, t - o, Float(1 - SHADOW_EPSILON), t - self.p)

    def _along(self, o: Point3f, d: Vector3f, maxt: Float, leaving: Vector3f) -> Ray3f:
        """A ray with the time of the interaction, in the medium on the side that `leaving` points to."""
        ray = Ray3f(o, d, maxt=maxt, medium=self.medium_beyond(leaving))
        at_zero = any(clock.at_zero for clock in self.clock)
        if "time" in self.__dict__ and not at_zero:
            ray.time = self.time
        return ray

    def medium_beyond(self, d: Any) -> UInt32 | None:
        """The number of the medium of a ray that leaves in the world direction `d`; None in scenes without media."""
        return None


Observer: TypeAlias = "Reference | Interaction3f"
"""A point for which light is sampled: `p` counts always, `n` for some light samplers."""


# ---- hits ------------------------------------------------------------------------------------


class Instanced(Record):
    """The part of a hit that tells the instance."""

    instances: tuple[UInt32, ...]
    """The index of the instance into ``scene.shapes()``; nothing in scenes without instances: see `instance`."""
    scene_ref: SceneRef

    instance = assignable(
        "instance",
        lambda self: scene_of(self).instance_at(self) if self.scene_ref else None,
        """The instance that was hit, a `djpt.ShapePtr`, null on other shapes; or what was assigned.

        None in a record that belongs to no scene. Known where a script asks a scene for the hit.
        """,
    )


# ---- points on surfaces ----------------------------------------------------------------------


class SceneView(Protocol):
    """The scene as a surface point sees it."""

    near_clip_fraction: Float
    """The fraction of a camera ray's `maxt` between the camera and its near plane."""

    units: Any
    """Conversion of lengths and points to the scene's description, for a scene in a working frame; else None."""

    def bsdf_at(self, si: SurfaceInteraction3f) -> Any:
        """The `djpt.materials.pointer.BSDFPtr` of the shape at `si`."""

    def emitter_at(self, si: SurfaceInteraction3f) -> Any:
        """The `djpt.emitters.pointer.EmitterPtr` of what shines at `si`: the shape, or the environment on a miss."""

    def shape_at(self, si: Any) -> Any:
        """The `djpt.shapes.pointer.ShapePtr` of the shape at `si`; null on a miss."""

    def instance_at(self, si: Any) -> Any:
        """The `djpt.shapes.pointer.ShapePtr` of the instance that `si` lies on; null elsewhere."""

    def emitter_index_at(self, si: SurfaceInteraction3f) -> UInt32:
        """The number of the emitter seen at `si`; the count of emitters means none."""

    def emitter_ptr(self, index: UInt32) -> Any:
        """The `djpt.emitters.pointer.EmitterPtr` of the emitters with the numbers `index`."""

    def primitive_index(self, si: SurfaceInteraction3f) -> UInt32:
        """The primitive of its shape that `si` lies on, as Mitsuba counts."""

    def medium_beyond(self, si: SurfaceInteraction3f, d: Vector3f) -> UInt32 | None:
        """The medium of a ray that leaves `si` in the world direction `d`."""

    def target_medium(self, si: SurfaceInteraction3f, d: Any, cos_theta: Any = None) -> Any:
        """The `djpt.media.pointer.MediumPtr` of the medium that a shape names for the side that `d` points to."""

    def surface_interaction_of(
        self, pi: PreliminaryIntersection3f, ray: Ray3f, ray_flags: int, active: Bool | bool
    ) -> SurfaceInteraction3f:
        """The surface point of a hit that a script got from `ray_intersect_preliminary`."""


class PreliminaryIntersection3f(Instanced):
    """The result of a traversal: enough to compute the rest later."""

    title = "PreliminaryIntersection"

    t: Float
    """Distance in units of the ray's `d`; infinity on a miss."""
    prim_uv: Point2f
    """Barycentric weights of the second and third corner of a mesh's triangle; 0 for other shapes."""
    prim_index: UInt32
    """The triangle within its shape, as Mitsuba counts; 0 for shapes that aren't made of triangles."""
    shape_index: UInt32
    """Index into ``scene.shapes()``; 0 on a miss."""
    face: UInt32
    """The scene's own number of the face that was hit: see `Scene`."""
    nearby: tuple[Any, ...]
    """The hit in the coordinates of the search for triangles, if known: see `near`."""
    media: tuple[UInt32, ...]
    """The medium of the ray at the hit, if it may differ from its `Ray3f.media`: see `djpt.geometry.overlapping`."""

    @staticmethod
    def found(t: Float, face: UInt32, shape_index: UInt32, near: Any = None) -> PreliminaryIntersection3f:
        """The intersection that a search has found; see the fields."""
        nearby = () if near is None else (near,)
        pi: PreliminaryIntersection3f = PreliminaryIntersection3f.holding(
            t=t, face=face, shape_index=shape_index, nearby=nearby
        )
        return pi

    def default(self, name: str) -> Any:
        if name == "scene_ref":
            return {}
        return Float(dr.inf) if name == "t" else super().default(name)

    def zero_(self, size: int = 1) -> None:
        """Complete `dr.zeros`: nothing was hit."""
        self.fill_with_zeros(size)
        self.t, self.scene_ref = dr.full(Float, dr.inf, size), latest_scene_ref()

    def shown(self) -> Sequence[str]:
        return "valid", "t", "prim_uv", "prim_index", "shape_index"

    @property
    def near(self) -> Any:
        """The hit in the coordinates of the search for triangles: see `djpt.geometry.query.Near`; else None."""
        return only(self.nearby)

    shape = assignable(
        "shape",
        lambda self: scene_of(self).shape_at(self),
        "The shape that was hit, a `djpt.shapes.pointer.ShapePtr`, null on a miss; or what was assigned.",
    )

    @property
    def valid(self) -> Bool:
        """True where something was hit."""
        return self.is_valid()

    def is_valid(self) -> Bool:
        """True where something was hit."""
        return self.t < dr.inf

    def compute_surface_interaction(
        self, ray: Ray3f, ray_flags: int = 0xE, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The surface point of the hit of `ray`: see `djpt.Scene.ray_intersect` for `ray_flags`."""
        if not self.scene_ref and "_shape" in self.__dict__:
            found: SurfaceInteraction3f = self.shape.compute_surface_interaction(ray, self, ray_flags, active)
            return found
        return scene_of(self).surface_interaction_of(self, ray, ray_flags, active)


class SurfaceInteraction3f(Interaction3f, Instanced):
    """A point on a surface with its frame, and the way back to its shape, BSDF and emitter.

    ``SurfaceInteraction3f()``, ``SurfaceInteraction3f(si)``, ``SurfaceInteraction3f(ps, wavelengths)``, or keywords.
    `n` has unit length and lies on the outer side of the shape (it is never flipped to the ray).
    """

    title = "SurfaceInteraction"

    sh_frame: Frame3f
    """Shading frame: `n` is the shading normal, `s` follows dp/du."""
    uv: Point2f
    dp_du: Vector3f
    dp_dv: Vector3f
    dn_du: Vector3f
    """Derivative of the normal; 0 unless the flags of the query asked for it."""
    dn_dv: Vector3f
    duv_dx: Vector2f
    """Derivative of uv by the pixel's x; 0 before `compute_uv_partials`."""
    duv_dy: Vector2f
    wi: Vector3f
    """Direction back along the ray, in the shading frame; the world direction on a miss."""
    prim_index: UInt32
    """The triangle within its shape, as Mitsuba counts; 0 for shapes that aren't made of triangles."""
    prim_uv: Point2f
    """Barycentric weights of the second and third corner of a mesh's triangle; 0 on other shapes."""
    shape_index: UInt32
    """Index into ``scene.shapes()``; 0 on a miss."""
    face: UInt32
    """The scene's own number of the face: see `Scene`."""
    media: tuple[UInt32, ...]
    """The medium of the ray that arrived; nothing in scenes without media."""

    def __init__(self, other: Any = None, wavelengths: Any = None, *, ps: Any = None, **fields: Any) -> None:
        no_wavelengths(wavelengths)
        other = other if ps is None else ps
        Record.__init__(self, other, **fields)
        if other is not None and not isinstance(other, Interaction3f):
            self.t, self.sh_frame = Float(0), Frame3f.from_normal(self.n)

    def default(self, name: str) -> Any:
        if name == "scene_ref":
            return {}
        if name == "prim_index" and self.scene_ref:
            return self.scene.primitive_index(self)
        return super().default(name)

    def zero_(self, size: int = 1) -> None:
        super().zero_(size)
        self.scene_ref = latest_scene_ref()

    @property
    def scene(self) -> SceneView:
        """The scene that the point belongs to."""
        return scene_of(self)

    @scene.setter
    def scene(self, scene: SceneView) -> None:
        self.scene_ref = of_scene(scene)

    medium = optional("media", "The medium of the ray that arrived; None in scenes without media.")

    @property
    def valid(self) -> Bool:
        """True where the ray hit a surface."""
        return self.is_valid()

    shape = assignable(
        "shape",
        lambda self: scene_of(self).shape_at(self) if self.scene_ref else None,
        "The shape, a `djpt.shapes.pointer.ShapePtr`, null on a miss; or what was assigned.",
    )

    def shown(self) -> Sequence[str]:
        left_out = ("prim_uv", "shape_index", "face")
        return [name for name in super().shown() if name not in left_out]

    # ---- frames ---------------------------------------------------------------------------

    def initialize_sh_frame(self) -> None:
        """Make the shading frame orthonormal: `s` follows dp/du, or is arbitrary where dp/du is 0."""
        n = self.sh_frame.n
        s = dr.fma(n, -dr.dot(n, self.dp_du), self.dp_du)
        squared = dr.squared_norm(s)
        s = dr.select(squared > 0, s * dr.rsqrt(squared), Frame3f.from_normal(n).s)
        self.sh_frame = Frame3f(s, dr.cross(n, s), n)

    def to_local(self, v: Vector3f) -> Vector3f:
        """World direction to the shading frame."""
        return self.sh_frame.to_local(v)

    def to_world(self, v: Vector3f) -> Vector3f:
        """Shading frame to world."""
        return self.sh_frame.to_world(v)

    def to_local_mueller(self, M_world: Any, wi_world: Vector3f, wo_world: Vector3f) -> Any:
        """The value `M_world` as it is: light isn't polarised, so there are no frames of polarisation to turn."""
        return M_world

    def to_world_mueller(self, M_local: Any, wi_local: Vector3f, wo_local: Vector3f) -> Any:
        """The value `M_local` as it is: see `to_local_mueller`."""
        return M_local

    # ---- the shape and what belongs to it --------------------------------------------------

    def medium_beyond(self, d: Any) -> UInt32 | None:
        return self.scene.medium_beyond(self, d) if self.media else None

    def target_medium(self, d: Any = None, *, cos_theta: Float | float | None = None) -> Any:
        """The medium, a `djpt.media.pointer.MediumPtr`, that the shape names for the side that `d` points to.

        `d` is a direction in world space, or its cosine with the normal; that can also be given as `cos_theta`.
        """
        return self.scene.target_medium(self, d, cos_theta)

    def bsdf(self, ray: Ray3f | None = None) -> Any:
        """The BSDF at this point, a `djpt.materials.pointer.BSDFPtr`.

        A `RayDifferential3f` is asked for the derivatives of uv, too: see `compute_uv_partials`.
        """
        if getattr(ray, "has_differentials", False):
            self.compute_uv_partials(ray)
        return self.shape.bsdf() if "_shape" in self.__dict__ else self.scene.bsdf_at(self)

    def emitter(self, scene: SceneView | None = None, active: Bool | bool = True) -> Any:
        """The light of the shape, or of the sky on a miss; a null `djpt.emitters.pointer.EmitterPtr` without one."""
        return self.shape.emitter() if "_shape" in self.__dict__ else (scene or self.scene).emitter_at(self)

    def is_sensor(self) -> Bool:
        """True where the shape carries a sensor."""
        return self.shape.is_sensor()

    def is_medium_transition(self) -> Bool:
        """True where the shape bounds a medium."""
        return self.shape.is_medium_transition()

    # ---- derivatives ------------------------------------------------------------------------

    def compute_uv_partials(self, ray: Any) -> None:
        """Compute the derivatives of uv by the pixel's x and y, from the differentials of the ray; 0 without any.

        The offset rays are intersected with the tangent plane, and the two points given in dp/du and dp/dv.
        """
        self.duv_dx, self.duv_dy = Vector2f(0), Vector2f(0)
        if not getattr(ray, "has_differentials", False):
            return
        height = dr.dot(self.n, self.p)
        a, b, c = dr.squared_norm(self.dp_du), dr.dot(self.dp_du, self.dp_dv), dr.squared_norm(self.dp_dv)
        determinant = a * c - dr.square(b)
        inverse = dr.select(determinant != 0, dr.rcp(determinant), 0)

        def partial(o: Point3f, d: Vector3f) -> Vector2f:
            step = dr.fma(d, (height - dr.dot(self.n, o)) * dr.rcp(dr.dot(self.n, d)), o) - self.p
            u, v = dr.dot(self.dp_du, step), dr.dot(self.dp_dv, step)
            found = Vector2f(c * u - b * v, a * v - b * u) * inverse
            return dr.select(dr.isfinite(found), found, 0)

        self.duv_dx, self.duv_dy = partial(ray.o_x, ray.d_x), partial(ray.o_y, ray.d_y)

    def has_uv_partials(self) -> Bool:
        """True where uv changes from pixel to pixel, as far as was computed."""
        return dr.any((self.duv_dx != 0) | (self.duv_dy != 0))

    def has_n_partials(self) -> Bool:
        """True where the derivative of the normal was asked for, and isn't 0."""
        return dr.any((self.dn_du != 0) | (self.dn_dv != 0))


# ---- points in media -------------------------------------------------------------------------


class MediumInteraction3f(Interaction3f):
    """A point in a medium, where light may be scattered.

    ``MediumInteraction3f()``, ``MediumInteraction3f(mei)``, or its fields by keywords.
    """

    title = "MediumInteraction"

    sh_frame: Frame3f
    """A frame about `wi`; made when it is first read."""
    wi: Vector3f
    """Direction back along the ray, in world space."""
    sigma_s: Color3f
    """Scattering coefficient."""
    sigma_n: Color3f
    """Coefficient of null collisions: majorant - sigma_t."""
    sigma_t: Color3f
    """Extinction coefficient: absorption and scattering."""
    combined_extinction: Color3f
    """The majorant."""
    mint: Float
    """Distance at which the ray enters the medium's box."""
    pointers: tuple[Any, ...]
    """The medium, a pointer, or nothing: see `medium`."""

    @staticmethod
    def on(ray: Ray3f, t: Float, p: Point3f | None = None) -> MediumInteraction3f:
        """The point of a ray at `t`; `p` is that point if it is known."""
        mei: MediumInteraction3f = MediumInteraction3f.holding(t=t, p=ray(t) if p is None else p, wi=-ray.d)
        mei.arrived_with(ray)
        return mei

    def default(self, name: str) -> Any:
        return Frame3f.from_normal(self.wi) if name == "sh_frame" else super().default(name)

    medium = optional(
        "pointers", "The medium, a `djpt.media.pointer.MediumPtr`; None in a record that no medium has made."
    )

    def to_local(self, v: Vector3f) -> Vector3f:
        """World direction to `sh_frame`."""
        return self.sh_frame.to_local(v)

    def to_world(self, v: Vector3f) -> Vector3f:
        """`sh_frame` to world."""
        return self.sh_frame.to_world(v)

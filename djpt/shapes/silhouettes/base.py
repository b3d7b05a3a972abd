"""The contract of silhouettes: what each kind of shape knows of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from djpt.core.records import GRAZING, BSDFFlags, DiscontinuityFlags, SurfaceInteraction3f, has_flag
from djpt.jit.types import Bool, Float, Float64, Matrix4f, Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.silhouettes.moving import attached_place
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = [
    "INSET",
    "INTERIOR",
    "IN_FRONT",
    "PERIMETER",
    "TURN",
    "Placement",
    "Silhouette",
    "SilhouetteOfPoints",
    "SurfacePoint",
    "aligned",
    "away_from",
    "edge_normal",
    "lets_through",
    "of_three",
    "with_gradient",
]

IN_FRONT = -1e-4
"""`SilhouetteSample3f.offset` at edges of whose faces both are seen: the one behind may rise towards the viewer."""

INSET = 1e-4
"""How far off an edge a surface is looked at, as a fraction of the shape's extent."""

TURN = 3e-3
"""The angle between a silhouette and where a surface that light passes through is looked at."""

PERIMETER, INTERIOR = int(DiscontinuityFlags.PerimeterType), int(DiscontinuityFlags.InteriorType)


@dataclass(frozen=True)
class Placement:
    """The affine map of a unit shape to the world: p = origin + x p_x + y p_y + z p_z."""

    x: Vector3f
    y: Vector3f
    z: Vector3f
    origin: Point3f

    @staticmethod
    def of_matrix(matrix: Matrix4f) -> Placement:
        """The columns of a matrix."""
        x, y, z, origin = (Vector3f(matrix[0, k], matrix[1, k], matrix[2, k]) for k in range(4))
        return Placement(x, y, z, origin)

    @staticmethod
    def of_entries(entries: Float64, lanes: int) -> Placement:
        """The columns of a matrix whose entries are in memory, row by row, for so many lanes.

        Lanes that read memory add up their gradients there, all in one kernel, and in double precision. Those of a
        single number would be summed up one by one: a kernel for each entry.
        """

        def entry(index: int) -> Float:
            return Float(dr.gather(Float64, entries, dr.full(UInt32, index, lanes), mode=dr.ReduceMode.Local))

        x, y, z, origin = (Vector3f(*(entry(4 * row + k) for row in range(3))) for k in range(4))
        return Placement(x, y, z, origin)

    def point(self, p: Point3f) -> Point3f:
        """Map a point."""
        return dr.fma(self.x, p.x, dr.fma(self.y, p.y, dr.fma(self.z, p.z, self.origin)))

    def local(self, p: Point3f) -> tuple[Float, Float]:
        """The first two coordinates of a point near the plane of x and y."""
        cross = dr.cross(self.x, self.y)
        v = (p - self.origin) / dr.squared_norm(cross)
        return dr.dot(v, dr.cross(self.y, cross)), dr.dot(v, dr.cross(cross, self.x))

    def along(self, p: Point3f) -> Vector3f:
        """The coordinates of a point, if the columns are perpendicular to each other."""
        v = p - self.origin
        return Vector3f(*(dr.dot(v, axis) / dr.squared_norm(axis) for axis in (self.x, self.y, self.z)))

    def around(self, p: Point3f) -> Vector3f:
        """The change of a point per turn about the z axis; `p` is the point of the unit shape."""
        return Vector3f((self.y * p.x - self.x * p.y) * (2 * math.pi))

    def up(self) -> Normal3f:
        """The unit normal of the plane of x and y."""
        return dr.normalize(dr.cross(self.x, self.y))


@dataclass
class SurfacePoint:
    """What shading needs to know of a point of a surface."""

    n: Normal3f
    """The normal of the surface, of unit length, on the outer side."""
    shading: Normal3f
    """The interpolated normal of smooth meshes; else the same."""
    uv: Point2f
    """Texture coordinates."""
    dp_du: Vector3f
    """The change of the point per unit of u."""


class Silhouette:
    """The silhouettes of one shape, or of the shapes of one class, one per lane.

    Samples lie in the unit cube. `types` says which kinds of silhouettes there are; a sample is of one kind, and what
    has none of the kinds that are asked for returns an empty one.
    """

    types: ClassVar[int] = PERIMETER
    offset: ClassVar[float] = 0.0
    """`SilhouetteSample3f.offset`."""

    grazing: ClassVar[float] = GRAZING
    """The least cosine between a ray and the normal at which hits slide as the shape moves."""

    def __init__(self, shape: Any) -> None:
        """`shape` holds the values: numbers, or one per lane."""
        self.shape = shape

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        """The segment that belongs to a point of the unit cube."""
        raise NotImplementedError

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        """The point that `sample` takes to a segment."""
        raise NotImplementedError

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        """A point of the silhouette, as seen from `viewpoint`, that belongs to the surface point `si`."""
        raise NotImplementedError

    def precompute(self, viewpoint: Point3f, creases: bool = False, within: float = 0.0) -> tuple[UInt32, Float]:
        """The parts of the silhouette as seen from a point: their numbers, and weights to choose among them.

        With `creases`, edges count, too, of whose faces both are seen and at which shading jumps. All parts are
        returned that are seen from a point `within` a distance of the `viewpoint`.
        """
        return UInt32(PERIMETER), Float(1)

    def seen(self, viewpoint: Point3f, part: UInt32, creases: bool) -> Bool:
        """Whether a part is one of those that are seen from just this point."""
        return Bool(True)

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        """A point of a part of the silhouette; `pdf` is per unit length."""
        raise NotImplementedError

    def local(self, uv: Point2f) -> Point3f:
        """The point of the unit shape with the texture coordinates `uv`."""
        raise NotImplementedError

    def follow(self, prim_index: UInt32, uv: Point2f, active: Bool | bool) -> Point3f | None:
        """The point that sticks to the surface as the shape moves, attached to its parameters; None if it stays."""
        place = self.attached(dr.width(uv))
        return None if place is None else place.point(dr.detach(self.local(dr.detach(uv))))

    def place(self) -> Any:
        """Where the shape is: its `Placement`; of a mesh the positions of its vertices."""
        raise NotImplementedError

    def attached(self, lanes: int) -> Any:
        """The same for so many lanes, attached to the parameters of the shape; None if it stays."""
        place = attached_place(self.shape)
        if isinstance(place, Float64):
            return Placement.of_entries(place, lanes)
        return None if place is None else Placement.of_matrix(place)

    def surface(self, place: Any, p: Point3f, prim_index: UInt32, active: Bool | bool) -> SurfacePoint:
        """The surface at a point of it, if the shape is where `place` says; attached if `place` or `p` is."""
        raise NotImplementedError

    def foreground(self, ss: Any, active: Bool | bool) -> tuple[Point3f, Normal3f]:
        """A point of the surface close to a silhouette, off the very edge, and the unit normal there."""
        place = self.place()
        middle = dr.fma(INSET, place.origin - ss.p, ss.p)
        return middle, self.surface(place, middle, ss.prim_index, active).n

    def stops(self, ss: SilhouetteSample3f, active: Bool | bool) -> Bool:
        """Whether rays along `ss.d` meet the surface at the silhouette: those of one-sided surfaces may pass."""
        return Bool(True)

    def texture_place(self, uv: Point2f, prim_uv: Point2f) -> Point2f:
        """Of the texture coordinates and barycentric weights of a hit those that `follow` understands."""
        return uv

    def sample_of(self, **fields: Any) -> SilhouetteSample3f:
        """A sample of this shape, whose number the caller sets."""
        return SilhouetteSample3f(number=UInt32(0), offset=Float(self.offset), **fields)


class SilhouetteOfPoints(Silhouette):
    """The silhouettes of a shape that is placed by points in memory, a mesh or curves."""

    def place(self) -> Float:
        return dr.detach(getattr(self.shape, self.shape.points_parameter))

    def attached(self, lanes: int = 1) -> Float | Float64 | None:
        points: Float | Float64 | None = attached_place(self.shape)
        return points


def lets_through(shape: Any) -> bool:
    """Whether light passes straight through a surface.

    Where it is looked at near its outline, it is then turned to the viewer by the angle `TURN`, so that a ray which
    passes straight on meets the far side, too.
    """
    return has_flag(shape.bsdf().flags(), BSDFFlags.Null)


def with_gradient(value: Any, attached: Any) -> Any:
    """The value, with the derivative of another expression that has the same one."""
    result: Any = dr.replace_grad(dr.detach(value), attached)  # type: ignore[func-returns-value]
    return result


def away_from(viewpoint: Point3f) -> Callable[[Point3f], Vector3f]:
    """The function that gives the direction in which a viewer sees a point."""
    return lambda p: dr.normalize(p - viewpoint)


def edge_normal(d: Vector3f, edge: Vector3f, inward: Vector3f) -> Normal3f:
    """The unit normal of the plane through `edge` and `d`, on the side that `inward` doesn't point to."""
    n = dr.normalize(dr.cross(d, edge))
    return dr.select(dr.dot(inward, n) > 0, -n, n)


def aligned(n: Vector3f, reference: Vector3f) -> Vector3f:
    """The normal on the side of another."""
    return n * dr.mulsign(Float(1), dr.detach(dr.dot(n, reference)))


def of_three(number: UInt32, values: Sequence[Any]) -> Any:
    """The value with a number: of three edges or corners."""
    return dr.select(number == 0, values[0], dr.select(number == 1, values[1], values[2]))

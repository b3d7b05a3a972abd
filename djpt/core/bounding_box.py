"""Axis-aligned boxes and spheres about things, on lanes and on the host."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import drjit as dr
import drjit.scalar as scalar

from djpt.core.numeric import as_type
from djpt.jit.types import Bool, Float, Point2f, Point3f

__all__ = [
    "BoundingBox2f",
    "BoundingBox3f",
    "BoundingSphere3f",
    "ScalarBoundingBox2f",
    "ScalarBoundingBox3f",
    "ScalarBoundingSphere3f",
]


class BoundingSphere3f:
    """All points within a distance of a centre; one sphere per lane.

    Args:
        center: the centre, three numbers in any form, or another sphere; default: the origin.
        radius: the distance; 0, the default, is an empty sphere.
    """

    Point: ClassVar[Any] = Point3f
    Number: ClassVar[Any] = Float
    DRJIT_STRUCT: ClassVar[dict[str, Any]] = {"center": Point3f, "radius": Float}
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, center: Any = 0, radius: Any = 0) -> None:
        if isinstance(center, BoundingSphere3f):
            center, radius = tuple(center)
        self.center: Any = as_type(self.Point, center)
        self.radius: Any = as_type(self.Number, radius)

    def __iter__(self) -> Iterator[Any]:
        return iter((self.center, self.radius))

    def empty(self) -> Bool:
        """True where the radius is 0 or less."""
        return self.radius <= 0

    def contains(self, p: Any, strict: bool = False) -> Bool:
        """True where the point `p` lies in the sphere; `strict` leaves out the surface."""
        distance = dr.squared_norm(as_point(self.Point, p) - self.center)
        return distance < dr.square(self.radius) if strict else distance <= dr.square(self.radius)

    def expand(self, p: Any) -> None:
        """Enlarge the radius so that the sphere contains the point `p`."""
        self.radius = dr.maximum(self.radius, dr.norm(as_point(self.Point, p) - self.center))

    def ray_intersect(self, ray: Any) -> tuple[Bool, Float, Float]:
        """The intersection of a ray's line with the surface: True if it is met, and two parameters, < 0 behind it."""
        o = ray.o - Point3f(self.center)
        a, half_b = dr.squared_norm(ray.d), dr.dot(o, ray.d)
        c = dr.squared_norm(o) - dr.square(self.radius)
        # The distance of the line from the centre gives the discriminant without cancellation.
        beside = dr.squared_norm(dr.fma(ray.d, -half_b / a, o))
        discriminant = a * (dr.square(self.radius) - beside)
        hit = (discriminant >= 0) & (a > 0)
        q = -(half_b + dr.mulsign(dr.safe_sqrt(discriminant), half_b))
        first, second = q / a, c / q
        second = dr.select(q == 0, 0, second)
        return hit, dr.minimum(first, second), dr.maximum(first, second)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, BoundingSphere3f):
            return NotImplemented
        same = dr.all(self.center == other.center) & (self.radius == other.radius)
        return bool(dr.all(same, axis=None))

    def __repr__(self) -> str:
        name = type(self).__name__.removeprefix("Scalar")
        if dr.all(self.empty(), axis=None):
            return f"{name}[empty]"
        radius = f"{self.radius:g}" if isinstance(self.radius, float) else self.radius
        return f"{name}[\n  center = {self.center},\n  radius = {radius}\n]"


class ScalarBoundingSphere3f(BoundingSphere3f):
    """A `BoundingSphere3f` of Python's numbers: one sphere."""

    Point = scalar.Array3f
    Number = float
    DRJIT_STRUCT: ClassVar[dict[str, Any]] = {}


def as_point(kind: Any, p: Any) -> Any:
    """`p` as an array of `kind`; Dr.Jit's arrays stay what they are, with their lanes."""
    return p if dr.is_array_v(p) and not dr.is_tensor_v(p) else as_type(kind, p)


class BoundingBox:
    """All points between two corners; ``low, high = box`` gives the corners.

    Args:
        min: the smallest corner, numbers in any form, or another box; default: +inf, which makes the box empty.
        max: the largest corner; default: `min`, or -inf.
        p: a point that is both corners, in place of `min`.
    """

    Point: ClassVar[Any]
    size: ClassVar[int]
    DRJIT_STRUCT: ClassVar[dict[str, Any]]
    __hash__ = None  # type: ignore[assignment]

    def __init_subclass__(cls) -> None:
        if hasattr(cls, "Point"):
            cls.size = dr.size_v(cls.Point)
            cls.DRJIT_STRUCT = {"min": cls.Point, "max": cls.Point} if dr.is_jit_v(cls.Point) else {}

    def __init__(self, min: Any = None, max: Any = None, *, p: Any = None) -> None:
        min = p if min is None else min
        if min is None:
            min, max = dr.inf, -dr.inf
        elif isinstance(min, BoundingBox):
            min, max = min
        self.min = as_type(self.Point, min)
        self.max = as_type(self.Point, min if max is None else max)

    def __iter__(self) -> Iterator[Any]:
        return iter((self.min, self.max))

    # ---- asking ------------------------------------------------------------------------

    def valid(self) -> Bool:
        """True where the box holds any point."""
        return dr.all(self.max >= self.min)

    def collapsed(self) -> Bool:
        """True where the box has no extent along some axis."""
        return dr.any(self.min == self.max)

    def center(self) -> Any:
        """The middle of the box."""
        return (self.max + self.min) * 0.5

    def extents(self) -> Any:
        """The lengths of the sides."""
        return self.max - self.min

    def corner(self, index: int) -> Any:
        """A corner: bit k of `index` says whether it has the largest coordinate on axis k."""
        return self.Point(*(self.max[k] if index & 1 << k else self.min[k] for k in range(self.size)))

    def volume(self) -> Float:
        """The product of the sides."""
        return dr.prod(self.extents())

    def surface_area(self) -> Float:
        """The area of the faces; of a box in the plane, the length of its outline."""
        sides = self.extents()
        if self.size == 2:
            return 2 * dr.sum(sides)
        a, b, c = sides
        return 2 * (a * b + b * c + c * a)

    def major_axis(self) -> Any:
        """The number of the axis along which the box is longest; the first one of several."""
        return self._axis(lambda side, best: side > best)

    def minor_axis(self) -> Any:
        """The number of the axis along which the box is shortest; the first one of several."""
        return self._axis(lambda side, best: side < best)

    def _axis(self, better: Any) -> Any:
        sides = self.extents()
        best = sides[0]
        index = dr.uint32_array_t(type(best))(0) if dr.is_array_v(best) else 0
        for k in range(1, self.size):
            found = better(sides[k], best)
            index, best = dr.select(found, k, index), dr.select(found, sides[k], best)
        return index

    def contains(self, p: Any = None, strict: bool = False, *, bbox: Any = None) -> Bool:
        """True if a point, or another box, lies in the box; `strict` leaves out the faces."""
        p = p if bbox is None else bbox
        low, high = p if isinstance(p, BoundingBox) else (as_point(self.Point, p),) * 2
        return dr.all((low > self.min) & (high < self.max) if strict else (low >= self.min) & (high <= self.max))

    def overlaps(self, bbox: BoundingBox, strict: bool = False) -> Bool:
        """True where two boxes have a point in common; `strict` leaves out the faces."""
        low, high = bbox
        return dr.all((low < self.max) & (high > self.min) if strict else (low <= self.max) & (high >= self.min))

    def squared_distance(self, p: Any) -> Float:
        """The squared distance from the box to a point or to another box; 0 where they meet."""
        low, high = p if isinstance(p, BoundingBox) else (as_point(self.Point, p),) * 2
        return dr.squared_norm(dr.maximum(self.min - high, 0) + dr.maximum(low - self.max, 0))

    def distance(self, p: Any) -> Float:
        """The distance from the box to a point or to another box; 0 where they meet."""
        return dr.sqrt(self.squared_distance(p))

    # ---- editing -----------------------------------------------------------------------

    def reset(self) -> None:
        """Make the box empty."""
        self.min, self.max = self.Point(dr.inf), self.Point(-dr.inf)

    def clip(self, bbox: BoundingBox) -> None:
        """Keep what lies in another box as well."""
        self.min, self.max = dr.maximum(self.min, bbox.min), dr.minimum(self.max, bbox.max)

    def expand(self, p: Any) -> None:
        """Enlarge the box so that it contains a point, or another box."""
        low, high = p if isinstance(p, BoundingBox) else (as_point(self.Point, p),) * 2
        self.min, self.max = dr.minimum(self.min, low), dr.maximum(self.max, high)

    @classmethod
    def merge(cls, bbox1: BoundingBox, bbox2: BoundingBox) -> Any:
        """The smallest box that contains two boxes."""
        return cls(dr.minimum(bbox1.min, bbox2.min), dr.maximum(bbox1.max, bbox2.max))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, BoundingBox) or other.size != self.size:
            return NotImplemented
        return bool(dr.all((self.min == other.min) & (self.max == other.max), axis=None))

    def __repr__(self) -> str:
        name = type(self).__name__.removeprefix("Scalar")
        if not dr.any(self.valid(), axis=None):
            return f"{name}[invalid]"
        return f"{name}[\n  min = {self.min},\n  max = {self.max}\n]"


class SpatialBox(BoundingBox):
    """A box in space, with the methods that need three axes."""

    Sphere: ClassVar[Any]

    def bounding_sphere(self) -> Any:
        """The sphere through the corners."""
        center = self.center()
        return self.Sphere(center, dr.norm(center - self.max))

    def ray_intersect(self, ray: Any) -> tuple[Bool, Float, Float]:
        """The intersection of a ray's line with the box: True if it is met, and the parameters of both points.

        Negative parameters are behind the ray. Where nothing is hit, the parameters mean nothing.
        """
        low, high = Point3f(self.min), Point3f(self.max)
        first, second = (low - ray.o) / ray.d, (high - ray.o) / ray.d
        # Between two planes that it runs along, a line stays for ever, and outside of them it never comes in.
        along, within = ray.d == 0, (ray.o >= low) & (ray.o <= high)
        enter = dr.select(along, dr.select(within, -dr.inf, dr.inf), dr.minimum(first, second))
        leave = dr.select(along, dr.select(within, dr.inf, -dr.inf), dr.maximum(first, second))
        mint, maxt = dr.max(enter), dr.min(leave)
        return (mint <= maxt) & dr.any(~along), mint, maxt


class BoundingBox3f(SpatialBox):
    """An axis-aligned box in space per lane."""

    Point = Point3f
    Sphere = BoundingSphere3f


class ScalarBoundingBox3f(SpatialBox):
    """An axis-aligned box in space, on the host."""

    Point = scalar.Array3f
    Sphere = ScalarBoundingSphere3f


class BoundingBox2f(BoundingBox):
    """An axis-aligned rectangle in the plane per lane."""

    Point = Point2f


class ScalarBoundingBox2f(BoundingBox):
    """An axis-aligned rectangle in the plane, on the host."""

    Point = scalar.Array2f

"""Spheres about things."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import drjit as dr
import drjit.scalar as scalar

from djpt.core.numeric import as_type
from djpt.jit.types import Bool, Float, Point3f

__all__ = ["BoundingSphere3f", "ScalarBoundingSphere3f", "as_point"]


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

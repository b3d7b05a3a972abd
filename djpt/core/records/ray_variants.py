"""Rays that only scripts use: in the plane, in double precision, without lanes, and with neighbours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit.scalar as scalar

from djpt.core.records import Ray3f
from djpt.jit.types import Float, Float64, Point2f, Point3f, Vector2f, Vector3f, backend

if TYPE_CHECKING:
    from drjit.llvm.ad import Array2f64, Array3f64
else:
    Array2f64, Array3f64 = backend.Array2f64, backend.Array3f64

__all__ = [
    "Ray2d",
    "Ray2f",
    "Ray3d",
    "RayDifferential3f",
    "ScalarRay2d",
    "ScalarRay2f",
    "ScalarRay3d",
    "ScalarRay3f",
]


class Ray2f(Ray3f):
    """o + t d in the plane, for 0 < t < maxt; made like a `Ray3f`."""

    o: Point2f  # type: ignore[assignment]
    d: Vector2f  # type: ignore[assignment]


class Ray3d(Ray3f):
    """A `Ray3f` in double precision."""

    o: Array3f64  # type: ignore[assignment]
    d: Array3f64  # type: ignore[assignment]
    maxt: Float64  # type: ignore[assignment]


class Ray2d(Ray3f):
    """A `Ray2f` in double precision."""

    o: Array2f64  # type: ignore[assignment]
    d: Array2f64  # type: ignore[assignment]
    maxt: Float64  # type: ignore[assignment]


class ScalarRay3f(Ray3f):
    """A single ray of Python's numbers and arrays of `drjit.scalar`; made like a `Ray3f`."""

    o: scalar.Array3f  # type: ignore[assignment]
    d: scalar.Array3f  # type: ignore[assignment]
    maxt: float  # type: ignore[assignment]


class ScalarRay3d(ScalarRay3f):
    """A `ScalarRay3f` in double precision."""

    o: scalar.Array3f64  # type: ignore[assignment]
    d: scalar.Array3f64  # type: ignore[assignment]


class ScalarRay2f(ScalarRay3f):
    """A `ScalarRay3f` in the plane."""

    o: scalar.Array2f  # type: ignore[assignment]
    d: scalar.Array2f  # type: ignore[assignment]


class ScalarRay2d(ScalarRay3f):
    """A `ScalarRay2f` in double precision."""

    o: scalar.Array2f64  # type: ignore[assignment]
    d: scalar.Array2f64  # type: ignore[assignment]


class RayDifferential3f(Ray3f):
    """A ray with the rays through the neighbouring pixels: `o_x`, `d_x` to the right, `o_y`, `d_y` below.

    Made as ``RayDifferential3f()``, ``RayDifferential3f(ray)`` or ``RayDifferential3f(o, d, time=0, wavelengths=[])``,
    without differentials: assign them, and set `has_differentials`.
    """

    o_x: Point3f
    o_y: Point3f
    d_x: Vector3f
    d_y: Vector3f

    def __init__(
        self,
        o: Any = None,
        d: Any = None,
        time: Any = None,
        wavelengths: Any = None,
        *,
        ray: Ray3f | None = None,
        **fields: Any,
    ) -> None:
        o = ray if o is None else o
        own = {name: fields.pop(name) for name in ("o_x", "o_y", "d_x", "d_y") if name in fields}
        super().__init__(o, d, time=time, wavelengths=wavelengths, **fields)
        for name, value in own.items():
            setattr(self, name, value)
        self.has_differentials = getattr(o, "has_differentials", False)
        """True if the differentials mean anything."""

    def scale_differential(self, amount: Float | float) -> None:
        """Move the neighbouring rays closer to this one (`amount` < 1), as for several samples per pixel."""
        self.o_x, self.o_y = ((o - self.o) * amount + self.o for o in (self.o_x, self.o_y))
        self.d_x, self.d_y = ((d - self.d) * amount + self.d for d in (self.d_x, self.d_y))

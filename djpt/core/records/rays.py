"""Rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import drjit.scalar as scalar

from djpt.core.records.record import Record, no_wavelengths, optional
from djpt.jit.types import Float, Float64, Point2f, Point3f, UInt32, Vector2f, Vector3f, backend

if TYPE_CHECKING:
    from drjit.llvm.ad import Array2f64, Array3f64
else:
    Array2f64, Array3f64 = backend.Array2f64, backend.Array3f64

__all__ = [
    "Ray2d",
    "Ray2f",
    "Ray3d",
    "Ray3f",
    "RayDifferential3f",
    "ScalarRay2d",
    "ScalarRay2f",
    "ScalarRay3d",
    "ScalarRay3f",
]


class Ray3f(Record):
    """o + t d for 0 < t < maxt. `d` need not have unit length; `maxt` is in units of it.

    Made as in Mitsuba: ``Ray3f()``, ``Ray3f(o, d, time=0, wavelengths=[])``, ``Ray3f(o, d, maxt, time, wavelengths)``,
    ``Ray3f(ray)``, ``Ray3f(ray, maxt)``; also by keywords. The third argument of three or four is the time.
    """

    title = "Ray"

    o: Point3f
    d: Vector3f
    maxt: Float
    times: tuple[Float, ...]
    """The time, or nothing for 0: see `time`."""
    media: tuple[UInt32, ...]
    """The number of the medium that the ray runs through, or nothing in scenes without media: see `medium`."""

    def __init__(
        self,
        o: Any = None,
        d: Any = None,
        *rest: Any,
        maxt: Any = None,
        time: Any = None,
        wavelengths: Any = None,
        medium: UInt32 | None = None,
    ) -> None:
        if isinstance(o, Ray3f):
            self.assign(o)
            o, d, maxt = None, None, d if d is not None else maxt
        if len(rest) == 3:
            maxt, time, wavelengths = rest
        elif rest:
            time, wavelengths = (*rest, wavelengths)[:2]
        if len(rest) > 3:
            raise TypeError("Ray3f(o, d, maxt, time, wavelengths): at most five arguments are possible")
        no_wavelengths(wavelengths)
        # Copies, since Dr.Jit's operators like += change arrays in place.
        fields, kinds = self.__dict__, self.DRJIT_STRUCT
        if o is not None:
            fields["o"] = kinds["o"](o)
        if d is not None:
            fields["d"] = kinds["d"](d)
        if maxt is not None:
            fields["maxt"] = kinds["maxt"](maxt)
        if medium is not None:
            fields["media"] = (medium,)
        if time is not None:
            self.time = time

    def default(self, name: str) -> Any:
        if name == "maxt":
            return self.DRJIT_STRUCT["maxt"](dr.inf)
        kind = self.DRJIT_STRUCT[name]
        if name == "d" and dr.size_v(kind) == 3:
            return kind(0, 0, 1)
        return super().default(name)

    def shown(self) -> Sequence[str]:
        return "o", "d", "maxt", "time", "wavelengths"

    medium = optional(
        "media", "The number of the medium that the ray runs through: see `djpt.media`. None in scenes without media."
    )

    @property
    def time(self) -> Float:
        """The time, which is carried along: what moves, and light that varies, is seen as it is then.

        Rays without one have the time 0 and take no memory for it. So in loops and selects they don't mix with rays of
        another time.
        """
        return self.times[0] if self.times else self.DRJIT_STRUCT["maxt"](0)

    @time.setter
    def time(self, time: Any) -> None:
        time = self.DRJIT_STRUCT["maxt"](time)
        self.times = () if is_zero(time) else (time,)

    def __call__(self, t: Float) -> Point3f:
        """The point at parameter `t`."""
        return dr.fma(self.d, t, self.o)


def is_zero(number: Any) -> bool:
    """True if a number is 0 and nothing else: known without computing, and without derivatives."""
    if not dr.is_array_v(number):
        return bool(number == 0)
    known = number.state == dr.VarState.Literal and dr.width(number) == 1
    return bool(known and number[0] == 0 and not dr.grad_enabled(number))


# ---- rays that only scripts use ----------------------------------------------------------------


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

"""Rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from djpt.core.records.record import Record, no_wavelengths
from djpt.jit.types import Float, Point3f, UInt32, Vector3f

__all__ = ["Ray3f"]


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

    @property
    def medium(self) -> UInt32 | None:
        """The number of the medium that the ray runs through: see `djpt.media`. None in scenes without media."""
        return self.media[0] if self.media else None

    @medium.setter
    def medium(self, medium: UInt32 | None) -> None:
        self.media = () if medium is None else (medium,)

    @property
    def time(self) -> Float:
        """The time, which is carried along: no shape moves in djpt, but some light varies (`timed_sunsky`).

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

"""Points that light is sampled for, and points of rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import drjit as dr

from djpt.core.records.rays import Ray3f
from djpt.core.records.record import Record, no_wavelengths
from djpt.jit.types import Bool, Float, Normal3f, Point3f, UInt32, Vector3f

__all__ = ["RAY_EPSILON", "SHADOW_EPSILON", "Interaction3f", "Observer", "Reference"]

RAY_EPSILON = 1500 * 2.0**-24
"""Offset of a spawned ray along the normal, relative to 1 + the largest coordinate (Mitsuba's value)."""

SHADOW_EPSILON = 10 * RAY_EPSILON
"""A shadow ray stops short of the light by this fraction of its length."""


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

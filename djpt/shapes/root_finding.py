"""The first zero of a function along a ray."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr

from djpt.jit.kernels import while_loop
from djpt.jit.types import Bool, Float, UInt32

__all__ = ["Zero", "first_zero"]

REFINEMENTS = 40
"""Most evaluations after a zero was bracketed; about 6 are needed."""

MOST_STEPS = 1 << 17
"""Most evaluations of a function; bounds the search whatever the function returns."""

NARROW = 2.0**-22
"""Relative width of a bracket that float32 can't narrow further."""


@dataclass
class Zero:
    """Where a function first changes its sign."""

    found: Bool
    t: Float


@dataclass
class Search:
    """Loop state. The sign of `f` is turned so that it is positive at the start."""

    t: Float
    """Where `f` is evaluated next."""
    low: Float
    f_low: Float
    high: Float
    f_high: Float
    count: UInt32
    """How many times the bracket was narrowed."""
    tries: UInt32
    """How many times the function was called."""
    bracketed: Bool
    crossed: Bool
    """Whether the last point was beyond the zero."""
    active: Bool


def first_zero(f: Callable[[Float], Float], start: Float, end: Float, reach: Float, least: Float, active: Bool) -> Zero:
    """The first change of sign of `f` between `start` and `end`, where `active`.

    From each point the search goes on by abs(f) times `reach`, but at least by `least`: with 1 / reach a bound of
    abs(f') no zero is left out (J. C. Hart, "Sphere Tracing", The Visual Computer 12, 1996), except pairs of zeros
    closer than `least`. With reach = 0 all steps are `least`. Once the sign has changed, the zero is narrowed down
    by false position with Illinois' rule, every fourth time by bisection, to the last digits that `f` has. One loop
    with one evaluation of `f`, so that lanes don't wait for each other's phase.
    """
    first = f(start)
    inside = first < 0
    width = max(dr.width(first), dr.width(end), dr.width(active))

    def onward(low: Float, f_low: Float) -> Float:
        # Far from the origin `least` may be less than the distance to the next number.
        t = low + dr.maximum(dr.maximum(f_low * reach, least), NARROW * low)
        return dr.select(t < end, t, end)

    def step(s: Search) -> Search:
        value = f(s.t)
        value = dr.select(inside, -value, value)
        crossed = value <= 0
        # Illinois: an end that stays for the second time counts half, so that it will move.
        weight = dr.select(s.bracketed & (crossed == s.crossed), Float(0.5), Float(1))
        f_low, f_high = dr.select(crossed, s.f_low * weight, value), dr.select(crossed, value, s.f_high * weight)
        low, high = dr.select(crossed, s.low, s.t), dr.select(crossed, s.t, s.high)
        bracketed = s.bracketed | crossed
        secant = low + (high - low) * (f_low * dr.rcp(f_low - f_high))
        middle = 0.5 * (low + high)
        bisect = ~((secant > low) & (secant < high)) | ((s.count & 3) == 3)
        narrower = dr.select(bisect, middle, secant)
        settled = bracketed & ((value == 0) | (high - low <= NARROW * high) | (s.count > REFINEMENTS))
        over = (~bracketed & (s.t >= end)) | (s.tries > MOST_STEPS)
        t = dr.select(bracketed, dr.select(settled, s.t, narrower), onward(low, f_low))
        count = dr.select(bracketed, s.count + 1, s.count)
        tries = s.tries + 1
        return Search(t, low, f_low, high, f_high, count, tries, bracketed, crossed, s.active & ~settled & ~over)

    zero, no = dr.zeros(Float, width), dr.full(Bool, False, width)
    distance = dr.abs(first)
    search = Search(
        onward(start, distance) + zero,
        start + zero,
        distance + zero,
        end + zero,
        Float(zero),
        dr.zeros(UInt32, width),
        dr.zeros(UInt32, width),
        no,
        Bool(no),
        active & (start < end) & ~no,
    )
    (search,) = while_loop((search,), lambda s: s.active, lambda s: (step(s),), labels=("search",))
    return Zero(search.bracketed, search.t)

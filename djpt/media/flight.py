"""Free flights of light in a medium."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from djpt.jit.types import Bool, Color3f, Float, UInt32

__all__ = ["FAR", "Flight", "of_channel"]

FAR = 1e30
"""The length of a ray without an end: times a coefficient of 0 it is 0, unlike infinity."""


@dataclass
class Flight:
    """A segment of a path in a medium, with its sampled length."""

    t: Float
    """Distance at which light is scattered; unspecified where it isn't."""
    scattered: Bool
    """True where the segment ends in the medium, else the light has passed it."""
    value: Color3f
    """The transmittance of the distance flown, times the scattering coefficient where light is scattered."""
    pdf: Color3f
    """The density of such a flight if the distance had been sampled by each channel's coefficient; detached.

    Factors that `value` and `pdf` share are left out of both.
    """
    emitted: Color3f
    """The light that the medium adds on the segment, as far as it reaches the segment's start: an estimate."""

    @staticmethod
    def none() -> Flight:
        """A segment without a medium."""
        return Flight(Float(dr.inf), Bool(False), Color3f(1), Color3f(1), Color3f(0))


def of_channel(color: Color3f, channel: UInt32 | None) -> Float:
    """The component of a channel; the first of a grey medium, which needs no channel."""
    if channel is None:
        return color.x
    return dr.select(channel == 0, color.x, dr.select(channel == 1, color.y, color.z))

"""Random points that are spread evenly over all lanes: samples of curves, which belong to no pixel."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.jit.types import Float, Point2f, UInt32

__all__ = ["spread"]

BELOW_ONE = 1 - 2**-24


def spread(sampler: Any) -> Point2f:
    """A random point of the unit square for each lane, all of them spread evenly.

    They are those of Hammersley, the first coordinate jittered, and the second one shifted by the same amount in all
    lanes. The first one grows with the lane: what it chooses from, neighbours choose close to each other.
    """
    lanes = sampler.wavefront_size()
    lane = dr.arange(UInt32, lanes)
    x = (Float(lane) + sampler.next_1d()) / lanes
    y = Float(dr.brev(lane)) * 2.0**-32 + dr.gather(Float, sampler.next_1d(), UInt32(0))
    return Point2f(dr.minimum(x, BELOW_ONE), y - dr.floor(y))

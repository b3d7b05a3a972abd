"""Random points that are spread evenly over all lanes: samples of curves, which belong to no pixel."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.jit.types import Float, Point2f, UInt32

__all__ = ["BELOW_ONE", "hammersley", "lens_points", "spread"]

BELOW_ONE = 1 - 2**-24
"""The largest number below 1."""

MOST_LENS_POINTS = 16
"""Outlines are seen through so many points of a lens, at most: of each they are looked for anew."""


def spread(sampler: Any) -> Point2f:
    """A random point of the unit square for each lane, all of them spread evenly.

    They are those of Hammersley, the first coordinate jittered, and the second one shifted by the same amount in all
    lanes. The first one grows with the lane: what it chooses from, neighbours choose close to each other.
    """
    lanes = sampler.wavefront_size()
    return hammersley(sampler, dr.arange(UInt32, lanes), lanes, UInt32(0))


def hammersley(sampler: Any, number: UInt32, count: int, shared: UInt32) -> Point2f:
    """Random points of the unit square, by their numbers in sets of `count` that are spread evenly.

    The first coordinate is jittered, the second one shifted by what is drawn for the lanes `shared`, one for each set.
    """
    x = (Float(number) + sampler.next_1d()) / count
    y = Float(dr.brev(number)) * 2.0**-32 + dr.gather(Float, sampler.next_1d(), shared)
    return Point2f(dr.minimum(x, BELOW_ONE), y - dr.floor(y))


def lens_points(camera: Any, seed: Any, spp: int) -> list[Point2f]:
    """Samples of the aperture, as many as there should be points of the lens to look through; one without a lens.

    The set of Hammersley, shifted at random: each point is uniform in the unit square.
    """
    if not camera.needs_aperture_sample():
        return [Point2f(0)]
    count = min(max(spp // 4, 1), MOST_LENS_POINTS)
    sampler = camera.sampler().clone()
    sampler.seed(seed, 1)
    shift, number = sampler.next_2d(), dr.arange(UInt32, count)
    x = Float(number) / count + shift.x
    y = Float(dr.brev(number)) * 2.0**-32 + shift.y
    dr.eval(x, y)
    return [Point2f(*(dr.gather(Float, v - dr.floor(v), UInt32(k)) for v in (x, y))) for k in range(count)]

"""The first radius of photons, from what a sensor sees.

Some camera rays are followed to the first surfaces that scatter light, and some light paths leave photons. The radius
is such that a ball about a point that is seen holds a certain number of photons on average: more of them take time
for little, and a wider ball blurs more. Where photons are few, the width of what is seen sets the limit. So neither the
size of the scene nor anything that stands outside of the picture counts, and nothing depends on the seed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.records import BSDFContext, Ray3f
from djpt.integrators.photons import PhotonMap
from djpt.integrators.photons.photon_mapping import scatters
from djpt.jit.kernels import loop_traced_once, wide
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32
from djpt.rendering.schedules.job import Job
from djpt.samplers.independent import IndependentStream
from djpt.samplers.seeds import sample_tea_32

__all__ = ["Seen", "radius_of_crowd", "seen_from"]

SIDE = 32
"""Rows and columns of the camera rays."""

ASIDE = 1 / SIDE
"""From a ray to that of the next column, in shares of the picture."""

MOST_EDGES = 32
"""Edges up to the first surface that scatters; paths with more see nothing."""

OF_WIDTH = 1 / 72
"""The largest radius in relation to the width of what is seen."""

OF_DISTANCE = 0.01
"""The largest radius in relation to the distance of what is seen, if all rays are one."""

TRIES = 8
"""Guesses at a radius, at most: the first one counts too many photons, and each of the others fewer."""

MOST_COUNTED = 2**24
"""Photons of light paths with more edges aren't counted."""

TOLERANCE = 1.25
"""A number of photons that is so many times the wanted one is near enough."""


@dataclass
class Seen:
    """The points on surfaces that scatter light which some camera rays lead to, straight or by way of others."""

    p: Point3f
    n: Normal3f
    distance: Float
    """The length of the way from where the ray begins."""
    beside: Float
    """How far away the camera ray of the next column is after the same way, mirrors aside."""
    there: Bool
    """False where a ray leads to no such point."""

    def largest_radius(self) -> float:
        """The largest radius for these points; 0 if there are none."""
        there = np.array(self.there)
        if not there.any():
            return 0.0
        column, distance = (float(np.median(np.array(x, np.float64)[there])) for x in (self.beside, self.distance))
        return OF_WIDTH * SIDE * column if column > 0 else OF_DISTANCE * distance


@dataclass
class Look:
    """Loop state of a camera ray."""

    ray: Ray3f
    sampler: Any
    seen: Any
    active: Bool
    edges: UInt32


def seen_from(job: Job) -> Seen:
    """What the sensor of a job sees, in equal steps over the picture."""
    scene = job.scene
    number = dr.arange(UInt32, SIDE * SIDE) + dr.opaque(UInt32, 0)
    row = number // SIDE
    place = Point2f(Float(number - row * SIDE) + 0.5, Float(row) + 0.5) / SIDE
    seeds = sample_tea_32(dr.opaque(UInt32, 0), number)
    # By the same random numbers: through the same point of a lens.
    sampler = IndependentStream.seeded(*seeds)
    ray, beside = job.ray_at(place, sampler), job.ray_at(place + Point2f(ASIDE, 0), IndependentStream.seeded(*seeds))
    nothing = Seen(Point3f(0), Normal3f(0, 0, 1), Float(0), Float(0), Bool(False))
    state = wide(Look(ray, sampler, nothing, Bool(True), UInt32(0)), SIDE * SIDE)

    def body(look: Look) -> tuple[Look]:
        si = scene.surface_interaction(look.ray, scene.closest_hit(look.ray), full=scene.needs_uv)
        on = look.active & si.is_valid()
        distance = look.seen.distance + dr.select(on, si.t, 0)
        ends = on & scatters(si)
        seen = Seen(si.p, si.n, distance, Float(0), ends)
        bs, _ = si.bsdf().sample(BSDFContext(), si, look.sampler.next_1d(), look.sampler.next_2d(), on)
        return (
            Look(
                ray=si.spawn_ray(si.to_world(bs.wo)),
                sampler=look.sampler,
                seen=dr.select(ends, seen, replace(look.seen, distance=distance)),
                active=on & ~ends & (bs.pdf > 0) & (look.edges + 1 < MOST_EDGES),
                edges=look.edges + 1,
            ),
        )

    (done,) = loop_traced_once(state, lambda look: look.active, body, "seen")
    found: Seen = done.seen
    found.beside = dr.norm(dr.fma(beside.d - ray.d, found.distance, beside.o - ray.o))
    dr.eval(found)
    return found


def radius_of_crowd(seen: Seen, fill: Callable[[PhotonMap], None], paths: int, wanted: float) -> float:
    """The radius within which the points see `wanted` photons on average, or the largest one if they don't see as many.

    Args:
        seen: the points, at least one.
        fill: fills a map with the photons of some light paths.
        paths: the number of those light paths.
        wanted: the number of photons, for as many light paths.
    """
    radius = seen.largest_radius()
    for _ in range(TRIES):
        photon_map = PhotonMap(radius, paths, 1.0)
        fill(photon_map)
        mean = mean_count(seen, photon_map, math.pi * radius**2 * paths)
        if mean <= TOLERANCE * wanted:
            break
        radius *= math.sqrt(wanted / mean)
    return radius


def mean_count(seen: Seen, photon_map: PhotonMap, expected: float) -> float:
    """The photons of a map about a point that is seen, on average; `expected`: what densities are multiplied by."""
    worth = dr.opaque(Float, expected)
    counts = photon_map.density(seen.p, seen.n, UInt32(MOST_COUNTED), seen.there, lambda photon: Color3f(worth))
    return float(np.array(counts.x, np.float64).sum()) / float(np.count_nonzero(np.array(seen.there)))

"""The parts of a disk, or of a ball, in which photons can lie: estimates of 1 / c where the fraction is c.

A sum over the photons of a disk is divided by its area. Where a surface ends within the disk, at an edge or at the
foot of a wall, photons can only lie on the fraction c of it, and the sum is too small by as much: all edges are
dark by a radius. So points of the disk are looked at until one is on the surface. Their number K is 1 nearly
everywhere, and has the mean 1 / c everywhere: sums times K have no such error, since K doesn't depend on the
photons. So it is with balls, at the boundaries of media.

T. E. Booth, "Unbiased Monte Carlo Estimation of the Reciprocal of an Integral", 2007; H. Qin, X. Sun, Q. Hou,
B. Guo and K. Zhou, "Unbiased Photon Gathering for Light Transport Simulation", 2015, use it for other paths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.core.records.flags import SurfaceDetail
from djpt.core.warp import square_to_uniform_disk_concentric, square_to_uniform_sphere
from djpt.integrators.photons.map import FACING, PhotonMap
from djpt.jit.kernels import while_loop, wide
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f
from djpt.samplers.base import SampleStream, go_on_with

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["inverse_coverage", "inverse_coverage_in_medium"]

MOST = 16
"""Points, at most. In the corner of a room, where c = 1/4, one in a hundred such sequences ends too early."""

PRECISION = 2.0**-17
"""The minimum height of ray origins over 1 + the largest coordinate: below it, rounding errors decide what they hit."""


@dataclass
class Search:
    """Loop state."""

    sampler: Any
    points: UInt32
    arrived: Bool
    active: Bool


def inverse_coverage(
    scene: Scene, photons: PhotonMap, si: SurfaceInteraction3f, sampler: SampleStream, active: Bool
) -> Float:
    """An estimate of 1 / c, c being the fraction of the disk about a point where photons count; 1 where not `active`.

    A point of the disk counts if it is seen from the centre along the surface, and the surface there lies near the
    tangent plane and faces the same way. If none is found, because the surface there is smaller than the disk, the
    estimate is 1.
    """
    lanes = dr.width(si.p, active, sampler)
    frame = Frame3f(si.n)
    height, radius = photons.height, photons.radius
    up = si.n * dr.sign(dr.dot(si.n, si.to_world(si.wi)))
    o = dr.fma(up, height, si.p)
    active = active & (height > PRECISION * (1 + dr.max(dr.abs(si.p))))

    def search(search: Search) -> tuple[Search]:
        at = square_to_uniform_disk_concentric(search.sampler.next_2d()) * radius
        # Along the surface, then down to as far below the plane as above it.
        aside = frame.to_world(Vector3f(at.x, at.y, 0))
        length = dr.norm(aside)
        way, down = Ray3f(o, aside * dr.rcp(length), maxt=length), Ray3f(o + aside, -up, maxt=2 * height)
        if "time" in si.__dict__:
            way.time = down.time = si.time
        free = (length > 0) & ~scene.geometry.any_hit(way, search.active)
        there = scene.surface_interaction(down, scene.closest_hit(down), SurfaceDetail.FRAME)
        arrives = free & there.is_valid() & (dr.dot(there.n, si.n) >= FACING)
        points = search.points + 1
        return (Search(search.sampler, points, arrives, search.active & ~arrives & (points < MOST)),)

    return points_until(search, sampler, active, lanes)


def inverse_coverage_in_medium(
    scene: Scene, photons: PhotonMap, p: Point3f, sampler: SampleStream, active: Bool
) -> Float:
    """An estimate of 1 / c, c being the fraction of the ball about a point in a medium that is seen from there.

    1 where not `active`, and where no point is found.
    """
    lanes = dr.width(p, active, sampler)

    def search(search: Search) -> tuple[Search]:
        d = square_to_uniform_sphere(search.sampler.next_2d())
        maxt = photons.radius * dr.cbrt(search.sampler.next_1d())
        arrives = ~scene.geometry.any_hit(Ray3f(p, d, maxt=maxt), search.active)
        points = search.points + 1
        return (Search(search.sampler, points, arrives, search.active & ~arrives & (points < MOST)),)

    return points_until(search, sampler, active, lanes)


def points_until(search: Callable[[Search], tuple[Search]], sampler: SampleStream, active: Bool, lanes: int) -> Float:
    """The number of points until one arrives; 1 where not `active`, and where none does."""
    start = Search(sampler, dr.zeros(UInt32, lanes), dr.full(Bool, False, lanes), wide(active, lanes))
    (done,) = while_loop((start,), lambda search: search.active, search, label="coverage")
    go_on_with(sampler, done.sampler)
    return dr.select(done.arrived, Float(done.points), 1)

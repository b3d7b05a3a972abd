"""The schedule of photon mapping: each pass traces light paths, and then samples that gather their photons."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.records import BSDFContext, Ray3f
from djpt.films.footprint import Splats
from djpt.integrators.photons import PhotonMap, PhotonStore
from djpt.integrators.photons.cells import Box
from djpt.integrators.photons.photon_mapping import PhotonMapping, is_sharp, scatters
from djpt.jit.kernels import loop_traced_once, wide
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.progressive import Lane, follow, lanes
from djpt.rendering.schedules.splatting import SplattedSamples, Splatting
from djpt.samplers.independent import IndependentStream
from djpt.samplers.seeds import sample_tea_32

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Photons", "Seen", "radius_of_crowd", "seen_from"]

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
"""The largest acceptable ratio of the number of photons to the wanted one."""


@dataclass
class Seen:
    """The points on surfaces that scatter light which some camera rays lead to, straight or by way of others."""

    p: Point3f
    n: Normal3f
    distance: Float
    """The length of the way from where the ray begins."""
    beside: Float
    """The distance to the camera ray of the next column after a path of the same length, mirrors aside."""
    there: Bool
    """False where a ray leads to no such point."""
    sharp: Bool
    """True where a mirror, glass or gloss is on the way, or at its end."""

    def sharp_fraction(self) -> float:
        """The fraction of the rays that see by way of mirrors, glass or gloss."""
        return float(np.array(self.sharp).mean())

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
    """The points that the sensor of a job sees, at equal steps over the picture."""
    scene = job.scene
    ray, sampler, beside = camera_rays(job)
    nothing = Seen(Point3f(0), Normal3f(0, 0, 1), Float(0), Float(0), Bool(False), Bool(False))
    state = wide(Look(ray, sampler, nothing, Bool(True), UInt32(0)), SIDE * SIDE)

    def body(look: Look) -> tuple[Look]:
        si = scene.surface_interaction(look.ray, scene.closest_hit(look.ray), scene.surface_detail)
        on = look.active & si.is_valid()
        distance = look.seen.distance + dr.select(on, si.t, 0)
        ends = on & scatters(si)
        sharp = look.seen.sharp | (on & is_sharp(si))
        seen = Seen(si.p, si.n, distance, Float(0), ends, sharp)
        bs, _ = si.bsdf().sample(BSDFContext(), si, look.sampler.next_1d(), look.sampler.next_2d(), on)
        return (
            Look(
                ray=si.spawn_ray(si.to_world(bs.wo)),
                sampler=look.sampler,
                seen=dr.select(ends, seen, replace(look.seen, distance=distance, sharp=sharp)),
                active=on & ~ends & (bs.pdf > 0) & (look.edges + 1 < MOST_EDGES),
                edges=look.edges + 1,
            ),
        )

    (done,) = loop_traced_once(state, lambda look: look.active, body, "seen")
    found: Seen = done.seen
    found.beside = dr.norm(dr.fma(beside.d - ray.d, found.distance, beside.o - ray.o))
    dr.eval(found)
    return found


def camera_rays(job: Job) -> tuple[Ray3f, IndependentStream, Ray3f]:
    """Camera rays at equal steps over the picture, their random numbers, and the rays of the next column."""
    number = dr.arange(UInt32, SIDE * SIDE) + dr.opaque(UInt32, 0)
    row = number // SIDE
    place = Point2f(Float(number - row * SIDE) + 0.5, Float(row) + 0.5) / SIDE
    seeds = sample_tea_32(dr.opaque(UInt32, 0), number)
    # By the same random numbers: through the same point of a lens.
    sampler = IndependentStream.seeded(*seeds)
    return (
        job.ray_at(place, sampler),
        sampler,
        job.ray_at(place + Point2f(ASIDE, 0), IndependentStream.seeded(*seeds)),
    )


def radius_of_crowd(seen: Seen, fill: Callable[[PhotonMap], None], paths: int, wanted: float) -> float:
    """The radius within which the points see `wanted` photons on average, or the largest one if they don't see as many.

    A ball about a point that is seen holds a certain number of photons on average: more of them take time for little,
    and a wider ball blurs more. Where photons are few, the width of what is seen sets the limit. So neither the size of
    the scene nor anything that stands outside of the picture counts, and nothing depends on the seed.

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


STRIPS = {4: 2, 2: 8, 1: 2**32}
"""The rows of a strip, by the most samples per pixel of a pass: a packet then covers about a square."""

APART = 0x9E3779B9
"""Keeps the hashes of passes apart from those of samples."""

FIRST_PATHS = 2**13
"""The light paths, at most, whose photons are counted for the first radius."""

OUTSIDE = 0.005
"""The fraction of photons in media that may lie below the box about them along an axis, and above."""

FIRST_EDGES = 2
"""The edges of camera paths that the box is to hold."""

BESIDE = 0.05
"""The fraction of their ends that may lie below the box along an axis, and above: a box that holds them all would be
wide where a few of them leave the scene."""

MARGIN = 2.0
"""What is added to the box on all sides, in relation to the radius."""

LARGEST_SIDE = 0.01
"""The first radius in relation to the longest side of the box about the scene, if the sensor sees no surface."""


class Photons(Splatting):
    """Runs a `PhotonMapping` pass by pass."""

    name = "photons"

    def samples_with(self, splats: Splats) -> SplattedSamples:
        return PhotonSamples(splats)


class Preparation:
    """What is found out before the first pass of an image, each part when it is first asked for.

    None of it depends on the seed, so that rounds of one image begin alike.
    """

    def __init__(self, job: Job) -> None:
        assert isinstance(job.integrator, PhotonMapping)
        self._job, self._integrator = job, job.integrator

    @cached_property
    def seen(self) -> Seen:
        """The points that the sensor sees."""
        return seen_from(self._job)

    @cached_property
    def pass_size(self) -> int:
        """The samples per pixel of a pass: as few as give each camera path the integrator's light paths, at most."""
        per_sample = self._integrator.paths_for(lambda: self.seen.sharp_fraction())
        return math.ceil(self._integrator.photon_count / (per_sample * self._job.width * self._job.height))

    @cached_property
    def paths(self) -> int:
        """The light paths of a pass."""
        return self._integrator.paths_of_pass(self._job.spp / self.pass_size)

    @cached_property
    def store(self) -> PhotonStore:
        """Memory for the photons of a pass."""
        return self._integrator.store(self._job.scene)

    @property
    def _first_paths(self) -> int:
        """The number of light paths that are followed beforehand."""
        return min(self._integrator.photon_count, FIRST_PATHS)

    @cached_property
    def _photons(self) -> int:
        """The number of the photons of these paths, which are then in the store."""
        scene, integrator = self._job.scene, self._integrator
        # Where photons lie doesn't depend on a radius.
        looking = integrator.looking_at(PhotonMap(1.0, integrator.photon_count, scene.lights.brightness))
        return walk(
            scene, looking, self.store, self._first_paths, sample_tea_32(dr.opaque(UInt32, APART), UInt32(0))[0]
        )

    @cached_property
    def radius(self) -> float:
        """The radius of the first pass: that of the integrator, or one that follows from what the sensor sees."""
        integrator = self._integrator
        if integrator.initial_radius > 0:
            return integrator.initial_radius
        largest = self.seen.largest_radius()
        if largest == 0:
            low, high = (np.array(corner, np.float64).ravel() for corner in self._job.scene.bbox())
            side = float((high - low).max())
            return LARGEST_SIDE * side if 0 < side < np.inf else LARGEST_SIDE
        count = self._photons
        wanted = integrator.crowd * self._first_paths / integrator.photon_count
        return radius_of_crowd(self.seen, lambda photons: photons.fill(self.store, count), self._first_paths, wanted)

    @cached_property
    def box(self) -> Box | None:
        """A box that holds most of the photons in media, along each axis all but a few; None if none is wanted."""
        if not self._integrator.looks_in_box(self._job.scene):
            return None
        radius = self.radius
        places = self.store.places_in_media(self._photons)
        if not len(places):
            return Box.of(np.zeros(3), np.zeros(3))
        low, high = np.quantile(places, (OUTSIDE, 1 - OUTSIDE), axis=0)
        # Where light ends at the same place as the box, blurring across its sides would be one-sided.
        return crossed(self._job, Box.of(low - MARGIN * radius, high + MARGIN * radius))


class PhotonSamples(SplattedSamples):
    """Computes samples with the map of their pass, which is made when they are asked for."""

    def __init__(self, splats: Splats) -> None:
        super().__init__(splats)
        self._prepared: Preparation | None = None
        self._number = -1
        self._looking: PhotonMapping | None = None

    def passes(self, job: Job) -> tuple[int, int]:
        return job.width * job.height, self.prepared(job).pass_size

    def prepared(self, job: Job) -> Preparation:
        """What is found out before the first pass."""
        if self._prepared is None:
            self._prepared = Preparation(job)
        return self._prepared

    def __call__(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        size, parts = self.prepared(job).pass_size, []
        while begin < end:
            number = begin // size
            last = min(end, (number + 1) * size)
            parts.append(self.of_part(job, self.of_pass(job, number), band, begin, last))
            begin = last
        return parts[0] if len(parts) == 1 else [dr.concat(channel) for channel in zip(*parts, strict=True)]

    def of_part(self, job: Job, integrator: PhotonMapping, band: Band, begin: int, end: int) -> list[Float]:
        """The samples begin <= k < end, all of one pass."""
        lanes = NearLanes(job, band, end - begin)
        values = self.values(job, integrator, lanes.pixel, lanes.layer + dr.opaque(UInt32, begin))
        # The next pass has another map, and no kernel runs twice to be put into order.
        with small_blocks():
            dr.eval(values)
        return [dr.gather(Float, value, lanes.place) for value in values]

    def of_pass(self, job: Job, number: int) -> PhotonMapping:
        """The integrator with the map of a pass, 0, 1, .."""
        if number != self._number or self._looking is None:
            prepared = self.prepared(job)
            self._looking = None  # its map's memory is that of the next one
            self._looking = trace(job, prepared, number)
            self._number = number
        return self._looking


class NearLanes:
    """Lanes for `count` samples of each pixel of a band, in such an order that packets look at the same photons.

    The samples of a pixel follow each other, and then those of the pixel below, in strips of a few rows.
    """

    def __init__(self, job: Job, band: Band, count: int) -> None:
        height = next(rows for rows, most in STRIPS.items() if count <= most)
        lane = dr.arange(UInt32, band.rows * job.width * count)
        samples, rows = dr.opaque(UInt32, count), dr.opaque(UInt32, band.rows)
        of_strip, width, first = (
            dr.opaque(UInt32, height * job.width),
            job.width_value,
            dr.opaque(UInt32, band.first_row),
        )

        def strip(number: UInt32) -> tuple[UInt32, UInt32]:
            """The first row of a strip, and how many rows it has."""
            top = number * height
            return top, dr.select(top + height > rows, rows - top, height)

        place = lane // samples
        number = place // of_strip
        top, high = strip(number)
        column = (place - number * of_strip) // high
        row = top + (place - number * of_strip) - column * high
        self.pixel = (row + first) * width + column
        self.layer = lane - place * samples
        """The number of the sample, among those of its pixel."""

        layer = lane // dr.opaque(UInt32, band.rows * job.width)
        pixel = lane - layer * dr.opaque(UInt32, band.rows * job.width)
        row = pixel // width
        top, high = strip(row // height)
        self.place = (top * width + (pixel - row * width) * high + row - top) * samples + layer
        """The lanes in the order [layer][pixel] of stored samples."""


def crossed(job: Job, box: Box) -> Box:
    """The part of a box that most camera paths stay in, on their first edges."""
    scene, ends = job.scene, []
    ray, sampler = camera_rays(job)[:2]
    there = Bool(True)
    for _ in range(FIRST_EDGES):
        si = scene.surface_interaction(ray, scene.closest_hit(ray), scene.surface_detail)
        start, end = box.span(ray.o, ray.d, si.t)
        passes = there & (start < end)
        bs, _ = si.bsdf().sample(BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), there)
        there &= si.is_valid() & (bs.pdf > 0)
        points = [ray(start), ray(end)]
        ray = si.spawn_ray(si.to_world(bs.wo))
        dr.eval(points, passes, ray, there, sampler)
        ends += [np.array(p).T[np.array(passes)] for p in points]
    places = np.concatenate(ends)
    if not len(places):
        return box
    return Box.of(*np.quantile(places, (BESIDE, 1 - BESIDE), axis=0))


def trace(job: Job, prepared: Preparation, number: int) -> PhotonMapping:
    """The integrator with the map of the pass `number`."""
    scene, integrator = job.scene, job.integrator
    assert isinstance(integrator, PhotonMapping)
    paths, box = prepared.paths, prepared.box
    photons = PhotonMap(integrator.radius(prepared.radius, number), paths, scene.lights.brightness, box)
    looking = integrator.looking_at(photons)
    seed, _ = sample_tea_32(job.seed_value, dr.opaque(UInt32, (number + APART) & 0xFFFFFFFF))
    looking.take(prepared.store, walk(scene, looking, prepared.store, paths, seed))
    return looking


def walk(scene: Scene, looking: PhotonMapping, store: PhotonStore, paths: int, seed: UInt32) -> int:
    """Follow light paths, fill the store with their photons, and return the number of those."""

    def fresh(number: UInt32) -> tuple[Any, Any]:
        sampler = IndependentStream.seeded(*sample_tea_32(seed, number))
        return sampler, looking.leave(scene, sampler)

    def step(lane: Lane) -> tuple[Any, Bool]:
        return looking.arrive(scene, lane.sampler, lane.path, store)

    count = None
    while count is None:
        store.clear()
        follow(lanes(paths), paths, fresh, step, store.sinks, "photons")
        count = store.count()
    return count

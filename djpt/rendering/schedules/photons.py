"""The schedule of photons: passes that trace light paths first, and then samples that look at what they have left."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.films.splats import Splats
from djpt.integrators.photons import PhotonMap, PhotonStore
from djpt.integrators.photons.photon_mapping import PhotonMapping
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Bool, Float, UInt32
from djpt.rendering.schedules.first_radius import radius_of_crowd, seen_from
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.progressive import Lane, follow, lanes
from djpt.rendering.schedules.splatting import SplattedSamples, Splatting
from djpt.samplers.independent import IndependentStream
from djpt.samplers.seeds import sample_tea_32

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Photons"]

STRIPS = {4: 2, 2: 8, 1: 2**32}
"""The rows of a strip, by the most samples per pixel of a pass: a packet then covers about a square."""

APART = 0x9E3779B9
"""Keeps the hashes of passes apart from those of samples."""

FIRST_PATHS = 2**15
"""The light paths, at most, whose photons are counted for the first radius."""

LARGEST_SIDE = 0.01
"""The first radius in relation to the longest side of the box about the scene, if the sensor sees no surface."""


class Photons(Splatting):
    """Runs a `PhotonMapping` pass by pass."""

    name = "photons"

    def samples_with(self, splats: Splats) -> SplattedSamples:
        return PhotonSamples(splats)


class PhotonSamples(SplattedSamples):
    """Computes samples with the map of their pass, which is made when they are asked for."""

    def __init__(self, splats: Splats) -> None:
        super().__init__(splats)
        self._store: PhotonStore | None = None
        self._first = 0.0
        self._number = -1
        self._looking: PhotonMapping | None = None

    def passes(self, job: Job) -> tuple[int, int]:
        return job.width * job.height, samples_of_pass(job)

    def __call__(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        size, parts = samples_of_pass(job), []
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
            if self._store is None:
                assert isinstance(job.integrator, PhotonMapping)
                self._store = PhotonStore(
                    job.integrator.id(), job.integrator.photon_count, job.integrator.weighs_photons
                )
                self._first = first_radius(job, self._store)
            self._looking = None  # its map's memory is that of the next one
            self._looking = trace(job, self._store, self._first, number)
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


def samples_of_pass(job: Job) -> int:
    """The samples per pixel of a pass: as few as give each camera path `paths_per_sample` light paths, at most."""
    assert isinstance(job.integrator, PhotonMapping)
    return -(-job.integrator.photon_count // (job.integrator.paths_per_sample * job.width * job.height))


def first_radius(job: Job, store: PhotonStore) -> float:
    """The radius of the first pass: that of the integrator, or one that follows from what the sensor sees."""
    scene, integrator = job.scene, job.integrator
    assert isinstance(integrator, PhotonMapping)
    if integrator.initial_radius > 0:
        return integrator.initial_radius
    seen = seen_from(job)
    largest = seen.largest_radius()
    if largest == 0:
        low, high = (np.array(corner, np.float64).ravel() for corner in scene.bbox())
        side = float((high - low).max())
        return LARGEST_SIDE * side if 0 < side < np.inf else LARGEST_SIDE
    # Whatever the seed is: rounds of one image begin alike.
    paths = min(integrator.photon_count, FIRST_PATHS)
    looking = integrator.looking_at(PhotonMap(largest, integrator.photon_count, scene.lights.brightness))
    count = walk(scene, looking, store, paths, sample_tea_32(dr.opaque(UInt32, APART), UInt32(0))[0])
    wanted = integrator.crowd * paths / integrator.photon_count
    return radius_of_crowd(seen, lambda photons: photons.fill(store, count), paths, wanted)


def trace(job: Job, store: PhotonStore, first: float, number: int) -> PhotonMapping:
    """The integrator with the map of the pass `number`; `first` is the radius of the first pass."""
    scene, integrator = job.scene, job.integrator
    assert isinstance(integrator, PhotonMapping)
    paths = integrator.photon_count
    photons = PhotonMap(integrator.radius(first, number), paths, scene.lights.brightness)
    looking = integrator.looking_at(photons)
    seed, _ = sample_tea_32(job.seed_value, dr.opaque(UInt32, (number + APART) & 0xFFFFFFFF))
    photons.fill(store, walk(scene, looking, store, paths, seed))
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

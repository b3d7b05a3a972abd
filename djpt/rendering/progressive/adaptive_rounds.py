"""Rounds over tiles: the kernels of adaptive renders.

The tiles stand one above the other on a grid of their own, which schedules fill as they fill any grid. What a sample
is, its random numbers and its camera ray, follows from its pixel on the image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.garbage import without_garbage
from djpt.core.records import Ray3f
from djpt.description.registry import name_of, registered
from djpt.errors import RenderError, near_miss
from djpt.integrators.base import Integrator
from djpt.jit.kernels import begin_trace, shared, while_loop
from djpt.jit.llvm.results import Results
from djpt.jit.types import Float, Int32, Point2f, UInt32
from djpt.rendering.gradients.leaves import attached_parameters
from djpt.rendering.image import make_job, require_still
from djpt.rendering.progressive.rounds import constant_of, inputs, round_seed
from djpt.rendering.progressive.tiles import Counts, Tiles, TileSums
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.called_sums import Taps, reader, usable
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.flat import Flat, called_film_sums
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.memory import check_memory
from djpt.rendering.schedules.passes import computed, one_ahead
from djpt.rendering.schedules.reconstruction import MAX_SUMS, Read, add_by_pixels
from djpt.rendering.settings import RenderSettings
from djpt.rfilters.base import is_wide
from djpt.samplers import SampleIndex, SampleStream
from djpt.scene.scene import Scene

__all__ = ["AdaptiveRounds", "TileJob"]

Floats = npt.NDArray[np.float32]

IN_TILES = frozenset({"flat", "wave"})
"""The schedules that compute pixels independently; an integrator that has one of them can render tiles."""

PIXELS = 2**16
"""The pixels of the tiles that are computed at once: a film's sums are up to half a kilobyte for each."""

REPEATED = 2**20
"""The numbers of rounds end here; those of a tile that a round samples again follow."""

STORED_SAMPLES = 2**22
"""Samples whose values are held at once."""


class AdaptiveRounds:
    """The rounds of one image over tiles.

    The samples of a tile in a round are those of `render` with the round's seed. If the round samples the tile again,
    they have the seed of a round that no render reaches.

    Raises:
        RenderError: The image can't be rendered in tiles.
    """

    def __init__(self, scene: Scene, settings: RenderSettings) -> None:
        self._scene, self._settings = scene, settings
        integrator = settings.integrator
        if type(integrator).render is not Integrator.render or not IN_TILES & {*integrator.schedules}:
            kinds = registered("integrator").items()
            # Named are those that follow paths, for which it is worth while.
            able = (name for name, kind in kinds if "flat" in getattr(kind, "schedules", ()))
            name = name_of(type(integrator)) or type(integrator).__name__
            raise RenderError(f"the integrator '{name}' can't render adaptively{near_miss('', able)}")
        require_still(scene, settings.sensor)
        begin_trace()
        job = self._job()
        check_memory(job)
        if not job.sampler.has_streams:
            raise RenderError(f"{job.sampler.id()} has no separate stream per sample, which adaptive renders need")
        if choose(settings.schedule, job).name == "machine":
            self._settings = replace(settings, schedule="flat")
        problem = reason_against(job, choose(self._settings.schedule, job))
        if problem:
            raise RenderError(f"the render can't be adaptive: {problem}")
        border = job.film.border
        width, height = job.film.crop_size()
        grid = int(width) + 2 * border, int(height) + 2 * border
        self.tiles = Tiles(grid, border, job.film.taps // 2)
        self._filters, self._constant = job.film.filters, constant_of(job)
        self._inputs: list[Any] = []
        self._recorded: dict[int, Callable[..., list[Float]]] | None = None
        if integrator.is_pure() and not attached_parameters(job.scene):
            self._recorded = {}

    @property
    def _together(self) -> int:
        """The tiles that are computed at once."""
        return max(1, PIXELS // (self.tiles.width * self.tiles.height))

    @property
    def small(self) -> bool:
        """True if all tiles are computed at once."""
        return self.tiles.count <= self._together

    def _job(self) -> Job:
        """The job of a round over the whole image, of which tiles are parts; they have seeds of their own."""
        return make_job(self._scene, replace(self._settings, seed=0, progress=None, interruption=None))

    def begin(self, number: int, places: Counts, watched: bool) -> Callable[[], TileSums]:
        """Launch the kernels of a round that samples the tiles `places`, in order; the result waits for them.

        If the round is `watched`, progress is shown and signals are noticed meanwhile.
        """
        progress, interruption = (self._settings.progress, self._settings.interruption) if watched else (None, None)
        _, first = np.unique(places, return_index=True)
        again = np.arange(len(places)) - np.repeat(first, np.diff(first, append=len(places)))
        seeds = [round_seed(self._settings.seed, number + REPEATED * k) for k in again.tolist()]
        size, parts = self._together, []
        for start in range(0, len(places), size):
            parts.append(self._launch(places[start : start + size], seeds[start : start + size]))
            if interruption is not None or progress is not None or start >= 2 * size:
                # Never far ahead of the kernels: what all of them need must not pile up in memory.
                dr.sync_thread()
            if interruption is not None:
                interruption.check()
            if progress is not None:
                progress(start + len(places[start : start + size]), len(places))

        results = Results()

        def result() -> TileSums:
            films = [self._on_host(part, results) for part in parts]
            parts.clear()
            if len(films) > 1:
                # What kernels took is needed for sums of 64 bits.
                dr.flush_malloc_cache()
            return TileSums(places, films, self._constant)

        return result

    def _launch(self, places: Counts, seeds: list[int]) -> list[Float]:
        """Launch the kernels of some tiles."""
        begin_trace()
        count = len(seeds)
        numbers = [copied(np.array(values, np.uint32)) for values in (places, seeds)]
        with dr.suspend_grad():
            if self._recorded is None:
                return self._films([], *numbers)
            if count not in self._recorded:
                # The first time they are only traced: what kernels call is compiled then.
                self._recorded[count] = dr.freeze(self._films, auto_opaque=False)
                films = self._films([], *numbers)
                self._inputs = inputs(self._scene, self._settings.sensor, self._settings.integrator)
                return films
            with without_garbage():
                return self._recorded[count](self._inputs, *numbers)

    def _films(self, inputs: list[Any], places: UInt32, seeds: UInt32) -> Any:
        """The films of some tiles by `film_sums`; `inputs` is what their kernels read."""
        with dr.suspend_grad():
            tiles = TileJob.of(self._job(), self.tiles, places, seeds)
            return film_sums(tiles, choose(self._settings.schedule, tiles))

    def _on_host(self, part: list[Float], results: Results) -> list[Floats]:
        """The films of some tiles: for each channel, the last being the weight, (tiles, height, width)."""
        films = [results.numpy(sums).reshape(-1, *self.tiles.film) for sums in part]
        return films if self._filters else [*films, np.broadcast_to(np.float32(self._settings.spp), films[0].shape)]


def copied(numbers: npt.NDArray[np.uint32]) -> UInt32:
    """A copy of an array in memory of Dr.Jit's own, which doesn't wait for kernels."""
    result = shared(numbers) ^ dr.opaque(UInt32, 0)
    dr.eval(result)
    return result


# ---- the kernels of a round -------------------------------------------------------------------


@dataclass
class TileJob(Job):
    """Some tiles of an image. A tile may be there several times, with different seeds."""

    tiles: Tiles = field(kw_only=True)
    places: UInt32 = field(kw_only=True)
    """The number of each of the tiles."""
    seeds: UInt32 = field(kw_only=True)
    """The seed of each."""

    @staticmethod
    def of(job: Job, tiles: Tiles, places: UInt32, seeds: UInt32) -> TileJob:
        """The job of some tiles of a job's image."""
        given = {f.name: getattr(job, f.name) for f in fields(Job) if f.init}
        own = seeds + dr.opaque(UInt32, job.sampler.base_seed)
        dr.eval(own)
        return TileJob(**given, tiles=tiles, places=places, seeds=own)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._row_size = self.width_value
        self._last = [dr.opaque(UInt32, n - 1) for n in self.tiles.grid]
        self._columns = dr.opaque(UInt32, self.tiles.columns)
        self._height = dr.opaque(UInt32, self.tiles.height)
        self.width, self.height = self.tiles.width, self.tiles.height * dr.width(self.places)
        self.width_value = dr.opaque(UInt32, self.width)
        self._found: Any = (None,)

    def corner(self, entry: UInt32) -> tuple[UInt32, UInt32]:
        """The first column and row of an entry's tile on the image's grid."""
        tile = dr.gather(UInt32, self.places, entry)
        row = tile // self._columns
        return (tile - row * self._columns) * self.width_value, row * self._height

    def _place(self, pixel: UInt32) -> tuple[UInt32, UInt32, UInt32, UInt32]:
        """Column and row on the image's grid, pixel there, seed.

        Loops ask for each sample of lanes that stay at a pixel: what was computed before the loop isn't computed again.
        """
        if self._found[0] is not pixel:
            row = pixel // self.width_value
            entry = row // self._height
            left, top = self.corner(entry)
            # Tiles may reach beyond the grid, where nothing is kept.
            x = dr.minimum(left + pixel - row * self.width_value, self._last[0])
            y = dr.minimum(top + row - entry * self._height, self._last[1])
            found = x, y, dr.fma(y, self._row_size, x), dr.gather(UInt32, self.seeds, entry)
            if dr.flag(dr.JitFlag.SymbolicScope):
                return found
            self._found = pixel, *found
        return self._found[1:]

    def stream(self, pixel: UInt32, k: UInt32) -> SampleStream:
        _, _, real, seed = self._place(pixel)
        return self.sampler.stream(seed, SampleIndex(real, k, self.spp_value, self._row_size))

    def coordinates(self, pixel: UInt32) -> tuple[Float, Float]:
        x, y, _, _ = self._place(pixel)
        return Float(Int32(x)), Float(Int32(y))

    def sampled_ray(self, stream: SampleStream, pixel: UInt32, x: Float, y: Float) -> tuple[Ray3f, Point2f]:
        return super().sampled_ray(stream, self._place(pixel)[2], x, y)


def reason_against(job: Job, schedule: Schedule) -> str:
    """The reason why an image can't be rendered in tiles; an empty string if there is none."""
    if not isinstance(schedule, Flat):
        return f"the schedule '{schedule.name}' computes an image as a whole"
    if not job.channel_names():
        return "no channel is sampled"
    if is_wide(job.film.taps):
        return f"the film's filter reaches {job.film.taps // 2} pixels"
    return ""


def film_sums(job: TileJob, schedule: Schedule) -> list[Float]:
    """The sums of the tiles' films by channel, the weight being the last one with a filter: [entry][row][column]."""
    if not job.film.filters:
        parts = [rows.sums for rows, _ in schedule.rows(job)]
        return parts[0] if len(parts) == 1 else [dr.concat(list(channel)) for channel in zip(*parts, strict=True)]
    channels = job.channel_count()
    high, wide = job.tiles.film
    lanes = dr.width(job.places) * high * wide
    sums = [dr.opaque(Float, 0, lanes) for _ in range(channels + 1)]
    band, taps = Band(0, job.height), Taps(job.film.taps, channels)
    if type(schedule) is Flat and usable(taps, job.film.rfilter()):
        memory = called_film_sums(job, band, 0, job.spp, None)[0]
        groups = dr.width(memory) // (taps.sums * job.width * job.height)
        return spread(job, groups, lambda row: reader(memory, taps, row), sums)
    # As many channels at once as have sums near the registers.
    together = max(1, MAX_SUMS // taps.count**2 - 1)
    of_taps: list[list[Float]] = []
    for begin, end in passes(job):
        samples = computed(schedule.samples, job, band, begin, end)
        parts = [samples[first : first + together] for first in range(0, channels, together)]
        before = of_taps or [None] * len(parts)  # type: ignore[list-item]
        of_taps = [add_by_pixels(job, band, part, begin, end, b) for part, b in zip(parts, before, strict=True)]
    found: list[Float] = []
    for part in of_taps:
        count = len(part) // taps.count**2
        found = found[:-1] + spread(job, 1, lambda row, part=part: stored(part, taps.count, row), sums[:count])
    return found


def passes(job: TileJob) -> Iterator[tuple[int, int]]:
    """The passes (begin, end) of a job whose samples are stored."""
    size = max(1, STORED_SAMPLES // (job.width * job.height))
    for begin in one_ahead(range(0, job.spp, size)):
        yield begin, min(begin + size, job.spp)


def stored(sums: list[Float], taps: int, row: int) -> Read:
    """Reads the sums of pixels for a row tap: see `djpt.rendering.schedules.reconstruction.add_by_pixels`."""
    channels = len(sums) // taps**2

    def tap(lane: UInt32, column: int, active: Any) -> list[Float]:
        first = (row * taps + column) * channels
        return [dr.gather(Float, sums[first + c], lane, active) for c in range(channels)]

    return tap


def spread(job: TileJob, groups: int, read: Any, sums: list[Float]) -> list[Float]:
    """Add to the pixels of the tiles' films what the `groups` of lanes of the tiles' pixels hold for them."""
    tiles, taps = job.tiles, job.film.taps
    high, wide = (dr.opaque(UInt32, n) for n in tiles.film)
    index = dr.arange(UInt32, dr.width(sums[0]))
    row = index // wide
    entry = row // high
    column, line = Int32(index - row * wide), Int32(row - entry * high)
    left, top = job.corner(entry)
    # What lies beyond the grid has been sampled for nothing.
    columns = dr.minimum(Int32(job.width_value), Int32(job._last[0] + 1 - left))
    rows = dr.minimum(Int32(job._height), Int32(job._last[1] + 1 - top))
    width, first = Int32(job.width_value), Int32(entry * job._height)
    count = dr.opaque(UInt32, groups)
    for j in range(taps):
        tap, y = read(j), line - dr.opaque(Int32, j)

        def body(group: UInt32, sums: list[Float], tap: Read = tap, y: Int32 = y) -> tuple[UInt32, list[Float]]:
            result = list(sums)
            for i in range(taps):
                x = column - i
                inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
                # The lanes of a pixel stand side by side.
                parts = tap(dr.fma(UInt32((first + y) * width + x), count, group), i, inside)
                result = [total + part for total, part in zip(result, parts, strict=True)]
            return group + 1, result

        start = dr.zeros(UInt32, dr.width(index))
        _, sums = while_loop((start, sums), lambda group, sums: group < count, body, label="tile spread")
    dr.eval(sums)
    return sums

"""Rounds: the parts of a render that can be continued at any time.

A round is the image of `render` with a number of samples per pixel that all rounds of a render share, and with a seed
of its own. So the first rounds of a long render are those of a short one. A last round may be smaller.

Parts of the samples of one seed wouldn't do: as in Mitsuba the numbers of sample k of a pixel depend on how many the
pixel has in all, which isn't known if a render stops at an error or after a time, or is continued later.
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
from djpt.integrators.base import Integrator
from djpt.jit.frozen import Holder
from djpt.jit.kernels import begin_trace
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.llvm.results import Results
from djpt.jit.types import Array3f, Float, Point2f, UInt32
from djpt.rendering.gradients.leaves import attached_parameters
from djpt.rendering.gradients.own_rendering import image_by_itself
from djpt.rendering.image import centres, make_job, require_still
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.called_sums import CalledSums, Taps, prepare_function, usable
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.flat import Flat, run, spread_called
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import Lanes, lanes_per_pixel
from djpt.rendering.schedules.memory import check_memory
from djpt.rendering.schedules.passes import filtered_rows
from djpt.rendering.schedules.reconstruction import Rows, Summed
from djpt.rendering.schedules.sinks import CalledFilmSums, Finished
from djpt.rendering.settings import RenderSettings
from djpt.samplers import SampleStream
from djpt.samplers.seeds import Seed
from djpt.scene.scene import Scene

__all__ = ["RoundSums", "Rounds", "constant_of", "inputs", "round_seed"]

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]

RECORDED_SAMPLES = 2**24
"""The samples of the largest rounds whose kernels are recorded: tracing them matters less and less in larger ones."""

PORTION = 2**8
"""The lanes of recorded kernels that a thread takes at a time: few, so that none waits long at the end of a round."""


def round_seed(seed: int, number: int) -> int:
    """The seed of a round: ``(seed + mix(number)) mod 2^32``, with the finaliser of MurmurHash3 (A. Appleby) as `mix`.

    `mix` is a bijection with mix(0) = 0: round 0 has the seed itself, and no two of 2^32 rounds have the same one.
    """
    h = number & 0xFFFFFFFF
    h = (h ^ h >> 16) * 0x85EBCA6B & 0xFFFFFFFF
    h = (h ^ h >> 13) * 0xC2B2AE35 & 0xFFFFFFFF
    return (seed + (h ^ h >> 16)) & 0xFFFFFFFF


@dataclass(frozen=True)
class RoundSums:
    """The image of a round before it is divided by its weights."""

    sums: Floats | Doubles
    """Weighted sums, (channels, height, width)."""
    weights: Floats
    """Their weights, (height, width), or (1, 1) if all pixels have the same."""
    constant: Floats
    """The channels that come from the centres of pixels, the same in each round: (height, width, channels)."""


class Rounds:
    """The rounds of one image.

    Python traces the kernels of the first two rounds; those of the others are recorded and launched again with other
    seeds (`dr.freeze`), which takes no time, if the image is small enough to be computed in one band.
    """

    def __init__(self, scene: Scene, settings: RenderSettings) -> None:
        self._scene, self._settings = scene, settings
        self.spp = settings.spp
        """Samples per pixel of a whole round."""
        self._job: Job | None = None
        """The job of a round that was computed in one band."""
        self._constant: Floats | None = None
        self._pixels_per_lane = 1
        """The pixels of a lane of the recorded kernels."""
        self._inputs: list[Any] = []
        """The arrays that they read."""
        self._recorded: Callable[..., list[Float]] = dr.freeze(self._one_band, auto_opaque=False)

    @property
    def small(self) -> bool:
        """True if a round is known to be small enough to be computed in one band."""
        return self._job is not None

    def begin(self, seed: int, spp: int = 0, watched: bool = False) -> Callable[[], RoundSums]:
        """Launch the kernels of a round of `spp` samples per pixel, 0: of a whole one; the result waits for them.

        Kernels run meanwhile. If the round is `watched`, progress is shown and signals are noticed after each pass.
        """
        scene, spp = self._scene, spp or self.spp
        if self._job is not None and not watched and spp == self.spp:
            return self._launched_again(self._job, seed)
        begin_trace()
        settings = self._of_round(seed, spp, watched)
        if type(settings.integrator).render is not Integrator.render:
            return waiting_for_image(image_by_itself(scene, None, settings), spp)
        require_still(scene, settings.sensor)
        job = make_job(scene, settings)
        how = choose(settings.schedule, job)
        check_memory(job)
        if self._constant is None:
            self._constant = constant_of(job)
        constant = self._constant
        with dr.suspend_grad():
            if job.channel_names() and not how.in_bands:
                return waiting_for_image(how.image(job), spp, constant)
            summed = list(how.rows(job)) if job.channel_names() else []
        if len(summed) == 1 and how.can_be_recorded and can_be_recorded(job) and spp == self.spp:
            self._job, self._pixels_per_lane = job, pixels_per_lane(job, how)
            self._inputs = inputs(scene, settings.sensor, settings.integrator)

        results = Results()

        def result() -> RoundSums:
            sums = sums_of_rows(job, summed, results)
            if len(summed) > 1:
                # What large bands took is needed for sums of 64 bits.
                summed.clear()
                dr.flush_malloc_cache()
            return RoundSums(*sums, constant)

        return result

    def _of_round(self, seed: Seed, spp: int, watched: bool = False) -> RenderSettings:
        """The settings of a round."""
        settings = replace(self._settings, seed=seed, spp=spp)
        return settings if watched else replace(settings, progress=None, interruption=None)

    def _launched_again(self, job: Job, seed: int) -> Callable[[], RoundSums]:
        """Launch the recorded kernels with another seed; the first time they are traced."""
        begin_trace()
        # Garbage may hold arrays of NumPy's: see `djpt.jit.frozen.hold_garbage`, which this function hears nothing of.
        with dr.suspend_grad(), without_garbage(), small_blocks(PORTION):
            sums = self._recorded(self._inputs, dr.opaque(UInt32, seed))
        assert self._constant is not None
        weight = sums[-1] if job.film.filters else dr.opaque(Float, self.spp)
        summed, results = [(Rows(0, job.height, sums), weight)], Results()
        constant = self._constant
        return lambda: RoundSums(*sums_of_rows(job, summed, results), constant)

    def _one_band(self, inputs: list[Any], seed: UInt32) -> list[Float]:
        """The sums of a round that is computed in one band, by channel; `inputs` is what its kernels read."""
        settings = self._of_round(seed, self.spp)
        job = replace(make_job(self._scene, settings), repeated=True)
        with dr.suspend_grad():
            if self._pixels_per_lane > 1:
                ((rows, _),) = multi_pixel_rows(MultiPixelJob.of(job, self._pixels_per_lane))
            else:
                ((rows, _),) = choose(settings.schedule, job).rows(job)
        return rows.sums


def inputs(*holders: Holder) -> list[Any]:
    """The arrays that kernels read of some objects, as they are now.

    A frozen function that took the objects would traverse them at each call.
    """
    return [array for holder in holders for array in holder.held[1:]]


def can_be_recorded(job: Job) -> bool:
    """True if the kernels of a round can be launched again without Python.

    Integrators that aren't pure, and samplers without streams, may do anything between kernels, and parameters with
    gradients may change.
    """
    return (
        job.samples <= RECORDED_SAMPLES
        and job.integrator.is_pure()
        and job.sampler.has_streams
        and not attached_parameters(job.scene)
    )


def waiting_for_image(image: Any, spp: int, constant: Floats | None = None) -> Callable[[], RoundSums]:
    """The sums of a round of which only the image is known: each sample has the weight 1."""

    def result() -> RoundSums:
        values = np.moveaxis(image.numpy(), 2, 0).astype(np.float64) * spp
        height, width = values.shape[1:]
        of_centres = np.zeros((height, width, 0), np.float32) if constant is None else constant
        return RoundSums(values, np.full((1, 1), spp, np.float32), of_centres)

    return result


def sums_of_rows(job: Job, summed: list[Summed], results: Results) -> tuple[Floats, Floats]:
    """The sums and the weights of the pixels of a film, without its border; `results` reads them."""
    border, (width, height) = job.film.border, job.film.crop_size()
    sums = np.zeros((job.channel_count(), height, width), np.float32)
    weights = np.zeros((height, width) if job.film.filters else (1, 1), np.float32)
    for rows, weight in summed:
        top, end = max(rows.first_row, border), min(rows.first_row + rows.count, border + height)
        if end <= top:
            continue
        inside = slice(top - rows.first_row, end - rows.first_row), slice(border, border + width)
        target = slice(top - border, end - border)
        for channel, values in zip(sums, rows.sums, strict=False):
            channel[target] = results.numpy(values)[: rows.count * job.width].reshape(rows.count, job.width)[inside]
        if job.film.filters:
            weights[target] = results.numpy(weight)[: rows.count * job.width].reshape(rows.count, job.width)[inside]
        else:
            weights[...] = results.numpy(weight)
    return sums, weights


def constant_of(job: Job) -> Floats:
    """The channels of a job that come from the centres of its pixels."""
    width, height = job.film.crop_size()
    if not job.integrator.unfiltered_names():
        return np.zeros((height, width, 0), np.float32)
    return np.asarray(centres(job).numpy(), np.float32)


LONGEST = 8
"""The most pixels of a lane."""

LANES = 2**13
"""The lanes that each thread has at least."""


def pixels_per_lane(job: Job, schedule: Schedule) -> int:
    """The number of pixels that a lane computes; 1 if lanes can't have several.

    Without a filter sums stay in registers, and lanes at their pixels: sums in memory would take longer. Ask before
    kernels are recorded: the function that adds samples to films is compiled.
    """
    taps = Taps(job.film.taps, job.channel_count())
    pixels, count = job.width * job.height, 1
    if type(schedule) is not Flat or not job.film.filters or not usable(taps, job.film.rfilter()):
        return 1
    if lanes_per_pixel(pixels, job.spp) > 1:
        return 1
    while count < LONGEST and job.height % (2 * count) == 0 and pixels // (2 * count) >= LANES * dr.thread_count():
        count *= 2
    if count > 1:
        prepare_function(taps, job.film.rfilter())
    return count


@dataclass
class MultiPixelJob(Job):
    """A job whose samples are numbered over the pixels of a lane: `height / pixels_per_lane` rows apart.

    The lanes of a packet end together, when the longest of their sums of paths has ended. With 64 samples per lane that
    is 4 % of the time, with 256 it is 1 %. The samples are added up in memory, pixel by pixel in the order of plain
    images, so the sums have the same bits.
    """

    pixels_per_lane: int = field(kw_only=True)
    """The pixels of a lane."""

    @staticmethod
    def of(job: Job, pixels_per_lane: int) -> MultiPixelJob:
        """A job with lanes of so many pixels."""
        return MultiPixelJob(
            **{f.name: getattr(job, f.name) for f in fields(Job) if f.init}, pixels_per_lane=pixels_per_lane
        )

    def __post_init__(self) -> None:
        super().__post_init__()
        rows = self.height // self.pixels_per_lane
        self.step = dr.opaque(UInt32, rows * self.width)
        self._rows, self._share = dr.opaque(Float, rows), dr.opaque(Float, 1 / self.spp)

    def begin(self, pixel: UInt32, k: UInt32, x: Float, y: Float) -> tuple[SampleStream, Ray3f, Any]:
        """As in `Job`; the third number of the offset is the index of the pixel within the lane."""
        turn = dr.floor((Float(k) + 0.5) * self._share)
        number = UInt32(turn)
        real = dr.fma(number, self.step, pixel)
        stream = self.stream(real, k - number * self.spp_value)
        ray, offset = self.sampled_ray(stream, real, x, self.row(y, turn))
        return stream, ray, Array3f(offset.x, offset.y, turn)

    def row(self, y: Float, turn: Float) -> Float:
        """The row of a pixel of a lane whose first one is in row `y`."""
        return dr.fma(turn, self._rows, y)


class MultiPixelSums(CalledFilmSums):
    """Adds the samples of lanes to the sums of their pixels."""

    def __init__(self, job: MultiPixelJob, pixel: UInt32, sums: CalledSums, steps: int) -> None:
        x, y = job.coordinates(pixel)
        super().__init__(job.on_film(x, y), sums, steps)
        self._job, self._pixel, self._x, self._y = job, pixel, x, y

    def close(self, state: list[Any], waiting: Finished | None) -> list[Any]:
        assert waiting is not None
        place: Any = waiting.offset
        corner = self._job.on_film(self._x, self._job.row(self._y, place.z))
        slot = dr.fma(UInt32(place.z), self._job.step, self._pixel)
        taken = self._sums.add(corner, Point2f(place.x, place.y), waiting.channels, waiting.full, slot)
        return [state[0] + dr.select(taken, UInt32(1), 0)]


def multi_pixel_rows(job: MultiPixelJob) -> Iterator[Summed]:
    """The sums of a job's image in one band: see `djpt.rendering.schedules.base.Schedule.rows`."""
    return filtered_rows(job, multi_pixel_sums, spread=spread_called)


def multi_pixel_sums(job: Job, band: Band, begin: int, end: int, memory: list[Float] | None) -> list[Float]:
    """The film's sums of all samples of a job."""
    assert isinstance(job, MultiPixelJob)
    pixels = job.width * job.height
    taps = Taps(job.film.taps, job.channel_count())
    pixel = dr.arange(UInt32, pixels // job.pixels_per_lane)
    lanes = Lanes(pixel, dr.opaque(UInt32, 0), dr.opaque(UInt32, job.pixels_per_lane * job.spp), dr.opaque(UInt32, 1))
    sums = CalledSums(taps, job.film.rfilter(), pixels)
    # See `djpt.rendering.schedules.flat.called_film_sums`.
    steps = 1 if job.scene.geometry.has_trees else 2
    count = run(job, lanes, MultiPixelSums(job, pixel, sums, steps))
    with small_blocks():
        dr.eval(count)
    return [sums.memory]

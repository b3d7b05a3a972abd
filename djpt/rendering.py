"""`render`: from a scene to an image."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr

from djpt.errors import RenderError, near_miss
from djpt.films.reconstruction import add_box, add_rows, spread
from djpt.hashing import sample_tea_32
from djpt.integrators import Path
from djpt.integrators.base import Integrator, PathIntegrator
from djpt.description.properties import Properties
from djpt.scene import Scene
from djpt.schedules import flat, wave
from djpt.schedules.job import MAX_SAMPLES, Band, Job, Progress
from djpt.types import Float, TensorXf, UInt32

__all__ = ["render"]

SCHEDULES = ("auto", "flat", "wave")

PASS_SAMPLES = 2**26
"""Samples of one kernel launch when nothing is stored: about a second on two cores."""

STORED_SAMPLES = 2**21
"""Samples whose values are held at once: they should stay in the last-level cache."""

BAND_PIXELS = 2**16
"""Pixels of a band when samples are stored."""


def render(
    scene: Scene,
    params: Any = None,
    sensor: Any = 0,
    integrator: Any = None,
    seed: int = 0,
    seed_grad: int = 0,
    spp: int = 0,
    spp_grad: int = 0,
    *,
    schedule: str = "auto",
    progress: Progress | None = None,
    pass_spp: int = 0,
) -> TensorXf:
    """Render an image: TensorXf of shape (height, width, channels), linear float32, row 0 on top.

    The image is a function of (scene, spp, seed) and nothing else: not of passes, threads or time.
    If parameters of the scene have gradients enabled, the image is attached to them, in forward
    and reverse mode.

    Args:
        scene: What `load_dict` returned.
        params: What `traverse(scene)` returned; accepted as in Mitsuba. Gradients reach every
            attached parameter of the scene, listed here or not.
        sensor: Index into ``scene.sensors()``, or a sensor.
        integrator: An integrator in place of the scene's (default: the scene's, else `path`).
        seed: Seed of the image, 0 <= seed < 2^32.
        seed_grad: Seed of the samples that estimate the gradient; 0 derives one from `seed`.
        spp: Samples per pixel; 0 takes the sampler's `sample_count`.
        spp_grad: Samples per pixel for the gradient; 0 takes `spp`.
        schedule: `flat` (lanes are pixels; needs an integrator that advances vertex by vertex),
            `wave` (lanes are samples) or `auto`.
        progress: Called with (samples done, samples in all) after each pass.
        pass_spp: Samples per pixel of one pass; 0 chooses. Changes time and memory, never the image.

    Raises:
        RenderError: Nothing to render, or arguments out of range.
    """
    job = make_job(scene, sensor, integrator, seed, spp, progress)
    check_count("spp_grad", spp_grad)
    check_count("pass_spp", pass_spp)
    use_flat = choose_schedule(schedule, job.integrator)
    return render_primal(job, use_flat, pass_spp)


def make_job(scene: Scene, sensor: Any, integrator: Any, seed: int, spp: int, progress: Progress | None) -> Job:
    """Check the arguments of `render` and put the pieces together."""
    if not isinstance(scene, Scene):
        raise RenderError(f"render() expects a scene from load_dict(), found {type(scene).__name__}")
    sensors = scene.sensors()
    if not hasattr(sensor, "sample_ray"):
        if not isinstance(sensor, int) or isinstance(sensor, bool):
            raise RenderError(f"'sensor' must be an index or a sensor, found {type(sensor).__name__}")
        if not sensors:
            raise RenderError("the scene has no sensor: add one, for example {'type': 'perspective'}")
        if not -len(sensors) <= sensor < len(sensors):
            raise RenderError(f"the scene has {len(sensors)} sensors; there is no number {sensor}")
        sensor = sensors[sensor]
    integrator = integrator or scene.integrator() or Path(Properties("path", "integrator", {}))
    if not isinstance(integrator, Integrator):
        raise RenderError(f"'integrator' must be an integrator plugin, found {type(integrator).__name__}")
    check_count("spp", spp)
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**32:
        raise RenderError(f"'seed' must be a whole number with 0 <= seed < 2^32, found {seed!r}")
    if not scene.emitters() and integrator.needs_light:
        raise RenderError("the scene has no emitter: the image would be black")
    spp = spp or sensor.sampler.sample_count
    job = Job(scene, sensor, sensor.film, integrator, sensor.sampler, seed, spp, progress)
    if job.samples > MAX_SAMPLES:
        raise RenderError(
            f"{job.width} x {job.height} pixels at {spp} spp are more than 2^32 samples; "
            "render fewer spp under several seeds and average the images"
        )
    return job


def check_count(name: str, value: int) -> None:
    """Whole and not negative, or RenderError."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise RenderError(f"'{name}' must be a whole number, 1 or more (0 = default), found {value!r}")


def choose_schedule(schedule: str, integrator: Integrator) -> bool:
    """True for `flat`, False for `wave`."""
    if schedule not in SCHEDULES:
        raise RenderError(f"unknown schedule '{schedule}'{near_miss(str(schedule), SCHEDULES)}")
    possible = isinstance(integrator, PathIntegrator)
    if schedule == "flat" and not possible:
        raise RenderError(
            f"the integrator '{type(integrator).__name__}' doesn't advance vertex by vertex: use schedule='wave'"
        )
    return possible and schedule != "wave"


def render_primal(job: Job, use_flat: bool, pass_spp: int) -> TensorXf:
    """The image without derivatives."""
    with dr.suspend_grad():
        if use_flat and not job.film.filters:
            sums = flat_sums(job, pass_spp)
            return develop(job, sums, Float(dr.opaque(Float, job.spp)))
        samples = flat.radiance_samples if use_flat else wave.radiance_samples
        if job.film.filters:
            *sums, weight = filtered_sums(job, samples, pass_spp)
            return develop(job, sums, weight)
        sums = [dr.concat(parts) for parts in zip(*box_sums(job, samples, pass_spp), strict=True)]
        return develop(job, sums, Float(dr.opaque(Float, job.spp)))


def flat_sums(job: Job, pass_spp: int) -> list[Float]:
    """All samples, added up in registers."""
    sums = None
    for begin, end in passes(job.spp, pass_spp or max(1, PASS_SAMPLES // (job.width * job.height))):
        sums = flat.radiance_sums(job, begin, end, sums)
        report(job, end * job.width * job.height)
    assert sums is not None
    return flat.total(job, sums)


def box_sums(job: Job, samples: Any, pass_spp: int) -> Iterator[list[Float]]:
    """Per band, all samples added up pixel by pixel."""
    for band in job.bands(BAND_PIXELS):
        sums = None
        for begin, end in passes(job.spp, pass_spp or stored_spp(job, band)):
            sums = add_box(job, band, samples(job, band, begin, end), begin, end, sums)
            report(job, (band.first_row * job.spp + band.rows * end) * job.width)
        assert sums is not None
        yield sums


def filtered_sums(job: Job, samples: Any, pass_spp: int) -> list[Float]:
    """The weighted sums of all channels and of the weights, over the whole grid."""
    image = [dr.zeros(Float, job.width * job.height) for _ in range(job.channel_count() + 1)]
    for band in job.bands(BAND_PIXELS):
        rows = None
        for begin, end in passes(job.spp, pass_spp or stored_spp(job, band)):
            rows = add_rows(job, band, samples(job, band, begin, end), begin, end, rows)
            report(job, (band.first_row * job.spp + band.rows * end) * job.width)
        assert rows is not None
        image = spread(job, band, rows, image)
    return image


def stored_spp(job: Job, band: Band) -> int:
    """Samples per pixel that a pass over `band` may store."""
    return max(1, STORED_SAMPLES // (band.rows * job.width))


def passes(spp: int, size: int) -> Iterator[tuple[int, int]]:
    """Split 0 .. spp into ranges of at most `size`."""
    for begin in range(0, spp, size):
        yield begin, min(begin + size, spp)


def report(job: Job, done: int) -> None:
    """Tell the caller's progress function; waits for the kernel, so that the number is true."""
    if job.progress is not None:
        dr.sync_thread()
        job.progress(done, job.samples)


def develop(job: Job, sums: list[Float], weight: Float) -> TensorXf:
    """Weighted sums over weights, cropped: the image."""
    border, (width, height) = job.film.border, job.film.crop_size
    weight = dr.select(weight == 0, 1, weight)
    channels = [s / weight for s in sums]
    if border:
        pixel = dr.arange(UInt32, width * height)
        row = pixel // width
        source = (row + border) * job.width + (pixel - row * width) + border
        dr.eval(channels)
        channels = [dr.gather(Float, c, source) for c in channels]
    dr.eval(channels)
    count = len(channels)
    flat_image = dr.empty(Float, width * height * count)
    slot = dr.arange(UInt32, width * height) * count
    for c, channel in enumerate(channels):
        dr.scatter(flat_image, channel, slot + c)
    return TensorXf(flat_image, shape=(height, width, count))


def gradient_seed(seed: int, seed_grad: int) -> int:
    """The seed of the gradient pass: as in Mitsuba, a hash of `seed` unless one is given."""
    if seed_grad:
        return seed_grad
    return int(sample_tea_32(UInt32(seed), UInt32(1))[0][0])

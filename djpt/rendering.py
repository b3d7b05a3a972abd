"""`render`: from a scene to an image."""

from __future__ import annotations

import operator
import warnings
from dataclasses import replace
from typing import Any

import drjit as dr

from djpt.description.properties import Properties
from djpt.errors import RenderError, near_miss
from djpt.gradients.derivatives import differentiable_image, gradient_seed
from djpt.gradients.leaves import attached_parameters
from djpt.integrators import Integrator, ParticleTracer, Path
from djpt.kernels import begin_trace
from djpt.records import BSDFFlags, EmitterFlags, has_flag
from djpt.scene import Scene
from djpt.schedules.job import MAX_SAMPLES, Job, Progress
from djpt.schedules.light import splat_image
from djpt.schedules.passes import Schedule, picture, primal_image
from djpt.types import TensorXf

__all__ = ["channel_names", "render"]

SCHEDULES = ("auto", "flat", "machine", "wave")


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
        schedule: `flat` (lanes are pixels), `machine` (lanes walk through a BVH, each at its own
            pace), both for integrators that advance vertex by vertex; `wave` (lanes are samples); or
            `auto`: the fastest.
        progress: Called with (samples done, samples in all) after each pass.
        pass_spp: Samples per pixel of one pass; 0 chooses. Changes time and memory, never the image.

    Raises:
        RenderError: Nothing to render, or arguments out of range.
    """
    begin_trace()
    job = make_job(scene, sensor, integrator, seed, spp, progress)
    seed_grad = check_seed("seed_grad", seed_grad)
    spp_grad = check_count("spp_grad", spp_grad)
    pass_spp = check_count("pass_spp", pass_spp)
    chosen = choose_schedule(schedule, job)
    parameters = attached_parameters(scene)
    if isinstance(job.integrator, ParticleTracer) and not parameters:
        straight = replace(job, integrator=job.integrator.straight, progress=None)
        return primal_image(straight, chosen, pass_spp) + splat_image(job)
    if not parameters:
        return with_unfiltered(job, primal_image(job, chosen, pass_spp) if job.channel_names() else None)
    if not job.integrator.differentiable:
        raise RenderError(
            f"'{type(job.integrator).__name__}' as it is set up can't be differentiated; a plain 'path' or 'prb' can"
        )
    gradient_job = replace(job, seed=gradient_seed(job.seed, seed_grad), spp=spp_grad or job.spp, progress=None)
    machine = chosen == "machine"
    if not job.channel_names():
        return with_unfiltered(job, None)
    image = differentiable_image(gradient_job, parameters, lambda: primal_image(job, chosen, pass_spp), machine)
    return with_unfiltered(job, image)


def with_unfiltered(job: Job, image: TensorXf | None) -> TensorXf:
    """An image with the channels of its integrator that come from the centres of pixels; None: no others."""
    if not job.integrator.unfiltered_names():
        assert image is not None
        return image
    with dr.suspend_grad():
        width, height = job.film.crop_size
        values = job.integrator.unfiltered_channels(job.scene, job.centre_rays())
        dr.eval(values)
        centres = picture(values, width, height)
    return centres if image is None else dr.concat([image, centres], axis=2)


def channel_names(scene: Scene, sensor: Any = 0, integrator: Any = None) -> tuple[str, ...]:
    """Names of the channels of what `render` returns with the same arguments.

    ``("R", "G", "B")`` and the like for colours, then those of the integrator's AOVs: what
    `djpt.write` takes as `channels`.
    """
    job = make_job(scene, sensor, integrator, seed=0, spp=0, progress=None)
    return job.channel_names() + tuple(job.integrator.unfiltered_names())


def make_job(scene: Scene, sensor: Any, integrator: Any, seed: int, spp: int, progress: Progress | None) -> Job:
    """Check the arguments of `render` and put the pieces together."""
    if not isinstance(scene, Scene):
        raise RenderError(f"render() expects a scene from load_dict(), found {type(scene).__name__}")
    sensors = scene.sensors()
    if not hasattr(sensor, "sample_ray"):
        number = whole(sensor)
        if number is None:
            raise RenderError(f"'sensor' must be an index or a sensor, found {type(sensor).__name__}")
        if not sensors:
            raise RenderError("the scene has no sensor: add one, for example {'type': 'perspective'}")
        if not 0 <= number < len(sensors):
            raise RenderError(f"the scene has {len(sensors)} sensors; there is no number {number}")
        sensor = sensors[number]
    if sensor.on_shape and sensor.shape is None:
        raise RenderError(f"'{sensor.id}' must be nested in a shape of the scene to be rendered")
    if sensor not in sensors:
        sensor.set_bounds(*scene.bounding_sphere())
    integrator = integrator or scene.integrator() or Path(Properties("path", "integrator", {}))
    if not isinstance(integrator, Integrator):
        hint = "; load it with djpt.load_dict first" if isinstance(integrator, dict) else ""
        raise RenderError(f"'integrator' must be an integrator plugin, found {type(integrator).__name__}{hint}")
    spp, seed = check_count("spp", spp), check_seed("seed", seed)
    if not scene.emitters() and integrator.needs_light:
        raise RenderError("the scene has no emitter: the image would be black")
    integrator.check_scene(scene, sensor)
    warn_of_delta(scene, integrator)
    warn_of_unseen_lights(scene, integrator)
    spp = sensor.sampler.round_count(spp or sensor.sampler.sample_count)
    for start in sensor.starts():
        scene.geometry.seen_from(start)
    scene = scene.seen_from(sensor.viewpoint()).choosing_emitters(integrator.emitter_choice)
    if integrator.measures_distance:
        scene = scene.viewed_by(sensor)
    job = Job(scene, sensor, sensor.film, integrator, sensor.sampler, seed, spp, progress)
    if job.samples > MAX_SAMPLES:
        raise RenderError(
            f"{job.width} x {job.height} pixels at {spp} spp are more than 2^32 samples; "
            "render fewer spp under several seeds and average the images"
        )
    return job


def warn_of_delta(scene: Scene, integrator: Integrator) -> None:
    """Tell once of materials that the integrator can't show."""
    if integrator.shows_delta:
        return
    names = [bsdf.id for bsdf in scene.bsdfs.plugins if has_flag(bsdf.flags(), BSDFFlags.Delta)]
    if names:
        warnings.warn(
            f"'{type(integrator).__name__}' without BSDF samples can't show mirrors, smooth glass or openings: "
            f"these lobes of {', '.join(names)} stay black",
            stacklevel=4,
        )


def warn_of_unseen_lights(scene: Scene, integrator: Integrator) -> None:
    """Tell once of lights that no path from the camera meets."""
    if integrator.starts_at_lights or not integrator.needs_light:
        return
    delta = [e for e in scene.emitters() if has_flag(e.flags(), EmitterFlags.Delta)]
    beams = [e.id for e in delta if e.on_shape]
    points = [] if integrator.samples_lights else [e.id for e in delta if not e.on_shape]
    for names, problem in (
        (beams, "can't show light that leaves a surface in one direction only"),
        (points, "doesn't sample lights, and finds none that is a point or shines in one direction by chance"),
    ):
        if names:
            black = f"{', '.join(names)} stay{'s' if len(names) == 1 else ''} black"
            warnings.warn(f"'{type(integrator).__name__}' {problem}: {black}", stacklevel=4)


def whole(value: Any) -> int | None:
    """Python's or another library's integer as an int; None for anything else."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None


def check_count(name: str, value: Any) -> int:
    """Whole and not negative, or RenderError."""
    count = whole(value)
    if count is None or count < 0:
        raise RenderError(f"'{name}' must be a whole number, 1 or more (0 = default), found {value!r}")
    return count


def check_seed(name: str, value: Any) -> int:
    """Whole and of 32 bits, or RenderError."""
    seed = whole(value)
    if seed is None or not 0 <= seed < 2**32:
        raise RenderError(f"'{name}' must be a whole number with 0 <= {name} < 2^32, found {value!r}")
    return seed


def choose_schedule(schedule: str, job: Job) -> Schedule:
    """The schedule that was asked for, or the fastest that is possible."""
    if schedule not in SCHEDULES:
        raise RenderError(f"unknown schedule '{schedule}'{near_miss(str(schedule), SCHEDULES)}")
    stepwise, has_tree = job.integrator.stepwise, job.scene.geometry.triangles is not None
    if schedule in ("flat", "machine") and not stepwise:
        raise RenderError(
            f"the integrator '{type(job.integrator).__name__}' doesn't advance vertex by vertex: use schedule='wave'"
        )
    if schedule == "machine" and not has_tree:
        raise RenderError("the schedule 'machine' walks a BVH, and the scene has no meshes: use schedule='flat'")
    if schedule == "flat":
        return "flat"
    if schedule == "wave" or not stepwise:
        return "wave"
    return "machine" if has_tree else "flat"

"""`render`: from a scene to an image."""

from __future__ import annotations

import contextlib
import importlib
import operator
from typing import Any

import drjit as dr

from djpt.description.frozen import recording
from djpt.description.properties import Properties
from djpt.display.progress import Progress, watched
from djpt.errors import RenderError
from djpt.gradients.leaves import attached_parameters, prepare_tables, unused_values
from djpt.integrators import Integrator, Path
from djpt.kernels import begin_trace
from djpt.process.interruption import Interruption, interruptible
from djpt.samplers import Sampler
from djpt.samplers.seeds import Seed
from djpt.scene import Scene
from djpt.schedules.base import Schedule
from djpt.schedules.called_sums import prepare_sums
from djpt.schedules.canvas import picture
from djpt.schedules.choice import choose
from djpt.schedules.job import MAX_SAMPLES, Job, image_channels
from djpt.schedules.memory import check_memory
from djpt.sensors import Sensor
from djpt.types import TensorXf, UInt32
from djpt.working_frame.twin import carried, twin

__all__ = ["channel_names", "film_image", "find_sensor", "image_derivative", "noticing", "render"]


def render(
    scene: Scene,
    params: Any = None,
    sensor: Any = 0,
    integrator: Any = None,
    seed: Seed = 0,
    seed_grad: Seed = 0,
    spp: int = 0,
    spp_grad: int = 0,
    *,
    schedule: str = "auto",
    progress: Progress | bool | None = None,
    pass_spp: int = 0,
    keep_partial: bool = False,
    denoise: bool | str = False,
    adaptive: bool = False,
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
        seed: Seed of the image, 0 <= seed < 2^32: a number, or an array of one.
        seed_grad: Seed of the samples that estimate the gradient; 0 derives one from `seed`.
        spp: Samples per pixel; 0 takes the sampler's `sample_count`.
        spp_grad: Samples per pixel for the gradient; 0 takes `spp`.
        schedule: `flat` (lanes are pixels), `machine` (lanes walk through a BVH, or track rays through
            media, each at its own pace), both for integrators that advance vertex by vertex; `wave` (lanes are
            samples); or `auto`: the fastest.
        progress: Called with (samples done, samples in all) after each pass; True shows a bar, in notebooks
            and in terminals.
        pass_spp: Samples per pixel of one pass; 0 chooses. Changes time and memory, never the image.
        keep_partial: What a signal leaves, SIGINT (Ctrl-C) or SIGTERM: with True the film keeps the image of the
            samples that have been computed until the pass at hand has ended, ``sensor.film().develop()``. Integrators
            of scripts that render by themselves keep nothing.
        denoise: True or a method of `djpt.denoise`: remove the noise. Samples are counted with the box filter then,
            because denoisers need pixels whose noise is independent; albedo and normals are rendered along; and
            the film keeps the noisy image, ``sensor.film().develop()``. Such images have no derivatives.
        adaptive: Take more samples where there is more noise, `spp` on average, without bias: the last image of
            `render_passes`, which says more. Such images have no derivatives, and `pass_spp` has no effect.

    Raises:
        BackendError: The denoiser isn't installed.
        RenderError: Nothing to render, or arguments out of range.
        KeyboardInterrupt: SIGINT, after the pass at hand. With `keep_partial`, `djpt.Terminated` (a `SystemExit`) for
            SIGTERM.
    """
    if dr.flag(dr.JitFlag.SymbolicScope):
        raise RenderError("no image can be rendered within a loop, a call or a condition that Dr.Jit records")
    if denoise:
        from djpt.denoising.rendered import render_denoised

        method = "oidn" if denoise is True else denoise
        options = {
            "schedule": schedule,
            "progress": progress,
            "pass_spp": pass_spp,
            "keep_partial": keep_partial,
            "adaptive": adaptive,
        }
        return render_denoised(scene, method, sensor, integrator, seed, spp, options)
    if adaptive:
        # What is built on top of this file is imported when it is first used.
        above: Any = importlib.import_module("djpt.long_renders.adaptive_image")
        image: TensorXf = above.render_adaptively(
            scene, sensor, integrator, seed, spp, schedule, progress, keep_partial
        )
        return image
    begin_trace()
    seed_grad, spp_grad = check_seed("seed_grad", seed_grad), check_count("spp_grad", spp_grad)
    estimator = find_integrator(scene, integrator)
    if type(estimator).render is not Integrator.render:
        from djpt.gradients.own_rendering import image_by_itself

        camera, (seed, spp) = find_sensor(scene, sensor), (check_seed("seed", seed), check_count("spp", spp))
        return image_by_itself(estimator, scene, params, camera, seed, spp, seed_grad, spp_grad)
    with watched(progress, "rendering", "samples") as shown, noticing(keep_partial) as interruption:
        image = film_image(
            scene, sensor, estimator, seed, spp, seed_grad, spp_grad, schedule, pass_spp, shown, interruption
        )
        if interruption is not None:
            interruption.leave("the film keeps what exists")
        return image


def noticing(keep_partial: bool) -> contextlib.AbstractContextManager[Interruption | None]:
    """Notice signals if something is to be kept then; otherwise they do what they do to any script."""
    return interruptible(keeps=True) if keep_partial else contextlib.nullcontext()


def film_image(
    scene: Scene,
    sensor: Any,
    integrator: Integrator,
    seed: Seed,
    spp: int,
    seed_grad: Seed | None = 0,
    spp_grad: int = 0,
    schedule: str = "auto",
    pass_spp: int = 0,
    progress: Progress | None = None,
    interruption: Interruption | None = None,
) -> TensorXf:
    """The image of an integrator that djpt runs by a schedule; the film keeps it, too.

    Arguments as for `render`; the `seed_grad` None is that of the image.
    """
    require_still(scene)
    job = make_job(scene, sensor, integrator, seed, spp, check_count("pass_spp", pass_spp), progress, interruption)
    how = choose(schedule, job)
    parameters = attached_parameters(job.scene)
    check_memory(job, attached=bool(parameters))
    if not job.channel_names():
        image = centres(job)
        job.film.keep(image, channel_names(scene, sensor, integrator))
        return image
    unused = unused_values(job.scene, parameters)
    if parameters or unused:
        from djpt.gradients.derivatives import differentiable

        image = differentiable(job, how, parameters, unused, seed_grad, spp_grad)
    else:
        image = primal(job, how)
    if job.integrator.unfiltered_names():
        image = dr.concat([image, centres(job)], axis=2)
    job.film.keep(image, channel_names(scene, sensor, integrator))
    return image


def image_derivative(
    scene: Scene, integrator: Integrator, sensor: Any, seed: Seed, spp: int, grad: TensorXf | None
) -> TensorXf:
    """The derivative of an image by samples of the seed itself, for `Integrator.render_forward` and `.._backward`.

    Gradients of the image, `grad`, are propagated to the scene's parameters; if it is None, gradients of these are
    propagated to the image, whose gradient (H, W, C) is returned.
    """
    from djpt.gradients.derivatives import attached_image, derivative_of

    begin_trace()
    require_still(scene)
    job = make_job(scene, sensor, integrator, seed, spp)
    width, height = job.film.crop_size()
    shape = (height, width, job.channel_count())
    parameters = attached_parameters(job.scene)
    check_memory(job, attached=True)
    if not parameters:
        return dr.zeros(TensorXf, shape)
    derivative = derivative_of(job, choose("auto", job), parameters)
    image = attached_image(parameters, [], lambda: dr.zeros(TensorXf, shape), derivative)
    if grad is None:
        dr.forward_to(image)
        return dr.grad(image)
    dr.set_grad(image, grad)
    dr.enqueue(dr.ADMode.Backward, image)
    dr.traverse(dr.ADMode.Backward)
    return image


def primal(job: Job, schedule: Schedule) -> TensorXf:
    """The image of a job, without derivatives."""
    with dr.suspend_grad():
        return schedule.image(job)


def centres(job: Job, first_row: int = 0, rows: int | None = None) -> TensorXf:
    """The channels of an integrator that come from the centres of pixels, of some rows or all: (rows, W, C)."""
    with dr.suspend_grad():
        width, height = job.film.crop_size()
        rows = height if rows is None else rows
        values = job.integrator.unfiltered_channels(job.scene, job.centre_rays(first_row, rows))
        dr.eval(values)
        return picture(values, width, rows)


def channel_names(scene: Scene, sensor: Any = 0, integrator: Any = None) -> tuple[str, ...]:
    """Names of the channels of what `render` returns with the same arguments.

    First those of the colour, such as ``("R", "G", "B")``, then those of the integrator's AOVs.
    `djpt.write` takes them as `channels`.
    """
    film = find_sensor(scene, sensor).film()
    estimator = find_integrator(scene, integrator)
    return (*image_channels(film, estimator), *estimator.unfiltered_names(), *estimator.layer_names())


def prepare_to_record(scene: Scene) -> None:
    """Make what a frozen function can't make when it renders a scene, and what needs the values of parameters."""
    integrator = find_integrator(scene, None)
    for sensor in scene.sensors():
        prepare_sums(sensor.film(), integrator)
        sensor.film().reserve(channel_names(scene, sensor))
        rendered, its_sensor = carried(scene, sensor) if integrator.fits_any_frame() else (scene, sensor)
        for view in (rendered, rendered.with_media()):
            view.seen_by(its_sensor)
    prepare_tables(scene)
    for shape in scene.shapes():
        shape.make_parameters()
    found = twin(scene)
    for prepared in (scene,) if found is None else (scene, found[1]):
        integrator.prepare_scene(prepared.choosing_emitters(integrator.emitter_choice))


# ---- what is rendered -------------------------------------------------------------------------


def make_job(
    scene: Scene,
    sensor: Any,
    integrator: Any,
    seed: Seed,
    spp: int,
    pass_spp: int = 0,
    progress: Progress | None = None,
    interruption: Interruption | None = None,
) -> Job:
    """Check the arguments of `render` and put the pieces together: views of the scene, never a change to it."""
    sensor, integrator = find_sensor(scene, sensor), find_integrator(scene, integrator)
    sampler = sensor.sampler()
    spp, seed = check_count("spp", spp), check_seed("seed", seed)
    shines = scene.emitters() or (integrator.follows_media and scene.every_medium.emit)
    if integrator.needs_light and not shines:
        raise RenderError("the scene has no emitter: the image would be black")
    integrator.check_scene(scene, sensor)
    integrator.resume()
    if integrator.fits_any_frame():
        scene, sensor = carried(scene, sensor)
    spp = sampler.round_count(spp or sampler.sample_count())
    if integrator.follows_media:
        scene = scene.with_media()
    scene = scene.seen_by(sensor).choosing_emitters(integrator.emitter_choice)
    if integrator.measures_distance:
        scene = scene.measured_from(sensor)
    return job_of(sampler)(
        scene, sensor, sensor.film(), integrator, sampler, seed, spp, progress, pass_spp, interruption
    )


def job_of(sampler: Sampler) -> type[Job]:
    """The kind of job that a sampler needs."""
    if sampler.has_streams:
        return Job
    from djpt.schedules.wavefront import WavefrontJob

    return WavefrontJob


def require_scene(scene: Any) -> None:
    """Raise `RenderError` unless `scene` is one."""
    if not isinstance(scene, Scene):
        raise RenderError(f"render() expects a scene from load_dict(), found {type(scene).__name__}")


def require_still(scene: Scene) -> None:
    """Raise `RenderError` if a parameter that places a shape has gradients, which few integrators can follow."""
    require_scene(scene)
    moving = next((shape for shape in scene.shapes() if shape.is_moving()), None)
    if moving is not None:
        able = "'volprim_rf_basic'" if moving.is_ellipsoids() else "'direct_projective' or 'prb_projective'"
        raise RenderError(
            f"'{moving.id()}' moves with parameters that have gradients: render with the integrator {able}"
        )


def find_sensor(scene: Scene, sensor: Any) -> Sensor:
    """The sensor to render: one of the scene, by number, or another one, which is told how large the scene is."""
    require_scene(scene)
    sensors = scene.sensors()
    if not isinstance(sensor, Sensor):
        number = whole(sensor)
        if number is None:
            raise RenderError(f"'sensor' must be an index or a sensor, found {type(sensor).__name__}")
        if not sensors:
            raise RenderError("the scene has no sensor: add one, for example {'type': 'perspective'}")
        if not 0 <= number < len(sensors):
            raise RenderError(f"there is no sensor {number}: the scene has {len(sensors)}, numbered from 0")
        sensor = sensors[number]
    found: Sensor = sensor
    if found.on_shape and found.shape is None:
        raise RenderError(f"'{found.id()}' must be nested in a shape of the scene to be rendered")
    if found not in sensors:
        found.set_bounds(*scene.bounding_sphere())
    return found


def find_integrator(scene: Scene, integrator: Any) -> Integrator:
    """The integrator that was asked for, or the scene's, or else `path`."""
    require_scene(scene)
    if integrator is None:
        integrator = scene.integrator() or Path(Properties("path", "integrator", {}))
    if not isinstance(integrator, Integrator):
        hint = "; load it with djpt.load_dict first" if isinstance(integrator, dict) else ""
        raise RenderError(f"'integrator' must be an integrator plugin, found {type(integrator).__name__}{hint}")
    return integrator


# ---- numbers ------------------------------------------------------------------------------------


def whole(value: Any) -> int | None:
    """Python's or another library's integer, or a Dr.Jit array of one, as an int; None for anything else."""
    if dr.is_array_v(value) and dr.is_integral_v(value) and dr.width(value) == 1:
        value = value[0]
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None


def check_count(name: str, value: Any) -> int:
    """The value as an int; raises `RenderError` unless it is whole, not negative and fits into 32 bits."""
    count = whole(value)
    if count is None or count < 0:
        raise RenderError(f"'{name}' must be a whole number, 1 or more (0 = default), found {value!r}")
    if count >= MAX_SAMPLES:
        raise RenderError(f"'{name}' must be below 2^32, found {value!r}")
    return count


def check_seed(name: str, value: Any) -> Seed:
    """The value as an int; raises `RenderError` unless it is whole and fits into 32 bits.

    An array stays one where `dr.freeze` records: the next call of the frozen function may bring another value.
    """
    if recording() and dr.is_jit_v(value) and dr.is_integral_v(value) and dr.depth_v(value) == 1:
        if dr.width(value) != 1:
            raise RenderError(f"'{name}' must be one whole number, found {dr.width(value)}")
        return UInt32(value)
    seed = whole(value)
    if seed is None or not 0 <= seed < 2**32:
        raise RenderError(f"'{name}' must be a whole number with 0 <= {name} < 2^32, found {value!r}")
    return seed

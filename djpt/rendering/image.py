"""Images and their derivatives, from a scene and the integrator that djpt runs on it by a schedule."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.errors import RenderError
from djpt.integrators.base import Integrator
from djpt.jit.kernels import begin_trace
from djpt.jit.types import Float, TensorXf
from djpt.rendering.gradients.leaves import Parameter, attached_parameters, placing, prepare_tables, unused_values
from djpt.rendering.gradients.refusals import require_proven
from djpt.rendering.known_images import known_or
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.called_sums import prepare_sums
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.job import Job, image_channels
from djpt.rendering.schedules.memory import check_memory
from djpt.rendering.schedules.reconstruction import picture
from djpt.rendering.settings import RenderSettings, find_integrator
from djpt.samplers import Sampler
from djpt.scene.instance_copies import with_copies
from djpt.scene.normalization.normalized_scene import normalized, normalized_scene
from djpt.scene.scene import Scene, find_sensor, require_scene

__all__ = [
    "centres",
    "channel_names",
    "film_image",
    "image_derivative",
    "make_job",
    "prepare_to_record",
    "primal",
    "require_still",
]


def film_image(scene: Scene, settings: RenderSettings) -> TensorXf:
    """The image of an integrator that djpt runs by a schedule; the film keeps it, too."""
    require_still(scene, settings.sensor, settings.integrator)
    scene, job, parameters, motion = begun(scene, settings)
    names = channel_names(scene, settings.sensor, settings.integrator)
    how = choose(settings.schedule, job)
    check_memory(job, attached=bool(parameters or motion))
    if not job.channel_names():
        image = centres(job)
        job.film.keep(image, names)
        return image
    unused = unused_values(job.scene, parameters)
    if parameters or motion or unused:
        scene = with_copies(scene) if motion else scene
        require_proven(scene, job.integrator, settings.sensor)
        from djpt.rendering.gradients.choice import differentiable

        image = differentiable(job, how, scene, settings, parameters, motion, unused)
    else:
        image = known_or(settings, lambda: primal(job, how))
    if job.integrator.unfiltered_names():
        image = dr.concat([image, centres(job)], axis=2)
    job.film.keep(image, names)
    return image


def image_derivative(scene: Scene, settings: RenderSettings, grad: TensorXf | None) -> TensorXf:
    """The derivative of an image by samples of the seed itself, for `Integrator.render_forward` and `.._backward`.

    Gradients of the image, `grad`, are propagated to the scene's parameters; if it is None, gradients of these are
    propagated to the image, whose gradient (H, W, C) is returned.
    """
    from djpt.rendering.gradients.choice import derivative_of, with_motion
    from djpt.rendering.gradients.derivatives import attached_image, propagated

    begin_trace()
    require_still(scene, settings.sensor, settings.integrator)
    scene, job, parameters, motion = begun(scene, settings)
    width, height = job.film.crop_size()
    shape = (height, width, job.channel_count())
    check_memory(job, attached=True)
    if not parameters and not motion:
        return dr.zeros(TensorXf, shape)
    scene = with_copies(scene) if motion else scene
    require_proven(scene, settings.integrator, settings.sensor)
    derivative = with_motion(derivative_of(job, choose(settings.schedule, job), parameters), scene, settings, motion)
    every = [*parameters, *motion]
    return propagated(attached_image(every, [], lambda: dr.zeros(TensorXf, shape), derivative), grad)


def begun(scene: Scene, settings: RenderSettings) -> tuple[Scene, Job, list[Parameter], list[Parameter]]:
    """The scene as it is rendered, its job, the parameters with gradients, and those that place the sensor."""
    if placing_shapes(scene, settings.integrator):
        scene = with_copies(scene)
    job = make_job(scene, settings)
    parameters = [*attached_parameters(job.scene), *placing_shapes(job.scene, job.integrator)]
    return scene, job, parameters, placing(settings.sensor.members())


def placing_shapes(scene: Scene, integrator: Integrator) -> list[Parameter]:
    """The parameters that place shapes and have gradients; where paths don't follow them, `require_still` refuses."""
    return placing(scene.shapes()) if integrator.follows_shapes else []


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
        rendered, its_sensor = normalized(scene, sensor) if integrator.fits_any_frame() else (scene, sensor)
        for all_media in (False, True):
            rendered.replace(all_media=all_media, sensor=its_sensor)
    prepare_tables(scene)
    for shape in scene.shapes():
        shape.make_parameters()
    found = normalized_scene(scene)
    for prepared in (scene,) if found is None else (scene, found[1]):
        integrator.prepare_scene(prepared.replace(emitter_choice=integrator.emitter_choice))


# ---- what is rendered -------------------------------------------------------------------------


def make_job(scene: Scene, settings: RenderSettings) -> Job:
    """Put the pieces of a render together: views of the scene, never a change to it.

    Raises:
        RenderError: The integrator can't render the scene, or there would be nothing to see.
    """
    sensor, integrator = settings.sensor, settings.integrator
    sampler = sensor.sampler()
    shines = scene.emitters() or (integrator.follows_media and scene.every_medium.emit)
    if integrator.needs_light and not shines:
        raise RenderError("the scene has no emitter: the image would be black")
    integrator.check_scene(scene, sensor)
    if scene.geometry.overlaps and not integrator.follows_overlaps:
        raise RenderError(
            f"'{type(integrator).__name__}' doesn't follow bodies that overlap, and shapes of the scene have a "
            "'priority'; possible: the integrators 'path' and 'volpath'"
        )
    if (scene.moves or sensor.moves) and not integrator.follows_motion:
        raise RenderError(
            f"'{type(integrator).__name__}' renders what moves in slices of time, which only whole images have: use "
            "djpt.render, or an integrator that starts at the camera, such as 'path'"
        )
    integrator.resume()
    if integrator.fits_any_frame() and not placing_shapes(scene, integrator):
        scene, sensor = normalized(scene, sensor)
    scene = scene.replace(
        emitter_choice=integrator.emitter_choice,
        all_media=integrator.follows_media,
        sensor=sensor,
        near_clip_fraction=dr.opaque(Float, sensor.near_clip_fraction()) if integrator.measures_distance else None,
    )
    return job_of(sampler)(
        scene,
        sensor,
        sensor.film(),
        integrator,
        sampler,
        settings.seed,
        settings.sample_count,
        settings.progress,
        settings.pass_spp,
        settings.interruption,
    )


def job_of(sampler: Sampler) -> type[Job]:
    """The kind of job that a sampler needs."""
    if sampler.has_streams:
        return Job
    from djpt.rendering.schedules.wavefront import WavefrontJob

    return WavefrontJob


def require_still(scene: Scene, sensor: Any = 0, integrator: Integrator | None = None) -> None:
    """Raise `RenderError` if what places a shape or the sensor has gradients, which few integrators can follow."""
    require_scene(scene)
    camera = find_sensor(scene, sensor) if scene.sensors() or sensor != 0 else None
    able = "'direct_projective' or 'prb_projective'"
    if scene.every_medium:
        able += (
            ", which leave media out: the edges of shadows in media, and of what is seen through them, aren't followed"
        )
    if camera is not None and scene.in_time and not scene.moves and camera.attached_shutter():
        raise RenderError(
            f"'{camera.id()}' has a shutter whose times have gradients: light that changes in time has no derivatives "
            "by it, only what moves has"
        )
    follows_camera = integrator is not None and integrator.follows_camera
    if camera is not None and not follows_camera and (names := camera.attached_names()):
        name = names[0].replace("attached_matrix", "to_world").lstrip("_")
        raise RenderError(
            f"'{camera.id()}' moves with gradients with respect to '{name}': render with the integrator {able}"
        )
    moving = next((shape for shape in scene.shapes() if shape.is_moving()), None)
    if moving is not None and not (integrator is not None and integrator.follows_shapes):
        able = "'volprim_rf_basic'" if moving.is_ellipsoids() else able
        raise RenderError(
            f"'{moving.id()}' moves with parameters that have gradients: render with the integrator {able}"
        )

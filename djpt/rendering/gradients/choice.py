"""The choice of the estimator of an image's derivative."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr

from djpt.errors import RenderError
from djpt.integrators.base import Integrator
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.derivatives import (
    AttachedDerivative,
    Derivative,
    NoDerivative,
    ReplayDerivative,
    attached_image,
)
from djpt.rendering.gradients.leaves import Parameter, placing
from djpt.rendering.known_images import known_derivative_or, known_or
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.job import Job, image_channels
from djpt.rendering.settings import RenderSettings
from djpt.scene.scene import Scene

__all__ = ["derivative_of", "differentiable", "with_motion"]


def differentiable(
    job: Job,
    schedule: Schedule,
    scene: Scene,
    settings: RenderSettings,
    parameters: list[Parameter],
    motion: list[Parameter],
    unused: list[Any],
) -> TensorXf:
    """The image of a job, attached to `parameters`, and to `unused` values, by which its derivative is 0.

    It is also attached to the parameters by which the camera of the `scene` is placed, `motion`.

    Derivatives use samples of their own, whose number and seed the settings say.

    Raises:
        RenderError: The integrator, as it is set up, can't be differentiated.
    """
    spp = settings.spp_grad or job.spp
    samples = replace(job, seed=settings.gradient_seed, spp=spp, progress=None, pass_spp=0, interruption=None)
    derivative = with_motion(derivative_of(samples, schedule, parameters), scene, settings, motion)
    derivative = known_derivative_or(settings, derivative)

    def primal() -> TensorXf:
        with dr.suspend_grad():
            return known_or(settings, lambda: schedule.image(job))

    return attached_image([*parameters, *motion], unused, primal, derivative)


def with_motion(rest: Derivative, scene: Scene, settings: RenderSettings, motion: list[Parameter]) -> Derivative:
    """The estimator of the derivative by all parameters, from that for the `rest`, which come first.

    The `scene` has copies in place of instances.
    """
    if not motion:
        return rest
    # Few images need what follows a camera.
    from djpt.rendering.gradients.camera_in_media import CameraInMedia

    of_camera = CameraInMedia(scene.replace(all_media=True), settings, motion)
    return SumOfDerivatives(rest, of_camera, len(motion))


def derivative_of(samples: Job, schedule: Schedule, parameters: list[Parameter]) -> Derivative:
    """The estimator of an image's derivative with respect to the samples of a job.

    Raises:
        RenderError: The integrator, as it is set up, can't be differentiated.
    """
    if not parameters:
        return NoDerivative(samples)
    integrator = samples.integrator
    if not integrator.differentiable:
        raise RenderError(
            f"'{type(integrator).__name__}' can't be differentiated with these settings; a plain 'path', 'prb' "
            "or 'bdpt' can, or an 'aov' with one of the first two in it"
        )
    if integrator.path_tracer is not integrator:
        return nested_derivative(samples, parameters)
    if integrator.starts_at_lights:
        turned = next((emitter for emitter in samples.scene.emitters() if emitter.is_moving()), None)
        if turned is not None:
            raise RenderError(
                f"'{turned.id()}' moves with parameters that have gradients, and paths of "
                f"'{type(integrator).__name__}' that begin at it don't; possible: the integrators 'direct_projective' "
                "and 'prb_projective'"
            )
        # Few images need what follows light or wavefronts.
        moving = placing(samples.scene.shapes())
        if moving:
            from djpt.rendering.gradients.moving_light_paths import MovingLightDerivative

            return MovingLightDerivative(samples, parameters, len(moving))
        from djpt.rendering.gradients.splatted import light_derivative

        return light_derivative(samples, parameters)
    if integrator.stepwise and not samples.sampler.has_streams:
        from djpt.rendering.gradients.wavefront import WavefrontDerivative

        return WavefrontDerivative(samples, schedule, parameters)
    if integrator.stepwise:
        return ReplayDerivative(samples, schedule, parameters)
    return AttachedDerivative(samples, schedule, parameters)


def nested_derivative(samples: Job, parameters: list[Parameter]) -> Derivative:
    """The derivative of an image by an integrator that runs as the one nested in it: each part by its estimator."""
    whole = samples.integrator

    def part(integrator: Integrator) -> Derivative:
        job = replace(samples, integrator=integrator)
        return derivative_of(job, choose("auto", job), parameters)

    color, others = part(whole.path_tracer), whole.beside_nested()
    if others is None:
        return color
    from djpt.rendering.gradients.nested import NestedDerivative

    return NestedDerivative(color, part(others), len(image_channels(samples.film, whole.path_tracer)))


class SumOfDerivatives:
    """The derivative of an image by two lists of parameters, of which the second one has a given length."""

    def __init__(self, first: Derivative, second: Derivative, count: int) -> None:
        self._first, self._second, self._count = first, second, count

    def backward(self, image: TensorXf) -> list[Any]:
        """The gradients of all parameters, from the derivatives with respect to the pixels (H, W, C)."""
        return [*self._first.backward(image), *self._second.backward(image)]

    def forward(self, tangents: list[Any]) -> TensorXf:
        """The derivative of the image in the direction of `tangents`, one per parameter."""
        return self._first.forward(tangents[: -self._count]) + self._second.forward(tangents[-self._count :])

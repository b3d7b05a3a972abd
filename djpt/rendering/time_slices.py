"""Means of still images: derivatives of images of what moves, and images by integrators whose paths keep no time.

The time for which the shutter is open is divided into slices. Each has a moment drawn in it, at which the scene is
still, and a share of the samples; so the mean of the slices' images, and that of their derivatives, has no bias.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.numeric import AttachedNumber
from djpt.core.transforms.lanes import Transform4f
from djpt.description.animation import PARTS, AnimatedTransform4f
from djpt.errors import RenderError
from djpt.jit.frozen import recording
from djpt.jit.types import Float, TensorXf
from djpt.rendering.gradients.derivatives import attached_image
from djpt.rendering.gradients.fresh_leaves import FreshLeaves
from djpt.rendering.gradients.leaves import Parameter, attached_parameters, motion_parameters
from djpt.rendering.image import film_image, image_derivative, require_still
from djpt.rendering.settings import RenderSettings
from djpt.scene.scene import Scene
from djpt.scene.still import StillScene
from djpt.shapes.silhouettes.moving import AttachedTransform

__all__ = ["needs_slices", "sliced_image"]

MOST_SLICES = 64
"""The most slices of an image; fewer if there are fewer samples per pixel."""
MOST_DERIVATIVES = 16
"""The most slices of a derivative: each looks for silhouettes anew."""


def needs_slices(scene: Scene, settings: RenderSettings) -> bool:
    """Whether an image has to be made of still ones: because something moves, and paths or derivatives can't follow."""
    moves = scene.moves or settings.sensor.moves
    return moves and not (settings.integrator.follows_motion and not every_parameter(scene, settings))


def animations(scene: Scene, settings: RenderSettings) -> list[AnimatedTransform4f]:
    """The animated transforms of a scene and of the sensor, each once."""
    motions = [mover.motion for mover in (*scene.shapes(), *scene.emitters())]
    motions += [sensor.carrier for sensor in settings.sensor.members()]
    return list({id(motion): motion for motion in motions if motion is not None}.values())


def every_parameter(scene: Scene, settings: RenderSettings) -> list[Parameter]:
    """All that has gradients: values of materials and lights, the places of what stays, and keyframes."""
    keyframes = [
        Parameter(motion, name)
        for motion in animations(scene, settings)
        for name in PARTS
        if dr.grad_enabled(getattr(motion, name))
    ]
    placed = motion_parameters(scene, settings.sensor)
    return [*attached_parameters(scene), *placed, *keyframes, *shutter_parameters(settings.sensor)]


class ShutterParameter(Parameter):
    """A time of a sensor that has gradients."""

    @property
    def value(self) -> Any:
        return super().value.lanes


def shutter_parameters(sensor: Any) -> list[Parameter]:
    """The times of a sensor's shutter that have gradients."""
    return [ShutterParameter(sensor, name) for name in sensor.attached_shutter()]


def put(parameter: Parameter, value: Any) -> None:
    """Give a parameter another value, which may have gradients."""
    if isinstance(parameter, ShutterParameter):
        setattr(parameter.owner, parameter.attribute, AttachedNumber(value))
    elif parameter.attribute == "attached_matrix":
        parameter.owner.to_world = AttachedTransform(Transform4f(value))  # type: ignore[attr-defined]
    else:
        setattr(parameter.owner, parameter.attribute, value)


def sliced_image(scene: Scene, params: Any, settings: RenderSettings) -> TensorXf:
    """The image of a scene in which something moves, attached to its parameters; see `needs_slices`.

    Raises:
        RenderError: A parameter has gradients that aren't available for what moves.
    """
    if recording():
        raise RenderError("a frozen function can't render what moves in slices of time: call it without dr.freeze")
    integrator, parameters = settings.integrator, every_parameter(scene, settings)
    if settings.sensor.rolls:
        lacks = "derivatives" if integrator.follows_motion else f"images by '{type(integrator).__name__}'"
        raise RenderError(
            f"'{settings.sensor.id()}' has a rolling shutter, whose rows see different times: there are no "
            f"{lacks}; possible: images by integrators that start at the camera, such as 'path'"
        )
    if settings.sensor.attached_shutter() and any(emitter.in_time for emitter in scene.emitters()):
        raise RenderError(
            f"'{settings.sensor.id()}' has a shutter whose times have gradients: light that changes in time has no "
            "derivatives by it, only what moves has"
        )
    if parameters:
        first = slices_of(settings, settings.sample_count)[0]
        still = first.still(scene, attached=True)
        if not integrator.renders_itself():
            require_still(still.scene, still.copy_of(settings.sensor))

    def primal() -> TensorXf:
        with dr.suspend_grad():
            if integrator.follows_motion:
                return film_image(scene, settings)
            image = mean_image(scene, params, settings)
            settings.sensor.film().keep(image, ())
            return image

    if not parameters:
        return primal()
    return attached_image(parameters, [], primal, SlicedDerivative(scene, params, settings, parameters))


@dataclass(frozen=True)
class Slice:
    """A share of the time and of the samples."""

    time: float
    share: float
    """The share of the exposure that has passed."""
    weight: float
    settings: RenderSettings

    def still(self, scene: Scene, attached: bool = False) -> StillScene:
        """The scene at the slice's moment."""
        sensor, moment = self.settings.sensor, None
        if attached and (times := sensor.attached_shutter()):
            opens = times.get("_shutter_open", sensor.shutter_open())
            moment = Float(opens + times.get("_shutter_open_time", sensor.shutter_open_time()) * self.share)
        return StillScene(scene, self.time, attached, moment)

    def settings_of(self, still: StillScene, original: Any) -> RenderSettings:
        """The settings for a still scene."""
        return replace(self.settings, sensor=still.copy_of(original))


def slices_of(settings: RenderSettings, spp: int, most: int = MOST_SLICES) -> list[Slice]:
    """The slices of an image with so many samples per pixel: moments drawn in equal shares of the time."""
    sensor, seed = settings.sensor, int(settings.seed)
    opens, duration = sensor.shutter_open(), sensor.shutter_open_time()
    count = min(spp, most) if duration > 0 else 1
    random = np.random.Generator(np.random.PCG64(seed)).random(count)
    result = []
    for k in range(count):
        share = spp // count + (k < spp % count)
        own = replace(
            settings, seed=(seed + 0x9E3779B1 * k) & 0xFFFFFFFF, spp=share, seed_grad=None, spp_grad=0, progress=None
        )
        passed = (k + float(random[k])) / count
        result.append(Slice(float(opens + duration * passed), passed, share / spp, own))
    return result


def mean_image(scene: Scene, params: Any, settings: RenderSettings) -> TensorXf:
    """The mean of the slices' images."""
    total: Any = None
    for part in slices_of(settings, settings.sample_count):
        still = part.still(scene)
        image = image_of(still.scene, params, part.settings_of(still, settings.sensor)) * part.weight
        total = image if total is None else total + image
        dr.eval(total)
    result: TensorXf = total
    return result


def image_of(scene: Scene, params: Any, settings: RenderSettings) -> TensorXf:
    """The image of a still scene."""
    if settings.integrator.renders_itself():
        from djpt.rendering.gradients.own_rendering import image_by_itself

        return image_by_itself(scene, params, settings)
    return film_image(scene, settings)


class SlicedDerivative:
    """The derivative of an image as a mean of derivatives of still images."""

    def __init__(self, scene: Scene, params: Any, settings: RenderSettings, parameters: list[Parameter]) -> None:
        self._scene, self._params, self._parameters = scene, params, parameters
        spp = settings.spp_grad or settings.sample_count
        self._sensor = settings.sensor
        self._slices = slices_of(replace(settings, seed=settings.gradient_seed), spp, MOST_DERIVATIVES)
        self._fresh = FreshLeaves(parameters)

    @contextmanager
    def _leaves(self) -> Iterator[list[Any]]:
        """Fresh leaves in the place of the parameters, within a `with` block."""
        before = [p.value for p in self._parameters]
        fresh, _ = self._fresh.made()
        try:
            for parameter, leaf in zip(self._parameters, fresh, strict=True):
                put(parameter, leaf)
            yield fresh
        finally:
            for parameter, value in zip(self._parameters, before, strict=True):
                put(parameter, value)

    def _each(self, derivative: Callable[[Slice, Scene, RenderSettings], None]) -> None:
        for part in self._slices:
            still = part.still(self._scene, attached=True)
            derivative(part, still.scene, part.settings_of(still, self._sensor))

    def backward(self, image: TensorXf) -> list[Any]:
        """The gradients of the parameters, from the derivatives with respect to the pixels (H, W, C)."""
        with dr.resume_grad(), self._leaves() as fresh:
            self._each(
                lambda part, scene, settings: still_derivative(scene, self._params, settings, image * part.weight)
            )
            return [dr.grad(leaf) for leaf in fresh]

    def forward(self, tangents: list[Any]) -> TensorXf:
        """The derivative of the image in the direction of `tangents`, one per parameter."""
        dr.make_opaque(tangents)
        total: list[Any] = []
        with dr.resume_grad(), self._leaves() as fresh:

            def add(part: Slice, scene: Scene, settings: RenderSettings) -> None:
                for leaf, tangent in zip(fresh, tangents, strict=True):
                    dr.set_grad(leaf, tangent)
                change = still_derivative(scene, self._params, settings, None) * part.weight
                total[:] = [dr.detach(change if not total else total[0] + change)]
                dr.eval(total)

            self._each(add)
        result: TensorXf = total[0]
        return result


def still_derivative(scene: Scene, params: Any, settings: RenderSettings, grad: TensorXf | None) -> Any:
    """The derivative of a still image: see `djpt.rendering.image.image_derivative`."""
    integrator = settings.integrator
    if not integrator.renders_itself():
        return image_derivative(scene, settings, grad)
    from djpt.rendering.gradients.own_rendering import own_derivative

    return own_derivative(scene, params, settings, grad)

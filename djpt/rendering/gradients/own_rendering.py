"""Derivatives of images by integrators that render by themselves."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.errors import RenderError
from djpt.jit.frozen import recording
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.derivatives import attached_image, propagated
from djpt.rendering.gradients.fresh_leaves import FreshLeaves, attached_view
from djpt.rendering.gradients.leaves import Parameter, attached_parameters, motion_parameters
from djpt.rendering.gradients.refusals import require_proven
from djpt.rendering.gradients.self_intersections import warn_of_self_intersections
from djpt.rendering.gradients.unproven import moves
from djpt.rendering.known_images import known_or, linearising
from djpt.rendering.schedules.job import image_channels
from djpt.rendering.settings import RenderSettings
from djpt.scene.instance_copies import with_copies
from djpt.scene.scene import Scene, find_sensor
from djpt.shapes.silhouettes.moving import exchanged
from djpt.shapes.silhouettes.normals import with_normals

__all__ = ["image_by_itself", "own_derivative"]


def image_by_itself(scene: Scene, params: Any, settings: RenderSettings) -> TensorXf:
    """The image of an integrator's own `render`, whose derivatives are those of its `render_forward`, `.._backward`."""
    integrator = settings.integrator
    if integrator.follows_media:
        scene = scene.replace(all_media=True)
    shown, sensor = scene, find_sensor(scene, settings.sensor)

    def primal() -> TensorXf:
        with dr.suspend_grad():
            return integrator.render(shown, settings.sensor, settings.seed, settings.spp, develop=True, evaluate=False)

    scene, parameters = differentiated(scene, integrator, sensor)
    if not parameters:
        return known_or(settings, primal)
    derivative = OwnDerivative(scene, params, settings, parameters)
    if linearising():
        graph = derivative.graph(parameters)
        if graph is not None:
            return known_or(settings, primal) + graph
    return attached_image(parameters, [], lambda: known_or(settings, primal), derivative)


def differentiated(scene: Scene, integrator: Any, sensor: Any) -> tuple[Scene, list[Parameter]]:
    """The scene as it is differentiated, and the parameters with gradients.

    Raises:
        RenderError: Something moves, and a function frozen by `dr.freeze` is recorded.
    """
    if moves(scene, sensor):
        if recording() and (integrator.follows_silhouettes or integrator.follows_shapes or integrator.follows_camera):
            raise RenderError(
                f"{integrator.id()}: a frozen function can't compute derivatives by motion, since results of kernels "
                "tell where edges and paths of light are; call it without dr.freeze, or let only materials, "
                "textures and radiance have gradients in it"
            )
        if not recording() and not integrator.unproven_gradients:
            warn_of_self_intersections(scene)
        scene = with_copies(scene)
    parameters = [*attached_parameters(scene), *motion_parameters(scene, sensor)]
    if parameters:
        require_proven(scene, integrator, sensor)
    return scene, parameters


def own_derivative(scene: Scene, params: Any, settings: RenderSettings, grad: TensorXf | None) -> TensorXf:
    """The derivative of an image without the image: see `djpt.rendering.image.image_derivative`."""
    if settings.integrator.follows_media:
        scene = scene.replace(all_media=True)
    scene, parameters = differentiated(scene, settings.integrator, settings.sensor)
    width, height = settings.sensor.film().crop_size()
    channels = len(image_channels(settings.sensor.film(), settings.integrator))
    blank = dr.zeros(TensorXf, (height, width, channels))
    if not parameters:
        return blank
    image = attached_image(parameters, [], lambda: blank, OwnDerivative(scene, params, settings, parameters))
    return propagated(image, grad)


class OwnDerivative:
    """The derivative of an image by the integrator's methods."""

    def __init__(self, scene: Scene, params: Any, settings: RenderSettings, parameters: list[Parameter]) -> None:
        self._integrator, self._scene, self._params = settings.integrator, scene, params
        self._samples = settings.sensor, settings.gradient_seed, settings.spp_grad or settings.spp
        self._leaves = FreshLeaves(parameters)

    def backward(self, image: TensorXf) -> list[Any]:
        """The gradients of the parameters, from the derivatives with respect to the pixels (H, W, C)."""
        with self._leaves.attached(self._scene) as (fresh, scene):
            self._integrator.render_backward(scene, self._params, image, *self._samples)
            return [dr.grad(leaf) for leaf in fresh]

    def forward(self, tangents: list[Any]) -> TensorXf:
        """The derivative of the image in the direction of `tangents`, one per parameter."""
        with self._leaves.attached(self._scene, tangents) as (_, scene):
            return self._integrator.render_forward(scene, self._params, *self._samples)

    def graph(self, parameters: list[Parameter]) -> TensorXf | None:
        """An image of zeros, attached to the parameters themselves; None if the integrator's image has no graph."""
        values = [p.value for p in parameters]
        dr.make_opaque(values)
        places = {(id(p.owner), p.attribute): value for p, value in zip(parameters, values, strict=True)}
        with dr.resume_grad(), exchanged(with_normals(places, self._scene.shapes())):
            view = attached_view(self._scene, places)
            image: TensorXf | None = self._integrator.attached_image(view, *self._samples)
            return None if image is None else image - dr.detach(image)

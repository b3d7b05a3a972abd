"""Derivatives of images with respect to the motion of a camera, by integrators that follow light through media.

See `djpt.integrators.projective.moving_camera`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr

from djpt.errors import RenderError
from djpt.integrators.projective.moving_camera import parts_of_image
from djpt.jit.frozen import recording
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.fresh_leaves import FreshLeaves
from djpt.rendering.gradients.leaves import Parameter
from djpt.rendering.settings import RenderSettings
from djpt.scene.scene import Scene
from djpt.shapes.silhouettes.moving import exchanged

__all__ = ["CameraInMedia"]


class CameraInMedia:
    """The derivative of an image with respect to what places its camera.

    Args:
        scene: the scene, with all its media.
        settings: how it is rendered.
        parameters: those of the camera that have gradients.
    """

    def __init__(self, scene: Scene, settings: RenderSettings, parameters: list[Parameter]) -> None:
        if recording():
            raise RenderError("frozen functions have no derivatives by the place of a camera in media")
        self._scene, self._integrator, self._sensor = scene, settings.integrator, settings.sensor
        self._seed, self._spp = settings.gradient_seed, settings.spp_grad or settings.sample_count
        self._fresh = FreshLeaves(parameters)

    def backward(self, image: TensorXf) -> list[Any]:
        """The gradients of the parameters, from the derivatives with respect to the pixels (H, W, C)."""
        with self._leaves() as fresh:
            for part in self._parts():
                dr.set_grad(part, image)
                dr.enqueue(dr.ADMode.Backward, part)
                dr.traverse(dr.ADMode.Backward)
                dr.eval(dr.grad(fresh))
            return [dr.grad(leaf) for leaf in fresh]

    def forward(self, tangents: list[Any]) -> TensorXf:
        """The derivative of the image in the direction of `tangents`, one per parameter."""
        total = TensorXf(0)
        with self._leaves(tangents):
            for part in self._parts():
                dr.forward_to(part, flags=dr.ADFlag.ClearInterior)
                total = total + dr.grad(part)
                dr.eval(total)
        return total

    @contextmanager
    def _leaves(self, tangents: list[Any] | None = None) -> Iterator[list[Any]]:
        """Fresh leaves in place of the parameters, by which the sensor moves within a `with` block."""
        with dr.resume_grad():
            fresh, places = self._fresh.made(tangents)
            with exchanged(places):
                yield fresh

    def _parts(self) -> Iterator[TensorXf]:
        """The parts of the image, attached to leaves."""
        return parts_of_image(self._integrator, self._scene, self._sensor, self._spp, self._seed)

"""Derivatives of images by integrators that render by themselves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr

from djpt.dispatch.ensemble import Attached
from djpt.integrators.base import Integrator
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.derivatives import attached_image
from djpt.rendering.gradients.leaves import Parameter, attached_parameters, shape_parameters
from djpt.rendering.gradients.unproven import require_proven
from djpt.samplers.seeds import Seed, gradient_seed
from djpt.scene.scene import Scene
from djpt.shapes.silhouettes.moving import exchanged
from djpt.shapes.silhouettes.normals import with_normals

__all__ = ["attached_view", "image_by_itself"]


def attached_view(scene: Scene, values: dict[tuple[int, str], Any]) -> Scene:
    """A view of the scene that reads the AD variables `values`, by (id of a plugin, attribute), in place of copies.

    All tables are made at once: none may be made within a loop that Dr.Jit records.
    """
    lookup = Attached(values)
    lookup.prepare(leaf for ensemble in scene.ensembles() for leaf in ensemble.leaves())
    return scene.replace(lookup=lookup)


def image_by_itself(
    integrator: Integrator,
    scene: Scene,
    params: Any,
    sensor: Any,
    seed: Seed,
    spp: int,
    seed_grad: Seed = 0,
    spp_grad: int = 0,
) -> TensorXf:
    """The image of an integrator's own `render`, whose derivatives are those of its `render_forward`, `.._backward`."""
    if integrator.follows_media:
        scene = scene.replace(all_media=True)
    parameters = [*attached_parameters(scene), *shape_parameters(scene)]

    def primal() -> TensorXf:
        with dr.suspend_grad():
            return integrator.render(scene, sensor, seed, spp, develop=True, evaluate=False)

    if not parameters:
        return primal()
    require_proven(scene, integrator)
    derivative = OwnDerivative(
        integrator, scene, params, sensor, gradient_seed(seed, seed_grad), spp_grad or spp, parameters
    )
    return attached_image(parameters, [], primal, derivative)


class OwnDerivative:
    """The derivative of an image by the integrator's methods."""

    def __init__(
        self,
        integrator: Integrator,
        scene: Scene,
        params: Any,
        sensor: Any,
        seed: Seed,
        spp: int,
        parameters: list[Parameter],
    ) -> None:
        self._integrator, self._scene, self._params = integrator, scene, params
        self._sensor, self._seed, self._spp = sensor, seed, spp
        self._places = [(id(p.owner), p.attribute) for p in parameters]
        # Later edits of the scene must not change what is differentiated.
        self._values = [type(p.value)(dr.detach(p.value)) for p in parameters]

    @contextmanager
    def _leaves(self) -> Iterator[tuple[list[Any], Scene]]:
        """Fresh leaves in place of the parameters, and the scene that reads them within a `with` block."""
        fresh = [type(value)(value) for value in self._values]
        dr.enable_grad(fresh)
        values = dict(zip(self._places, fresh, strict=True))
        with exchanged(with_normals(values, self._scene.shapes())):
            yield fresh, attached_view(self._scene, values)

    def backward(self, image: TensorXf) -> list[Any]:
        """The gradients of the parameters, from the derivatives with respect to the pixels (H, W, C)."""
        with dr.resume_grad(), self._leaves() as (fresh, scene):
            self._integrator.render_backward(scene, self._params, image, self._sensor, self._seed, self._spp)
            return [dr.grad(leaf) for leaf in fresh]

    def forward(self, tangents: list[Any]) -> TensorXf:
        """The derivative of the image in the direction of `tangents`, one per parameter."""
        with dr.resume_grad(), self._leaves() as (fresh, scene):
            for leaf, tangent in zip(fresh, tangents, strict=True):
                dr.set_grad(leaf, tangent)
            return self._integrator.render_forward(scene, self._params, self._sensor, self._seed, self._spp)

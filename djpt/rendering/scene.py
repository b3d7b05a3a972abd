"""The plugin `scene`: a `djpt.Scene` that can be rendered."""

from __future__ import annotations

from typing import Any

from djpt.description.properties import Properties
from djpt.description.registry import register_scene
from djpt.jit.types import TensorXf
from djpt.scene.scene import Renderer, Scene

__all__ = ["make_scene"]


class Rendering(Renderer):
    """The renderer of all scenes; its code is imported when it is first needed."""

    def prepare_to_record(self, scene: Scene) -> None:
        from djpt.rendering.image import prepare_to_record

        prepare_to_record(scene)

    def film_image(self, scene: Scene, sensor: Any, integrator: Any, seed: Any, spp: int) -> TensorXf:
        from djpt.rendering.image import film_image
        from djpt.rendering.settings import RenderSettings

        return film_image(scene, RenderSettings.of(scene, sensor, integrator, seed=seed, spp=spp, seed_grad=None))

    def image_derivative(
        self, scene: Scene, integrator: Any, sensor: Any, seed: Any, spp: int, grad: TensorXf | None
    ) -> TensorXf:
        from djpt.rendering.image import image_derivative
        from djpt.rendering.settings import RenderSettings

        return image_derivative(scene, RenderSettings.of(scene, sensor, integrator, seed=seed, spp=spp), grad)


RENDERING = Rendering()


def make_scene(props: Properties) -> Scene:
    """The scene of a description, with what renders it."""
    return Scene(props, RENDERING)


register_scene("scene", make_scene)

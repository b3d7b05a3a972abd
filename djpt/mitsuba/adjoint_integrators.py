"""The base class of integrators of scripts that start at the lights."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from djpt.errors import RenderError
from djpt.films.image_block import ImageBlock
from djpt.integrators.base import Integrator
from djpt.jit.types import TensorXf
from djpt.samplers.base import Sampler
from djpt.scene.scene import Scene, find_sensor
from djpt.sensors.base import Sensor

__all__ = ["AdjointIntegrator"]


class Adjoint(type):
    """The type of `AdjointIntegrator`: djpt's own integrators that start at the lights count as instances of it."""

    def __instancecheck__(cls, instance: Any) -> bool:
        own = cls.__name__ == "AdjointIntegrator" and isinstance(instance, Integrator) and instance.starts_at_lights
        return own or super().__instancecheck__(instance)


class AdjointIntegrator(Integrator, metaclass=Adjoint):
    """An integrator whose samples may reach any pixel: one light path per lane, as many as `spp` per pixel."""

    starts_at_lights = True

    def sample(  # type: ignore[override]
        self, scene: Scene, sensor: Sensor, sampler: Sampler, block: ImageBlock, sample_scale: float
    ) -> None:
        """Add what the lanes of the seeded sampler find to the block, times `sample_scale`, with the weight 0."""
        raise NotImplementedError(f"{type(self).__name__} needs sample(scene, sensor, sampler, block, sample_scale)")

    def render(
        self,
        scene: Scene,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> TensorXf:
        """Render an image: see `Integrator.render`."""
        camera = find_sensor(scene, sensor)
        film = camera.film()
        sampler = camera.sampler().begun(seed, spp, math.prod(film.crop_size()))
        camera.prepare()
        with dr.suspend_grad():
            film.prepare(list(self.aov_names()))
            block = film.create_block(normalize=True)
            self.sample(scene, camera, sampler, block, 1 / sampler.sample_count())
            film.put_block(block)
            image = film.develop() if develop else TensorXf()
            if evaluate:
                dr.eval(image)
        return image

    def render_forward(self, scene: Scene, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0) -> TensorXf:
        raise self._underived()

    def render_backward(
        self, scene: Scene, params: Any, grad_in: TensorXf, sensor: Any = 0, seed: Any = 0, spp: int = 0
    ) -> None:
        raise self._underived()

    def _underived(self) -> RenderError:
        return RenderError(f"'{type(self).__name__}' starts at the lights and can't be differentiated; 'path' can")

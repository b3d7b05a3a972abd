"""The contract of integrators whose samples light other pixels, too."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from djpt.core.records import Ray3f
from djpt.integrators.base import Integrator
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["Sink", "SplattingIntegrator"]


class Sink(Protocol):
    """The receiver of light for any pixel: see `djpt.films.footprint.Splats`."""

    def add(self, position: Point2f, color: Color3f, active: Bool, layer: UInt32 | int = 0) -> None:
        """Add a colour at a position in [0, 1)^2 of the crop window, to the image or to one of its further layers."""


class SplattingIntegrator(Integrator):
    """An estimator that joins paths of both ends: a sample has a value of its own, and adds light to any pixel.

    A sample is a path from the camera and one from a light, so there are as many of one kind as of the other.
    The sums of what is added are divided by the samples per pixel, and the image is the sum of both.
    `layer_names` names the channels of further images that samples may add to: layers 1, 2, .. of the sink.
    """

    schedules: tuple[str, ...] = ("splatting",)
    needs_light = True
    differentiable = False

    def splat_sample(
        self, scene: Scene, camera: Sensor, sampler: SampleStream, ray: Ray3f, position: Point2f, sink: Sink
    ) -> tuple[Color3f, Bool, list[Float]]:
        """A sample, by its camera ray, with the results of `Integrator.sample`; adds to the `sink`.

        `camera` is the sensor with opaque values. `position` is the ray's in the crop window, [0, 1)^2; filters look
        beyond its borders, where no light can be added.
        """
        raise NotImplementedError

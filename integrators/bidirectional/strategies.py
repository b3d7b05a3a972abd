"""The images of single strategies of bidirectional path tracing: the pyramid over (s, t).

Strategy (s, t) joins s vertices from the light and t from the camera to a path of k = s + t - 1 edges. The row k of the
pyramid has s = 0 .. k; all of them estimate the same light. Paths of one edge have one strategy only, and no row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Protocol

import drjit as dr

from djpt.core.records import Ray3f
from djpt.films.footprint import in_window
from djpt.integrators.base import Integrator
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["MAX_PYRAMID", "Sink", "SplattingIntegrator", "StrategyImages", "layer_names", "strategies"]


class Sink(Protocol):
    """The receiver of light for any pixel: see `djpt.films.splats.Splats`."""

    def add(self, position: Point2f, color: Color3f, active: Bool, layer: UInt32 | int = 0) -> None:
        """Add a colour at a position in [0, 1)^2 of the crop window, to the image or to one of its further layers."""


class SplattingIntegrator(Integrator):
    """An estimator that joins paths of both ends: a sample has a value of its own, and adds light to any pixel.

    A sample is a path from the camera and one from a light, so there are as many of one kind as of the other.
    The sums of what is added are divided by the samples per pixel, and the image is the sum of both.
    `layer_names` names the channels of further images that samples may add to: layers 1, 2, .. of the sink.
    """

    follows_motion = False

    schedules: tuple[str, ...] = ("splatting",)
    needs_light = True
    differentiable = False
    follows_overlaps = False

    def splat_sample(
        self, scene: Scene, camera: Sensor, sampler: SampleStream, ray: Ray3f, position: Point2f, sink: Sink
    ) -> tuple[Color3f, Bool, list[Float]]:
        """A sample, by its camera ray, with the results of `Integrator.sample`; adds to the `sink`.

        `camera` is the sensor with opaque values. `position` is the ray's in the crop window, [0, 1)^2; filters look
        beyond its borders, where no light can be added.
        """
        raise NotImplementedError


MAX_PYRAMID = 8
"""The most edges of the paths in a pyramid: it has 88 images then."""


def strategies(max_depth: int) -> Iterator[tuple[int, int]]:
    """All (s, t) of paths of 2 .. `max_depth` edges, row by row."""
    return ((s, k + 1 - s) for k in range(2, max_depth + 1) for s in range(k + 1))


def layer_names(max_depth: int) -> Sequence[str]:
    """The names of the channels of all strategies: weighted, and alone."""
    return [f"s{s}t{t}{kind}.{c}" for s, t in strategies(max_depth) for kind in ("", ".alone") for c in "RGB"]


class StrategyImages:
    """Sums of the light of samples by the strategy that has found it, if they are asked for."""

    def __init__(self, sink: Sink, position: Point2f, by_strategy: bool) -> None:
        """`position`: the camera ray's in the crop window, which strategies with t > 1 light."""
        self._sink, self._position, self._by_strategy = sink, position, by_strategy
        self.inside = in_window(position)
        """True if the camera ray's position is in the crop window."""

    def weighed(self, value: Color3f, weight: Float, s: UInt32, t: UInt32) -> Color3f:
        """The light `value` of the strategy (s, t) with its weight; what the sample's own pixel receives."""
        self._add(self._position, value, weight, s, s + t - 1, self.inside)
        return value * weight

    def show(self, position: Point2f, value: Color3f, weight: Float, s: UInt32) -> None:
        """Add the light of the strategy (s, 1) at the position that shows it.

        Of samples whose camera ray is outside of the crop window none is added: so there is one light path for each
        camera path inside.
        """
        self._sink.add(position, value * weight, self.inside & (dr.max(value) > 0))
        self._add(position, value, weight, s, s, self.inside)

    def _add(self, position: Point2f, value: Color3f, weight: Float, s: UInt32, edges: UInt32, active: Bool) -> None:
        if not self._by_strategy:
            return
        # Row k begins after rows of 3, 4, .. k entries, which are (k - 2) (k + 3) / 2. Two layers each.
        number = (edges - 2) * (edges + 3) + 2 * s + 1
        active = active & (edges >= 2) & (dr.max(value) > 0)
        self._sink.add(position, value * weight, active, number)
        self._sink.add(position, value, active, number + 1)

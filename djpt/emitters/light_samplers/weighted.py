"""Emitters by fixed weights, all alike or not."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import numpy as np

from djpt.distributions.discrete import Discrete
from djpt.emitters.base import Emitter
from djpt.emitters.light_samplers.sampling import LightSampler
from djpt.errors import SceneError
from djpt.jit.types import Float, Point3f, UInt32, Vector3f

__all__ = ["UniformLightSampler", "WeightedLightSampler"]


class UniformLightSampler(LightSampler):
    """Every emitter with probability 1 / n, as in Mitsuba."""

    def choose(self, p: Point3f, n: Vector3f | None, u: Float) -> tuple[UInt32, Float, Float]:
        if self.count == 1:
            return UInt32(0), Float(1), u
        scaled = u * self.count
        index = dr.minimum(UInt32(scaled), self.count - 1)
        return index, Float(self.count), scaled - Float(index)

    def probability(self, p: Point3f, n: Vector3f | None, index: UInt32) -> Float:
        return Float(1 / self.count)


class WeightedLightSampler(LightSampler):
    """Emitter i with probability w_i / sum w, by inversion of the cumulative sums, as in Mitsuba.

    The weights are the emitters' `sampling_weight`s, or those times their power.
    """

    def __init__(self, emitters: Sequence[Emitter], by_power: bool) -> None:
        """Raises `SceneError` if all weights are 0."""
        super().__init__(emitters)
        weights = np.array([e.sampling_weight() * (e.power() if by_power else 1.0) for e in emitters])
        if not 0 < weights.sum() < np.inf:
            what = "sampling weights times powers" if by_power else "sampling weights"
            raise SceneError(f"no emitter can be chosen: all {what} are 0")
        self._chances = Discrete(weights)

    def choose(self, p: Point3f, n: Vector3f | None, u: Float) -> tuple[UInt32, Float, Float]:
        return self._chances.choose(u)

    def probability(self, p: Point3f, n: Vector3f | None, index: UInt32) -> Float:
        return self._chances.probability(index)

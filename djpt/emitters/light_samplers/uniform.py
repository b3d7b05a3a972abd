"""All emitters alike."""

from __future__ import annotations

import drjit as dr

from djpt.emitters.light_samplers.base import LightSampler
from djpt.jit.types import Float, Point3f, UInt32, Vector3f

__all__ = ["UniformLightSampler"]


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

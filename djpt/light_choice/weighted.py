"""Emitters by fixed weights."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import numpy as np

from djpt.emitters.base import Emitter
from djpt.errors import SceneError
from djpt.light_choice.base import EmitterChoice
from djpt.lookup import Rows, as_float
from djpt.types import Float, Point3f, UInt32, Vector3f

__all__ = ["WeightedChoice"]


class WeightedChoice(EmitterChoice):
    """Emitter i with probability w_i / sum w, by inversion of the cumulative sums, as Mitsuba does.

    The weights are the emitters' `sampling_weight`s, or those times their power.
    """

    def __init__(self, emitters: Sequence[Emitter], by_power: bool) -> None:
        """Raises `SceneError` if all weights are 0."""
        super().__init__(emitters)
        weights = np.array([e.sampling_weight * (e.power() if by_power else 1.0) for e in emitters])
        total = weights.sum()
        if not 0 < total < np.inf:
            what = "sampling weights times powers" if by_power else "sampling weights"
            raise SceneError(f"no emitter can be chosen: all {what} are 0")
        chances = weights / total
        ends = np.cumsum(chances)
        # Rounding must not lead to an emitter of weight 0 at the end.
        ends[np.nonzero(weights)[0][-1] :] = 1.0
        self._chances = Rows([as_float(x) for x in chances])
        self._begins = Rows([as_float(x) for x in np.concatenate([[0.0], ends[:-1]])])

    def choose(self, p: Point3f, n: Vector3f | None, u: Float) -> tuple[UInt32, Float, Float]:
        # The last emitter that begins at or before `u` and has a chance: equal beginnings are empty ones.
        index = UInt32(dr.binary_search(0, self.count - 1, lambda i: self._begins.at(UInt32(i + 1)) <= u))
        inverse = dr.rcp(self._chances.at(index))
        left = (u - self._begins.at(index)) * inverse
        return index, dr.select(dr.isfinite(inverse), inverse, 0), dr.clip(left, 0, 1 - 2**-24)

    def probability(self, p: Point3f, n: Vector3f | None, index: UInt32) -> Float:
        return self._chances.at(index)

"""Finite differences of images with common random numbers, and how far off they may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from djpt.errors import ParameterError
from djpt.validation.gradcheck.losses import Loss

__all__ = ["Difference", "Step", "choose_step"]

Floats = npt.NDArray[np.float64]

SHARE, LEAST = 0.1, 0.02
"""The step as a share of the largest entry that is changed, and the least one for entries near zero."""

HALVINGS = 12
"""The most times that a step which leaves the parameter's range is halved."""


@dataclass(frozen=True)
class Difference:
    """A derivative by finite differences at one seed."""

    image: Floats
    """The derivative of each pixel, (H, W, C)."""
    loss: float
    error: float
    """The change that halving the step made to the loss's derivative: the truncation error is a fraction of it."""


@dataclass(frozen=True)
class Step:
    """A step in a direction, on both sides if the parameter's range has room for it, else on one."""

    loss: Loss
    direction: Floats
    size: float
    sides: int
    """0: central; 1: ahead only; -1: behind only."""

    @property
    def renders(self) -> int:
        """The images that `difference` renders."""
        return 4 if self.sides == 0 else 6

    def difference(self, seed: int) -> Difference:
        """The derivative at a seed, by two steps and Richardson's extrapolation, of fourth order (central) or third."""
        coarse, fine = self._slope(self.size, seed), self._slope(self.size / 2, seed)
        image = (4 * fine - coarse) / 3
        change = self.loss.value(fine) - self.loss.value(coarse)
        return Difference(image, self.loss.value(image), abs(change))

    def _slope(self, size: float, seed: int) -> Floats:
        """The derivative by differences of second order."""

        def at(steps: float) -> Floats:
            return self.loss.image_at(self.loss.values + steps * size * self.direction, seed)

        if self.sides == 0:
            return (at(1) - at(-1)) / (2 * size)
        side = self.sides
        return side * (4 * at(side) - 3 * at(0) - at(2 * side)) / (2 * size)


def choose_step(loss: Loss, direction: Floats) -> Step:
    """The largest usual step that keeps the parameter in its range.

    Raises:
        ParameterError: The parameter can't be changed in this direction at all.
    """
    changed = np.abs(loss.values[direction != 0])
    size = max(LEAST, SHARE * float(changed.max(initial=0.0)))
    for _ in range(HALVINGS):
        for sides, reach in ((0, (1, -1)), (1, (1, 2)), (-1, (-1, -2))):
            if all(loss.allows(loss.values + steps * size * direction) for steps in reach):
                return Step(loss, direction, size, sides)
        size /= 2
    raise ParameterError(f"{loss.key}: can't be changed from {loss.values[direction != 0][:4].tolist()}")

"""The sum of the rounds rendered so far."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from djpt.rendering.progressive.accumulation import luminance
from djpt.rendering.progressive.rounds import RoundSums

__all__ = ["Picture"]

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]


class Picture:
    """An image that rounds of any number of samples are added to, and its error.

    The error comes from the rounds' luminance x with w samples per pixel each: with W the sum of w, m the weighted mean
    and R rounds, the variance of the mean is ``(sum of w x^2 / W - m^2) / (R - 1)``, which is unbiased, as the variance
    of a round is inversely proportional to w.
    """

    def __init__(self, channels: tuple[str, ...]) -> None:
        self.channels = channels
        """The names of the channels."""
        self.rounds = 0
        """The number of rounds."""
        self.spp = 0
        """Samples per pixel of all rounds."""
        self._sums: Doubles = np.zeros((0, 0, 0))
        self._weights: Doubles = np.zeros((1, 1))
        self._constant: Floats = np.zeros((0, 0, 0), np.float32)
        self._mean: Doubles = np.zeros((0, 0))
        self._square: Doubles = np.zeros((0, 0))

    def add(self, part: RoundSums, spp: int) -> None:
        """Add a round of `spp` samples per pixel."""
        brightness = luminance(part.sums * inverse(part.weights), self.channels)
        if not self.rounds:
            self._sums, self._weights = np.zeros(part.sums.shape), np.zeros(part.weights.shape)
            self._mean, self._square = np.zeros(brightness.shape), np.zeros(brightness.shape)
        self._sums += part.sums
        self._weights += part.weights
        self._constant = part.constant
        weighted = spp * brightness
        self._mean += weighted
        self._square += weighted * brightness
        self.rounds += 1
        self.spp += spp

    def pixels(self) -> Floats:
        """The image, (height, width, channels)."""
        filtered = np.empty(self._sums.shape, np.float32)
        np.multiply(self._sums, inverse(self._weights), out=filtered, casting="same_kind")
        image = np.moveaxis(filtered, 0, 2)
        return np.concatenate([image, self._constant], axis=2) if self._constant.size else image

    def error(self) -> Floats:
        """The standard error of the luminance of each pixel, (height, width); zero until there are two rounds."""
        return np.sqrt(self._variance()).astype(np.float32)

    def relative_error(self) -> float:
        """The root of the mean squared error of the pixels, divided by the mean luminance; 0 if that is unknown."""
        mean = float(self._mean.mean()) / max(1, self.spp)
        return math.sqrt(float(self._variance().mean())) / mean if mean > 0 else 0.0

    def _variance(self) -> Doubles:
        """The variance of the mean luminance of each pixel."""
        if self.rounds < 2:
            return np.zeros(self._mean.shape)
        mean = self._mean / self.spp
        return np.maximum(self._square / self.spp - mean * mean, 0) / (self.rounds - 1)


def inverse(weights: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """One divided by the weights, and 1 where there are none."""
    return 1 / np.where(weights == 0, 1, weights)

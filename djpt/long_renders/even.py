"""Accumulations of renders in which all pixels have the same number of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from djpt.long_renders.accumulation import Accumulation, Doubles, luminance
from djpt.long_renders.fingerprint import Fingerprint
from djpt.long_renders.rounds import RoundSums
from djpt.types import TensorXf

__all__ = ["EvenAccumulation"]


@dataclass(frozen=True)
class EvenAccumulation(Accumulation):
    """The sum of some rounds over all pixels."""

    sums: Doubles
    """Weighted sums, (channels that are filtered, height, width)."""
    weights: Doubles
    """Their weights, (height, width), or (1, 1) if all pixels have the same."""
    luminance: Doubles
    """Sums over the even rounds, and over the odd ones, of the image's luminance, (2, height, width)."""
    squares: Doubles
    """The sum over all rounds of the squared luminance, (height, width)."""

    stored: ClassVar[Mapping[str, str]] = {
        "sums": "<f8",
        "weights": "<f8",
        "constant": "<f4",
        "luminance": "<f8",
        "squares": "<f8",
    }
    added: ClassVar[Sequence[str]] = ("sums", "weights", "luminance", "squares")

    @classmethod
    def empty(
        cls, fingerprint: Fingerprint, channels: Sequence[str], constant: int, size: tuple[int, int], round_spp: int
    ) -> EvenAccumulation:
        """The accumulation of no rounds, of `size` (width, height); `constant` channels aren't filtered."""
        width, height = size
        return cls(
            fingerprint=fingerprint,
            channels=tuple(channels),
            round_spp=round_spp,
            seeds=(),
            constant=np.zeros((height, width, constant), np.float32),
            sums=np.zeros((len(channels) - constant, height, width)),
            weights=np.zeros((1, 1)),
            luminance=np.zeros((2, height, width)),
            squares=np.zeros((height, width)),
        )

    # ---- the image ----------------------------------------------------------------------------

    def samples(self) -> TensorXf:
        width, height = self.size
        return TensorXf(np.full((height, width), self.spp, np.float32))

    def filtered(self) -> Doubles:
        return self.sums / np.where(self.weights == 0, 1, self.weights)

    def variance(self) -> Doubles:
        """With R rounds of luminance x: (sum of x^2 - (sum of x)^2 / R) / (R (R - 1)), which is unbiased."""
        count = self.rounds
        if count < 2:
            return np.full_like(self.squares, np.inf)
        spread = self.squares - self.luminance.sum(0) ** 2 / count
        return np.maximum(spread, 0) / (count * (count - 1))

    def mean_luminance(self) -> float:
        return float(self.luminance.sum(0).mean()) / max(1, self.rounds)

    # ---- sums ----------------------------------------------------------------------------------

    def with_round(self, seed: int, part: RoundSums) -> EvenAccumulation:
        """This accumulation and one more round."""
        weights = np.where(part.weights == 0, 1, part.weights)
        brightness = luminance(part.sums / weights, self.channels).astype(np.float64)
        halves = self.luminance.copy()
        halves[self.rounds % 2] += brightness
        return replace(
            self,
            seeds=(*self.seeds, seed),
            sums=self.sums + part.sums,
            weights=self.weights + part.weights,
            constant=part.constant,
            luminance=halves,
            squares=self.squares + brightness * brightness,
        )

    # ---- files ----------------------------------------------------------------------------------

    def facts(self) -> dict[str, Any]:
        return {"weighted": self.weights.size != 1 or self.size == (1, 1)}

    @classmethod
    def shapes(cls, header: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
        (width, height), constant = header["size"], header["constant"]
        return {
            "sums": (len(header["channels"]) - constant, height, width),
            "weights": (height, width) if header["weighted"] else (1, 1),
            "constant": (height, width, constant),
            "luminance": (2, height, width),
            "squares": (height, width),
        }

"""Accumulations of renders in which all pixels have the same number of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from djpt.errors import RenderError
from djpt.jit.types import TensorXf
from djpt.rendering.progressive.accumulation import Accumulation, Doubles, luminance, versions
from djpt.rendering.progressive.fingerprint import Fingerprint
from djpt.rendering.progressive.rounds import RoundSums

__all__ = ["EvenAccumulation"]


@dataclass(frozen=True)
class EvenAccumulation(Accumulation):
    """The sum of some rounds over all pixels."""

    sums: Doubles
    """Weighted sums, (channels that are filtered, height, width)."""
    weights: Doubles
    """Their weights, (height, width), or (1, 1) if all pixels have the same."""
    luminance: Doubles
    """Sums over the even rounds, and over the odd ones, of the image's luminance, (2, height, width).

    A smaller round counts by its share of the samples of a whole one.
    """
    squares: Doubles
    """The sum over all rounds of the squared luminance, by the same shares, (height, width)."""

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
        cls,
        fingerprint: Fingerprint,
        channels: Sequence[str],
        constant: int,
        size: tuple[int, int],
        round_spp: int,
        schedule: str,
    ) -> EvenAccumulation:
        """The accumulation of no rounds, of `size` (width, height); `constant` channels aren't filtered."""
        width, height = size
        return cls(
            software=versions(),
            fingerprint=fingerprint,
            channels=tuple(channels),
            round_spp=round_spp,
            schedule=schedule,
            seeds=(),
            counts=(),
            beginning=None,
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
        """With R rounds of luminance x and share f: (sum of f x^2 - (sum of f x)^2 / F) / (F (R - 1)), F = sum of f.

        It is unbiased if the variance of x is in proportion to 1 / f.
        """
        if self.rounds < 2:
            return np.full_like(self.squares, np.inf)
        spread = self.squares - self.luminance.sum(0) ** 2 / self.share
        return np.maximum(spread, 0) / (self.share * (self.rounds - 1))

    def mean_luminance(self) -> float:
        return float(self.luminance.sum(0).mean()) / self.share if self.rounds else 0.0

    # ---- sums ----------------------------------------------------------------------------------

    def with_round(self, seed: int, count: int, part: RoundSums) -> EvenAccumulation:
        """This accumulation and one more round, of `count` samples per pixel."""
        share = count / self.round_spp
        if self.rounds and self.weights.shape != part.weights.shape:
            raise RenderError("the render can't go on: its weights aren't those of the film")
        weights = np.where(part.weights == 0, 1, part.weights)
        brightness = luminance(part.sums / weights, self.channels).astype(np.float64)
        halves = self.luminance.copy()
        halves[self.rounds % 2] += share * brightness
        return replace(
            self,
            seeds=(*self.seeds, seed),
            counts=(*self.counts, count),
            beginning=self if count < self.round_spp else None,
            sums=self.sums + part.sums,
            weights=self.weights + part.weights,
            constant=part.constant,
            luminance=halves,
            squares=self.squares + share * (brightness * brightness),
        )

    # ---- files ----------------------------------------------------------------------------------

    def facts(self) -> dict[str, Any]:
        return {"weighted": self.weights.shape == self.squares.shape}

    def check(self) -> None:
        super().check()
        if self.weights.size == 1 != self.squares.size and self.weights.item() != self.spp:
            raise ValueError(f"its weights are of {self.weights.item():g} samples per pixel, its rounds of {self.spp}")
        if (self.squares < 0).any() or (self.rounds < 2 and self.luminance[1].any()):
            raise ValueError("its luminance isn't that of its rounds")

    @classmethod
    def shapes(cls, header: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
        (width, height), constant = header["size"], header["constant"]
        if not isinstance(header["weighted"], bool):
            raise ValueError("'weighted' must be true or false")
        return {
            "sums": (len(header["channels"]) - constant, height, width),
            "weights": (height, width) if header["weighted"] else (1, 1),
            "constant": (height, width, constant),
            "luminance": (2, height, width),
            "squares": (height, width),
        }

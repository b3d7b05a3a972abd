"""Accumulations: what has been computed of a render that can go on."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from djpt.errors import RenderError
from djpt.long_renders.fingerprint import Fingerprint, difference
from djpt.long_renders.rounds import RoundSums
from djpt.types import TensorXf

__all__ = ["Accumulation", "Error"]

Doubles = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]

RED_GREEN_BLUE = 0.212671, 0.715160, 0.072169
"""The shares of linear sRGB in the luminance."""


class Error(NamedTuple):
    """How far an image is from the one of infinitely many samples, by the differences between its rounds."""

    overall: float
    """The relative RMSE: the root of the mean squared error of the pixels' luminance, divided by the mean luminance."""
    pixels: TensorXf
    """The standard error of the luminance of each pixel, (height, width)."""


@dataclass(frozen=True)
class Accumulation:
    """The sum of some rounds of a render: an image, its error, and all that is needed to go on.

    `djpt.render_passes` makes them. An accumulation doesn't change: the next round makes another one. Sums are of 64
    bits and are added up in the order of rounds, so that the image is a function of scene, seed, round size and count.
    """

    fingerprint: Fingerprint
    """What is rendered: see `djpt.long_renders.fingerprint`."""
    channels: tuple[str, ...]
    """The names of the image's channels."""
    round_spp: int
    """Samples per pixel of each round."""
    seeds: tuple[int, ...]
    """The seed of each round."""
    sums: Doubles
    """Weighted sums, (channels that are filtered, height, width)."""
    weights: Doubles
    """Their weights, (height, width), or (1, 1) if all pixels have the same."""
    constant: Floats
    """The channels that come from the centres of pixels, (height, width, channels)."""
    luminance: Doubles
    """Sums over the even rounds, and over the odd ones, of the image's luminance, (2, height, width)."""
    squares: Doubles
    """The sum over all rounds of the squared luminance, (height, width)."""

    @classmethod
    def empty(
        cls, fingerprint: Fingerprint, channels: Sequence[str], constant: int, size: tuple[int, int], round_spp: int
    ) -> Accumulation:
        """The accumulation of no rounds, of `size` (width, height); `constant` channels aren't filtered."""
        width, height = size
        return cls(
            fingerprint=fingerprint,
            channels=tuple(channels),
            round_spp=round_spp,
            seeds=(),
            sums=np.zeros((len(channels) - constant, height, width)),
            weights=np.zeros((1, 1)),
            constant=np.zeros((height, width, constant), np.float32),
            luminance=np.zeros((2, height, width)),
            squares=np.zeros((height, width)),
        )

    # ---- the image ----------------------------------------------------------------------------

    @property
    def rounds(self) -> int:
        """The number of rounds."""
        return len(self.seeds)

    @property
    def spp(self) -> int:
        """Samples per pixel that the image consists of."""
        return self.rounds * self.round_spp

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        height, width = self.squares.shape
        return width, height

    def image(self) -> TensorXf:
        """The image, (height, width, channels), as `render` returns it."""
        weights = np.where(self.weights == 0, 1, self.weights)
        filtered = np.moveaxis((self.sums / weights).astype(np.float32), 0, 2)
        return TensorXf(np.ascontiguousarray(np.concatenate([filtered, self.constant], axis=2)))

    def error(self) -> Error:
        """The error of the image's luminance, estimated from the variance between rounds; infinite for one round.

        With R rounds of luminance x: variance of the mean = (sum of x^2 - (sum of x)^2 / R) / (R (R - 1)), per pixel,
        which is unbiased as rounds are independent, also for samplers whose samples within a round are not. Light that
        no round has found yet is no part of it. Files without colours have the mean of their channels for a luminance.
        """
        variance, total = self._variance(), self.luminance.sum(0)
        mean = float(total.mean()) / max(1, self.rounds)
        squared = float(variance.mean()) if variance.size else 0.0
        relative = math.sqrt(squared) / abs(mean) if mean else math.inf if squared else 0.0
        if self.rounds < 2:
            relative = math.inf
        return Error(relative, TensorXf(np.sqrt(variance).astype(np.float32)))

    def _variance(self) -> Doubles:
        """The variance of the mean luminance of each pixel."""
        count = self.rounds
        if count < 2:
            return np.full_like(self.squares, np.inf)
        spread = self.squares - self.luminance.sum(0) ** 2 / count
        return np.maximum(spread, 0) / (count * (count - 1))

    # ---- sums ----------------------------------------------------------------------------------

    def with_round(self, seed: int, part: RoundSums) -> Accumulation:
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

    def __add__(self, other: object) -> Accumulation:
        """The sum of two accumulations of one image, with rounds of one size and different seeds.

        Raises:
            RenderError: They are of different images, or share rounds.
        """
        if not isinstance(other, Accumulation):
            return NotImplemented
        self.require_same(other.fingerprint, "accumulations can't be added")
        for name in ("size", "channels", "round_spp"):
            mine, others = getattr(self, name), getattr(other, name)
            if mine != others:
                raise RenderError(f"accumulations can't be added: '{name}' is {mine} and {others}")
        shared = set(self.seeds) & set(other.seeds)
        if shared:
            raise RenderError(
                f"accumulations can't be added: both have the round of seed {min(shared)}; render them with seeds that "
                "differ"
            )
        return replace(
            self,
            seeds=self.seeds + other.seeds,
            sums=self.sums + other.sums,
            weights=self.weights + other.weights,
            luminance=self.luminance + other.luminance,
            squares=self.squares + other.squares,
        )

    def require_same(self, fingerprint: Fingerprint, problem: str) -> None:
        """Raise `RenderError` if a fingerprint isn't this one."""
        differing = difference(self.fingerprint, fingerprint)
        if differing:
            raise RenderError(f"{problem}: what is rendered differs in {differing}")

    # ---- files ----------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file that `load` reads. It appears when it is complete; until then an old one stays.

        Raises:
            FileError: It can't be written.
        """
        from djpt.long_renders.checkpoint import save

        save(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Accumulation:
        """Read a file that `save` has written; files of strangers run no code.

        Raises:
            FileError: It can't be read, is of another kind or version, or is damaged.
        """
        from djpt.long_renders.checkpoint import load

        return load(path)


def luminance(image: npt.NDArray[np.floating], channels: Sequence[str]) -> npt.NDArray[np.floating]:
    """The luminance of an image (channels, height, width): of R, G, B, or Y; without those the mean of all."""
    places = {name: i for i, name in reversed(list(enumerate(channels[: len(image)])))}
    if all(name in places for name in "RGB"):
        r, g, b = (image[places[name]] * image.dtype.type(s) for name, s in zip("RGB", RED_GREEN_BLUE, strict=True))
        return r + g + b
    if "Y" in places:
        return image[places["Y"]]
    return image.mean(0) if len(image) else np.zeros(image.shape[1:], image.dtype)

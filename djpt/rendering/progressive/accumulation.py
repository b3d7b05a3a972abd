"""Accumulations: what has been computed of a render that can go on."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from djpt.errors import RenderError
from djpt.jit.types import TensorXf
from djpt.rendering.progressive.fingerprint import Fingerprint, difference
from djpt.version import __version__

__all__ = ["Accumulation", "Doubles", "Error", "Floats", "luminance", "versions"]

Doubles = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]

Same = TypeVar("Same", bound="Accumulation")

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

    `djpt.render_passes` makes them: `djpt.rendering.progressive.even.EvenAccumulation`, and with `adaptive` those of
    `djpt.rendering.progressive.adaptive.AdaptiveAccumulation`. An accumulation doesn't change: the next round makes
    another one. Sums are of 64 bits and are added up in the order of rounds, so that the image is a function of
    (scene, spp, seed, round_spp).
    """

    software: str
    """The versions of djpt and Dr.Jit that its rounds come from: see `versions`."""
    fingerprint: Fingerprint
    """What is rendered: see `djpt.rendering.progressive.fingerprint`."""
    channels: tuple[str, ...]
    """The names of the image's channels."""
    round_spp: int
    """Samples per pixel of each whole round, on average."""
    schedule: str
    """How lanes are filled: the `schedule` of `render`."""
    seeds: tuple[int, ...]
    """The seed of each round."""
    counts: tuple[int, ...]
    """The samples per pixel of each round, on average: `round_spp`, or fewer in a last one."""
    beginning: Accumulation | None
    """The whole rounds, if a last one is smaller: a render goes on from them."""
    constant: Floats
    """The channels that come from the centres of pixels, (height, width, channels)."""

    stored: ClassVar[Mapping[str, str]] = {"constant": "<f4"}
    """The arrays in the order of files, and their types there."""
    added: ClassVar[Sequence[str]] = ()
    """The arrays that `a + b` adds up."""

    # ---- the image ----------------------------------------------------------------------------

    @property
    def rounds(self) -> int:
        """The number of rounds."""
        return len(self.seeds)

    @property
    def spp(self) -> int:
        """Samples per pixel that the image consists of, on average."""
        return sum(self.counts)

    @property
    def share(self) -> float:
        """Samples per pixel in units of whole rounds."""
        return self.spp / self.round_spp

    @property
    def whole(self: Same) -> Same:
        """The accumulation that a render goes on from: this one, without a last round that is smaller."""
        if self.beginning is None:
            return self
        assert isinstance(self.beginning, type(self))
        return self.beginning

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        height, width, _ = self.constant.shape
        return width, height

    @property
    def layout(self) -> Any:
        """How the arrays follow from the size: the numbers of channels and of those from the centres of pixels."""
        return len(self.channels), self.constant.shape[2]

    def image(self) -> TensorXf:
        """The image, (height, width, channels), as `render` returns it."""
        filtered = np.moveaxis(self.filtered().astype(np.float32), 0, 2)
        return TensorXf(np.ascontiguousarray(np.concatenate([filtered, self.constant], axis=2)))

    def error(self) -> Error:
        """The error of the image's luminance, estimated from the variance between rounds; infinite for one round.

        It is unbiased also for samplers whose samples within a round depend on each other, as rounds don't. Light that
        no round has found yet is no part of it. Files without colours have the mean of their channels for a luminance.
        """
        return self._error

    @cached_property
    def _error(self) -> Error:
        variance, mean = self.variance(), self.mean_luminance()
        squared = float(variance.mean()) if variance.size else 0.0
        relative = math.sqrt(squared) / abs(mean) if mean else math.inf if squared else 0.0
        if self.rounds < 2:
            relative = math.inf
        return Error(relative, TensorXf(np.sqrt(variance).astype(np.float32)))

    def samples(self) -> TensorXf:
        """Samples of each pixel, (height, width)."""
        raise NotImplementedError

    def filtered(self) -> Doubles:
        """The channels that samples are filtered for, (channels, height, width)."""
        raise NotImplementedError

    def variance(self) -> Doubles:
        """The squared standard error of the luminance of each pixel, (height, width); infinite for one round."""
        raise NotImplementedError

    def mean_luminance(self) -> float:
        """The mean luminance of all pixels."""
        raise NotImplementedError

    # ---- sums ----------------------------------------------------------------------------------

    def __add__(self: Same, other: object) -> Same:
        """The sum of two accumulations of one image, with rounds of one size and different seeds.

        Raises:
            RenderError: They are of different images or versions, or share rounds, or only one is adaptive.
        """
        if not isinstance(other, Accumulation):
            return NotImplemented
        problem = "accumulations can't be added"
        self.require_same(other.software, other.fingerprint, problem)
        if type(other) is not type(self):
            raise RenderError(f"{problem}: one is adaptive")
        for name in ("size", "channels", "round_spp"):
            mine, others = getattr(self, name), getattr(other, name)
            if mine != others:
                raise RenderError(f"{problem}: '{name}' is {mine} and {others}")
        shared = set(self.seeds) & set(other.seeds)
        if shared:
            raise RenderError(
                f"{problem}: both have the round of seed {min(shared)}; render them with seeds that differ"
            )
        sums: dict[str, Any] = {name: getattr(self, name) + getattr(other, name) for name in self.added}
        seeds, counts = self.seeds + other.seeds, self.counts + other.counts
        return replace(self, seeds=seeds, counts=counts, beginning=None, **sums)

    def require_same(self, software: str, fingerprint: Fingerprint, problem: str) -> None:
        """Raise `RenderError` if versions or a fingerprint aren't these."""
        if software != self.software:
            raise RenderError(f"{problem}: its rounds come from {self.software}, others would from {software}")
        differing = difference(self.fingerprint, fingerprint)
        if differing:
            raise RenderError(f"{problem}: what is rendered differs in {differing}")

    # ---- files ----------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file that `load` reads. It appears when it is complete; until then an old one stays.

        Raises:
            FileError: It can't be written.
        """
        from djpt.rendering.progressive.checkpoint import save

        save(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Accumulation:
        """Read a file that `save` has written; files of strangers run no code.

        Raises:
            FileError: It can't be read, is of another kind or version, or is damaged.
        """
        from djpt.rendering.progressive.checkpoint import load

        return load(path)

    def facts(self) -> dict[str, Any]:
        """What files say besides the arrays, and besides what all accumulations have: texts and whole numbers."""
        return {}

    def check(self) -> None:
        """Raise `ValueError` if the arrays of a file contradict each other, or the rounds."""
        if not self.rounds and any(getattr(self, name).any() for name in self.stored):
            raise ValueError("it has sums, but no rounds")

    @classmethod
    def shapes(cls, header: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
        """The shapes of the arrays of a file with a header whose common entries have been checked.

        Raises:
            ValueError: The other entries are wrong.
            KeyError: They are missing.
        """
        raise NotImplementedError

    @classmethod
    def further(cls, header: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes that a header holds in its `facts`."""
        return {}


def versions() -> str:
    """The versions that the bits of a round depend on."""
    return f"djpt {__version__}, drjit {version('drjit')}"


def luminance(image: npt.NDArray[np.floating], channels: Sequence[str]) -> npt.NDArray[np.floating]:
    """The luminance of an image (channels, ..): of R, G, B, or Y; without those the mean of all."""
    places = {name: i for i, name in reversed(list(enumerate(channels[: len(image)])))}
    if all(name in places for name in "RGB"):
        r, g, b = (image[places[name]] * image.dtype.type(s) for name, s in zip("RGB", RED_GREEN_BLUE, strict=True))
        return r + g + b
    if "Y" in places:
        return image[places["Y"]]
    return image.mean(0) if len(image) else np.zeros(image.shape[1:], image.dtype)

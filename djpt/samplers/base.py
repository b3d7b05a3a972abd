"""The contract of samplers: a stream of numbers for every sample of every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import drjit as dr

from djpt.description.plugin import Plugin
from djpt.description.properties import Properties
from djpt.types import Bool, Float, Point2f, UInt32

__all__ = ["SampleIndex", "SampleStream", "Sampler"]


@dataclass
class SampleIndex:
    """The index of a sample in an image: the k-th of `spp` samples of a pixel."""

    pixel: UInt32
    """The number of the pixel, counted row by row over the sampled grid."""
    k: UInt32
    spp: UInt32
    width: UInt32
    """The number of pixels in a row of the grid."""

    @property
    def number(self) -> UInt32:
        """The number of the sample in the image: pixel * spp + k."""
        return dr.fma(self.pixel, self.spp, self.k)


class SampleStream(Protocol):
    """The random numbers of one lane; loop state, so it must be a PyTree."""

    def next_1d(self, active: Bool | bool = True) -> Float:
        """The next number in [0, 1).

        Lanes that aren't active draw nothing from a random generator, but may count the dimension.
        """

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        """The next two numbers in [0, 1)^2."""

    def clone(self) -> SampleStream:
        """A stream that continues with the same numbers, independently of this one."""


class Sampler(Plugin):
    """A source of random numbers: it makes a `SampleStream` per sample.

    The stream of a sample depends on the seed and its `SampleIndex` alone: that makes an image
    independent of how lanes are filled.

    Parameters: `sample_count` (samples per pixel when `render` isn't told, default 4), `seed`
    (added to render's seed, default 0).
    """

    kind: ClassVar[str] = "sampler"

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.sample_count = props.integer("sample_count", 4, low=1)
        self.seed = props.integer("seed", 0, low=0, high=0xFFFFFFFF)

    def round_count(self, spp: int) -> int:
        """The number of samples per pixel that is taken if `spp` (1 or more) are asked for: not less."""
        return spp

    def stream(self, seed: UInt32, index: SampleIndex) -> SampleStream:
        """The stream of a sample; its first two numbers place the sample on its pixel.

        `seed` is the sum of `render`'s and the sampler's own.
        """
        raise NotImplementedError

"""The contract of samplers: a stream of numbers for every sample of every pixel."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar

import drjit as dr

from djpt.description.plugin import Plugin
from djpt.description.properties import Properties
from djpt.errors import RenderError
from djpt.jit.kernels import opaque
from djpt.jit.types import Bool, Float, Point2f, UInt32

__all__ = ["SampleIndex", "SampleStream", "Sampler", "WavefrontIndex", "go_on_with"]

Own = TypeVar("Own", bound="Sampler")

UNCHANGED = 0xFFFFFFFF
"""The wavefront size that means "as before"."""


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
    def first(self) -> UInt32:
        """The number of the pixel's first sample."""
        return self.pixel * self.spp

    @property
    def number(self) -> UInt32:
        """The number of the sample in the image: pixel * spp + k."""
        return dr.fma(self.pixel, self.spp, self.k)


@dataclass
class WavefrontIndex(SampleIndex):
    """The index of a sample in a script's wavefront: lanes are numbered, regardless of pixels."""

    lane: UInt32
    share: UInt32
    """The number of neighbouring lanes that are samples of one pixel."""

    @property
    def first(self) -> UInt32:
        """The number of the pixel's first lane."""
        return self.pixel * self.share

    @property
    def number(self) -> UInt32:
        """The number of the lane."""
        return self.lane


class SampleStream(Protocol):
    """The random numbers of one lane; loop state, so it must be a PyTree."""

    def next_1d(self, active: Bool | bool = True) -> Float:
        """The next number in [0, 1).

        Lanes that aren't active draw nothing from a random generator, but may count the dimension.
        """

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        """The next two numbers in [0, 1)^2."""

    def clone(self) -> Any:
        """A stream that continues with the same numbers, independently of this one."""


class Sampler(Plugin):
    """A source of random numbers: it makes a `SampleStream` per sample.

    The stream of a sample depends on the seed and its `SampleIndex` alone: that makes an image
    independent of how lanes are filled.

    For scripts a sampler can also be a stream itself, of all lanes of a wavefront: once it is seeded, `next_1d` and
    `next_2d` draw from it. Loops of Dr.Jit carry it as state. Rendering doesn't touch that stream.

    A class that a script writes may be nothing but such a stream: images are then made with copies of it, see
    `djpt.rendering.schedules.wavefront`.

    Parameters: `sample_count` (samples per pixel when `render` isn't told, default 4), `seed`
    (added to render's seed, default 0).
    """

    kind: ClassVar[str] = "sampler"

    continues: bool = False
    """True if the samples of a pixel are points of a sequence that goes on evenly, however many there are."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.base_seed = props.integer("seed", 0, low=0, high=0xFFFFFFFF)
        self._sample_count = self.round_count(props.integer("sample_count", 4, low=1))
        self._share, self._wavefront_size, self._sample = 1, 0, 0
        self._seed = UInt32(0)
        self._stream: Any = None

    # ---- samples of images ------------------------------------------------------------

    def round_count(self, spp: int) -> int:
        """The number of samples per pixel that is taken if `spp` (1 or more) are asked for: not less."""
        return spp

    def stream(self, seed: UInt32, index: SampleIndex) -> SampleStream:
        """The stream of a sample; its first two numbers place the sample on its pixel.

        `seed` is the sum of `render`'s and the sampler's own.
        """
        raise NotImplementedError

    def sample_count(self) -> int:
        """The default number of samples per pixel of `render`."""
        return self._sample_count

    def set_sample_count(self, spp: int) -> None:
        """Change `sample_count`, rounded up by `round_count`."""
        if spp < 1:
            raise RenderError(f"{self.id()}: at least 1 sample per pixel is needed, found {spp}")
        self._sample_count = self.round_count(int(spp))

    # ---- wavefronts of scripts ----------------------------------------------------------

    def seed(self, seed: UInt32 | int, wavefront_size: int = UNCHANGED) -> None:
        """Begin the streams of a wavefront of `wavefront_size` lanes: by default as many as before, at first one."""
        if wavefront_size != UNCHANGED:
            self._wavefront_size = int(wavefront_size)
        self._wavefront_size = max(1, self._wavefront_size)
        given = opaque(UInt32(seed & UNCHANGED if isinstance(seed, int) else seed))
        self._seed = given + dr.opaque(UInt32, self.base_seed)
        self._sample = 0
        self._stream = self._begun() if self._makes_streams() else None

    def begun(self: Own, seed: UInt32 | int, spp: int, pixels: int, share: int = 0) -> Own:
        """A seeded copy for a wavefront of samples of `pixels` pixels, pixel after pixel.

        Each has `spp` samples, or as many as `sample_count` says if it is 0; samplers may round up. The wavefront is
        the first `share` of them, or all if it is 0; `advance` goes on to the next.
        """
        sampler = self.clone()
        if spp:
            sampler.set_sample_count(spp)
        share = share or sampler.sample_count()
        sampler.set_samples_per_wavefront(share)
        sampler.seed(seed, pixels * share)
        return sampler

    @property
    def has_streams(self) -> bool:
        """True if samples can be computed in any order: each has a stream of its own.

        Classes of scripts may override `next_1d` or `next_2d` in place of `stream`. Such a sampler is nothing but the
        stream of all lanes of a wavefront.
        """
        kind = type(self)
        return self._makes_streams() and kind.next_1d is Sampler.next_1d and kind.next_2d is Sampler.next_2d

    def _makes_streams(self) -> bool:
        return type(self).stream is not Sampler.stream

    def _begun(self) -> SampleStream:
        """The streams of the lanes' sample number `_sample`."""
        lane, share = dr.arange(UInt32, self._wavefront_size), dr.opaque(UInt32, self._share)
        pixel = lane // share
        k = dr.opaque(UInt32, self._sample * self._share) + (lane - pixel * share)
        count, row = dr.opaque(UInt32, self._sample_count), dr.opaque(UInt32, self._wavefront_size)
        return self.stream(self._seed, WavefrontIndex(pixel, k, count, row, lane, share))

    def _seeded(self) -> SampleStream:
        if self._stream is None:
            self.seed(0)
        if self._stream is None:
            raise NotImplementedError(f"{type(self).__name__} needs next_1d and next_2d, or stream")
        return self._stream

    def next_1d(self, active: Bool | bool = True) -> Float:
        """The next number in [0, 1) of each lane: see `SampleStream`."""
        return self._seeded().next_1d(active)

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        """The next two numbers in [0, 1)^2 of each lane."""
        return self._seeded().next_2d(active)

    def advance(self) -> None:
        """Go on to the next sample of each lane's pixel, and to its first dimension."""
        self._sample += 1
        if self._makes_streams():
            self._stream = self.continued(self._seeded(), self._begun())

    def continued(self, stream: Any, fresh: Any) -> Any:
        """The stream after `stream`, for the lane's next sample; in an image that would be `fresh`, the default."""
        return fresh

    def wavefront_size(self) -> int:
        """The number of lanes; 0 before `seed`."""
        return self._wavefront_size

    def set_samples_per_wavefront(self, samples_per_wavefront: int) -> None:
        """Let this many neighbouring lanes be samples of one pixel, from the next `seed` on.

        Raises:
            RenderError: It doesn't divide `sample_count`.
        """
        share = int(samples_per_wavefront)
        if share < 1 or self._sample_count % share:
            raise RenderError(
                f"{self.id()}: the samples per wavefront must divide the sample count, {self._sample_count}; "
                f"found {share}"
            )
        self._share = share

    def schedule_state(self) -> None:
        """Let the next `dr.eval` compute the state of the streams."""
        dr.schedule([value for value in vars(self).values() if is_state(value)])

    def drawing(self: Own, stream: Any, lanes: int) -> Own:
        """A copy of this sampler that draws from the streams of `lanes` lanes."""
        other = self.fork()
        other._stream, other._wavefront_size = stream, lanes
        return other

    def fork(self: Own) -> Own:
        """A sampler with the same settings that isn't seeded."""
        other = copy.copy(self)
        other._wavefront_size, other._sample, other._stream = 0, 0, None
        return other

    def clone(self: Own) -> Own:
        """A sampler that continues with the same numbers, independently of this one."""
        other = copy.copy(self)
        for name, value in vars(self).items():
            if dr.is_array_v(value):
                setattr(other, name, type(value)(value))  # loops and scripts change arrays in place
        if self._stream is not None:
            other._stream = self._stream.clone()
        return other

    # ---- loops of Dr.Jit -------------------------------------------------------------------

    def _traverse_1_cb_ro(self, callback: Callable[..., Any]) -> None:
        """Show Dr.Jit the variables of the state."""
        dr.detail.traverse_py_cb_ro(self, callback)

    def _traverse_1_cb_rw(self, callback: Callable[..., Any]) -> None:
        """Let Dr.Jit replace the variables of the state."""
        dr.detail.traverse_py_cb_rw(self, callback)


def go_on_with(stream: SampleStream, other: SampleStream) -> None:
    """Let a stream go on where `other`, the stream that a loop was left with, has come to."""
    vars(stream).update(vars(other))


def is_state(value: Any) -> bool:
    """True if a value consists of Dr.Jit's variables."""
    return value is not None and bool(dr.is_array_v(value) or dr.is_struct_v(value))

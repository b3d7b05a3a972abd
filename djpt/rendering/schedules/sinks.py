"""Sinks: where the flat schedule puts finished samples.

A sink decides how many vertices a lane advances per iteration of the loop (`steps`), takes
finished samples after each, and may do collective work at the end of an iteration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import numpy as np

from djpt.jit.frozen import recording
from djpt.jit.kernels import aligned
from djpt.jit.types import Bool, Float, Point2f, UInt32
from djpt.rendering.schedules.called_sums import CalledSums
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.reconstruction import add_taps

__all__ = ["CalledFilmSums", "FilmSums", "Finished", "Sink", "Store", "Sums", "Write", "blank_sums", "sample_buffers"]


def blank_sums(lanes: int, count: int) -> list[Float]:
    """Zeros in memory: as literals they would give a first pass a kernel of its own.

    All are the same memory, which is only read, and stays in the caches: a film's sums are up to a hundred arrays.
    """
    if recording():
        return [dr.opaque(Float, 0, lanes) for _ in range(count)]
    zeros = aligned((lanes,)).view(np.float32)
    return [Float(zeros) for _ in range(count)]


Write = Callable[[UInt32, list[Float], Bool], None]
"""Called with (slot, channels, active): stores the samples of the active lanes."""


def sample_buffers(job: Job, band: Band, count: int) -> tuple[list[Float], Write]:
    """Memory for `count` samples of a band's pixels, one array per channel, and how to write to it."""
    buffers = [dr.empty(Float, band.rows * job.width * count) for _ in range(job.channel_count())]

    def write(slot: UInt32, channels: list[Float], active: Bool) -> None:
        for buffer, channel in zip(buffers, channels, strict=True):
            dr.scatter(buffer, channel, slot, active)

    return buffers, write


@dataclass
class Finished:
    """The samples of an iteration that wait for `Sink.close`."""

    channels: list[Float]
    offset: Point2f
    """Film offset in [0, 1)^2 of the sample."""
    full: Bool
    """True where there is a sample."""


class Sink(Protocol):
    """Receives samples; `state` is its part of the loop state."""

    steps: int
    """Path vertices per iteration."""
    needs_offset: bool
    """Whether the sink must know the places of samples on their pixels."""
    state: list[Any]
    """The state at the start of the loop."""

    def take(
        self, state: list[Any], waiting: Finished | None, channels: list[Float], offset: Point2f | None, ready: Bool
    ) -> tuple[list[Any], Finished | None, Bool]:
        """Take the samples of the lanes that are `ready`; return the state, what waits, and where one was taken."""

    def close(self, state: list[Any], waiting: Finished | None) -> list[Any]:
        """Finish an iteration."""


class Sums:
    """Adds samples up, one sum per channel: the box filter."""

    steps, needs_offset = 1, False

    def __init__(self, state: list[Float]) -> None:
        self.state: list[Any] = state

    def take(
        self, state: list[Any], waiting: Finished | None, channels: list[Float], offset: Point2f | None, ready: Bool
    ) -> tuple[list[Any], Finished | None, Bool]:
        return [s + dr.select(ready, c, 0) for s, c in zip(state, channels, strict=True)], None, ready

    def close(self, state: list[Any], waiting: Finished | None) -> list[Any]:
        return state


class Store:
    """Writes samples to memory with ``write(slot, channels, active)``, lane by lane.

    A lane's samples go to the slots lane, lane + lanes, lane + 2 lanes, ..
    """

    steps, needs_offset = 1, False

    def __init__(self, lanes: int, write: Write) -> None:
        self.state: list[Any] = [dr.arange(UInt32, lanes)]
        self._write, self._stride = write, dr.opaque(UInt32, lanes)

    def take(
        self, state: list[Any], waiting: Finished | None, channels: list[Float], offset: Point2f | None, ready: Bool
    ) -> tuple[list[Any], Finished | None, Bool]:
        (slot,) = state
        self._write(slot, channels, ready)
        return [dr.select(ready, slot + self._stride, slot)], None, ready

    def close(self, state: list[Any], waiting: Finished | None) -> list[Any]:
        return state


class FilmSink:
    """Takes samples for a film whose filter reaches several pixels; those that derive from it add them in `close`.

    Adding a sample there takes time for all lanes of a packet as soon as one has finished, so it can be done once
    every two vertices. A lane can finish two samples in that time only if a path has a single vertex; the second then
    waits for the next iteration.
    """

    needs_offset = True

    def __init__(self, steps: int) -> None:
        self.steps = steps

    state: list[Any]

    def take(
        self, state: list[Any], waiting: Finished | None, channels: list[Float], offset: Point2f | None, ready: Bool
    ) -> tuple[list[Any], Finished | None, Bool]:
        assert offset is not None
        if waiting is None:
            return state, Finished([dr.select(ready, c, 0) for c in channels], offset, ready), ready
        taken = ready & ~waiting.full
        merged = [dr.select(taken, c, w) for c, w in zip(channels, waiting.channels, strict=True)]
        return state, Finished(merged, dr.select(taken, offset, waiting.offset), waiting.full | taken), taken


class FilmSums(FilmSink):
    """Adds samples to the pixels in reach, weighted: one sum per tap and channel, in registers.

    That costs about half as much as a path vertex.
    """

    def __init__(self, job: Job, corner: Point2f, state: list[Float]) -> None:
        """Begin with the sums `state`; `corner` is the film position of each lane's pixel."""
        super().__init__(steps=2)
        self.state = state
        self._job, self._corner = job, corner

    def close(self, state: list[Any], waiting: Finished | None) -> list[Any]:
        assert waiting is not None
        present: Any = dr.select(waiting.full, Float(1), 0)
        return add_taps(self._job, self._corner, waiting.offset, waiting.channels, present, state)


class CalledFilmSums(FilmSink):
    """Adds samples to the pixels in reach, weighted: to sums in memory, by calls.

    The state is the number of samples that each lane has handed over.
    """

    def __init__(self, corner: Point2f, sums: CalledSums, steps: int) -> None:
        """`corner` is the film position of each lane's pixel."""
        super().__init__(steps)
        self.state = [dr.zeros(UInt32, dr.width(corner))]
        self._corner, self._sums = corner, sums

    def close(self, state: list[Any], waiting: Finished | None) -> list[Any]:
        assert waiting is not None
        taken = self._sums.add(self._corner, waiting.offset, waiting.channels, waiting.full)
        return [state[0] + dr.select(taken, UInt32(1), 0)]

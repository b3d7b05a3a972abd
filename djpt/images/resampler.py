"""Resampling of arrays, as Mitsuba's `Resampler`."""

from __future__ import annotations

import enum
import math
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.forms import accessors
from djpt.errors import SceneError
from djpt.images.resampling import Kernel, resampled, taps_between
from djpt.jit.types import Float
from djpt.rfilters.base import ReconstructionFilter

__all__ = [
    "BitmapReconstructionFilter",
    "FilterBoundaryCondition",
    "Resampler",
    "values_of",
]

BitmapReconstructionFilter = ReconstructionFilter
"""Another name of `ReconstructionFilter`: the same objects filter renderings and bitmaps."""


class FilterBoundaryCondition(enum.Enum):
    """What stands beyond the ends: the last sample, the other end, the samples backwards, 0 or 1."""

    Clamp = 0
    Repeat = 1
    Mirror = 2
    Zero = 3
    One = 4


def limits(value: tuple[float, float]) -> tuple[float, float]:
    """The two ends of a range."""
    low, high = value
    return float(low), float(high)


class Resampler:
    """Turns `source_res` samples into `target_res`.

    Args:
        rfilter: From ``load_dict({'type': ...})``; widened when samples get fewer.
        source_res: The number of old samples.
        target_res: The number of new ones. If it is the same, the filter is centred on each.

    Raises:
        SceneError: a number is 0, or the filter is too narrow.
    """

    def __init__(self, rfilter: ReconstructionFilter, source_res: int, target_res: int) -> None:
        self._source, self._target = int(source_res), int(target_res)
        try:
            self._taps = taps_between(
                self._source, self._target, values_of(rfilter), rfilter.radius(), rfilter.is_box_filter()
            )
        except ValueError as error:
            raise SceneError(f"Resampler: {error}") from None
        self._boundary = FilterBoundaryCondition.Clamp
        self._clamp = (-math.inf, math.inf)

    def source_resolution(self) -> int:
        """The number of old samples."""
        return self._source

    def target_resolution(self) -> int:
        """The number of new samples."""
        return self._target

    def taps(self) -> int:
        """The number of old samples that make a new one."""
        return self._taps.weights.shape[1]

    boundary_condition, set_boundary_condition = accessors(
        "_boundary", "What stands beyond the ends; the default is `Clamp`.", FilterBoundaryCondition
    )
    clamp, set_clamp = accessors("_clamp", "The range that results are clipped to; the default is all numbers.", limits)

    def resample(self, source: Any, source_stride: int, target: Any, target_stride: int, channels: int) -> None:
        """Resample arrays of float32 with `channels` numbers per sample; `target` receives the result.

        Args:
            source: The old samples, `source_res` times `source_stride` numbers.
            source_stride: The distance from one sample to the next, in samples.
            target: Receives the new samples, `target_res` times `target_stride` numbers.
            target_stride: As `source_stride`.
            channels: Per sample.

        Raises:
            SceneError: sizes don't fit, or `target` can't be written.
        """
        given, place = flat(source), flat(target)
        for name, array, count, stride in (
            ("source", given, self._source, source_stride),
            ("target", place, self._target, target_stride),
        ):
            if array.size != count * stride * channels:
                raise SceneError(f"'{name}' needs {count} x {stride} x {channels} numbers, found {array.size}")
        samples = given.reshape(self._source, source_stride, channels)[:, 0]
        result = resampled(samples, self._taps, self._boundary.name.lower(), self._clamp)
        new = place.reshape(self._target, target_stride, channels).copy()
        new[:, 0] = result
        if dr.is_array_v(target):
            numbers = dr.arange(dr.uint32_array_t(type(target)), new.size)
            dr.scatter(target, type(target)(new.ravel()), numbers)
        else:
            np.asarray(target).reshape(new.shape)[:] = new

    def __repr__(self) -> str:
        return f"Resampler[source_res={self._source}, target_res={self._target}]"


def flat(array: Any) -> npt.NDArray[np.float32]:
    """The numbers of an array, one after the other."""
    return np.asarray(array, np.float32).ravel()


def values_of(rfilter: ReconstructionFilter) -> Kernel:
    """A filter as a function of NumPy arrays."""

    def kernel(x: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return np.asarray(dr.detach(rfilter.eval(Float(x))), np.float32)

    return kernel

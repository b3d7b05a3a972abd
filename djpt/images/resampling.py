"""Resampling along an axis: weighted sums of the samples about each new one."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["Kernel", "lanczos", "resampled", "taps_between"]

Kernel = Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]]
"""A filter: its values at distances in samples."""

BOUNDARIES = ("clamp", "repeat", "mirror", "zero", "one")
"""The samples beyond the ends: the last sample, the other end, the samples backwards, or a constant."""


class Taps(NamedTuple):
    """The samples that each new one is made of, and their shares."""

    first: npt.NDArray[np.int64]
    """(target,): the number of the first one; it may lie outside."""
    weights: npt.NDArray[np.float64]
    """(target, taps): the shares, each row with the sum 1."""


def lanczos(x: npt.NDArray[np.float32], lobes: int = 2) -> npt.NDArray[np.float32]:
    """The windowed sinc, sinc(x) sinc(x / lobes) within `lobes` samples."""
    value = np.sinc(x.astype(np.float64)) * np.sinc(x.astype(np.float64) / lobes)
    return np.where(np.abs(x) < lobes, value, 0).astype(np.float32)


def taps_between(source: int, target: int, kernel: Kernel, radius: float, box: bool = False) -> Taps:
    """The taps of a filter.

    Fewer samples: the filter is widened by the ratio, so that all old ones count. As many: it is centred on each.
    Rounding to float32 stands where Mitsuba has it, since the number of taps depends on it.

    Args:
        source: The number of old samples.
        target: The number of new ones.
        kernel: The filter.
        radius: The distance beyond which it is 0, in samples.
        box: Whether it is the box of radius 1/2; between two samples it then takes one, never none.

    Raises:
        ValueError: a number of samples is 0, or all weights of a new sample are.
    """
    if source < 1 or target < 1:
        raise ValueError(f"needs at least one sample, found {source} to be made {target}")
    single = np.float32
    scale = single(source) / single(target) if target < source else single(1)
    reach = single(radius) * scale
    count = math.ceil(reach * single(2))
    if source == target:
        count -= count % 2 == 0
        count = min(count, source) if radius < 1 else count
        offsets = np.arange(count, dtype=np.int64) - count // 2
        first = np.arange(target, dtype=np.int64) - count // 2
        weights = np.broadcast_to(kernel(offsets.astype(single)).astype(np.float64), (target, count))
    else:
        count = min(count, source) if radius < 1 else count
        center = (np.arange(target, dtype=single) + single(0.5)) / single(target) * single(source)
        first = np.floor(center - reach + single(0.5)).astype(np.int64)
        place = (first[:, None] + np.arange(count)).astype(single) + single(0.5) - center[:, None]
        weights = kernel((place * (single(1) / scale)).ravel()).astype(np.float64).reshape(place.shape)
        if box and target > source:
            weights = np.ones_like(weights)
    total = weights.sum(axis=1, keepdims=True)
    if not total.all():
        raise ValueError(f"the filter is too narrow to make {target} samples of {source}: some would have none")
    return Taps(first, weights / total)


def resampled(
    values: npt.NDArray[np.floating],
    taps: Taps,
    boundary: str = "clamp",
    clamp: tuple[float, float] = (-math.inf, math.inf),
) -> npt.NDArray[np.floating]:
    """The new samples along the first axis, of the same type as `values`; float16 is summed in float32.

    Args:
        values: (source, ...).
        taps: From `taps_between`.
        boundary: One of `BOUNDARIES`.
        clamp: The range that the results are clipped to.
    """
    size = len(values)
    single = np.float32 if values.dtype == np.float16 else values.dtype
    weights = taps.weights.astype(values.dtype).astype(single)
    result = np.zeros((len(taps.first), *values.shape[1:]), single)
    for i in range(weights.shape[1]):
        index = taps.first + i
        taken = values[inside(index, size, boundary)].astype(single, copy=False)
        outside = (index < 0) | (index >= size)
        if boundary in ("zero", "one") and outside.any():
            taken[outside] = boundary == "one"
        result += taken * weights[:, i].reshape(-1, *[1] * (values.ndim - 1))
    if clamp != (-math.inf, math.inf):
        result = np.clip(result, *clamp)
    return result.astype(values.dtype, copy=False)


def inside(index: npt.NDArray[np.int64], size: int, boundary: str) -> npt.NDArray[np.int64]:
    """The samples that stand for those of any number, by a boundary condition."""
    if boundary == "repeat":
        return index % size
    if boundary == "mirror":
        period = max(1, 2 * size - 2)
        index = index % period
        return np.minimum(index, period - index) if size > 1 else np.zeros_like(index)
    return np.clip(index, 0, size - 1)

"""Images of samples whose places on the film have derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import drjit as dr
import numpy as np

from djpt.jit.kernels import aligned_floats
from djpt.jit.types import Bool, Float, Float64, Int32, Point2f, TensorXf

__all__ = ["moving_samples"]

STEPS = 64
"""The points per pixel by which the weight of a pixel at the border is summed up."""


def moving_samples(
    film: Any, place: Point2f, channels: Sequence[Float], active: Bool | bool, weight: float
) -> TensorXf:
    """The image (H, W, C) of samples, attached to their channels and places; its values are 0.

    For pixel k, with its centre at c_k and the filter f, it is

        sum over samples of  f(place - c_k) channels weight / N_k,    N_k = integral of f(x - c_k) over the film.

    Samples are uniform over the film, a unit square of which is a pixel, if `weight` is one over their number per
    pixel. With a filter that jumps at its edges, such as the box, places have no derivatives.

    Args:
        film: the film.
        place: the places on the crop window, in pixels.
        channels: the values.
        active: the samples that count.
        weight: a factor.
    """
    width, height = film.crop_size()
    image = dr.custom(MovingSamples, place, list(channels), film.rfilter(), (height, width), Bool(active))
    covered = np.multiply.outer(*(coverage(film.rfilter(), n, film.border) for n in (height, width)))
    # Memory that isn't aligned, as NumPy's is by chance, takes other kernels.
    inverse = aligned_floats((height, width, len(channels)))
    inverse[...] = (weight / covered)[..., None]
    return image * TensorXf(inverse)


def coverage(rfilter: Any, count: int, border: int) -> Any:
    """The integral of a filter over an axis of the film, of `count` pixels and a border, by the pixel at its middle."""
    x = (np.arange((count + 2 * border) * STEPS) + 0.5) / STEPS - border
    reach = rfilter.border_size()
    result = np.empty(count)
    inner = None
    for pixel in range(count):
        if inner is not None and reach < pixel < count - 1 - reach:
            result[pixel] = inner
            continue
        places = aligned_floats(x.shape)
        places[...] = x - pixel - 0.5
        with dr.suspend_grad():
            values = np.array(rfilter.eval(Float(places)), np.float64)
        result[pixel] = values.sum() / STEPS
        if reach < pixel < count - 1 - reach:
            inner = result[pixel]
    return result


class MovingSamples(dr.CustomOp):
    """The weighted sums of samples, as an operation of Dr.Jit."""

    def eval(
        self, place: Point2f, channels: list[Float], rfilter: Any, size: tuple[int, int], active: Bool
    ) -> TensorXf:
        self._rfilter, self._size, self._active = rfilter, size, active
        self._place, self._channels = dr.detach(place), dr.detach(channels)
        return dr.zeros(TensorXf, (*size, len(channels)))

    def _taps(self) -> Any:
        """Each pixel in reach: its number, where it is on the film, the weight, and its derivatives by the place."""
        height, width = self._size
        reach = self._rfilter.border_size()
        column, row = (Int32(dr.floor(v)) for v in self._place)

        def along(first: Int32, place: Float, step: int) -> tuple[Int32, Float, Float]:
            pixel = first + step
            return pixel, *value_and_slope(self._rfilter, place - (Float(pixel) + 0.5))

        columns = [along(column, self._place.x, step) for step in range(-reach, reach + 1)]
        rows = [along(row, self._place.y, step) for step in range(-reach, reach + 1)]
        for y, f_y, slope_y in rows:
            for x, f_x, slope_x in columns:
                inside = self._active & (x >= 0) & (x < width) & (y >= 0) & (y < height)
                yield y * width + x, inside, f_x * f_y, Point2f(slope_x * f_y, f_x * slope_y)

    def forward(self) -> None:
        count, (height, width) = len(self._channels), self._size
        moved = Point2f(self.grad_in("place"))
        changes = [Float(c) for c in cast("list[Float]", self.grad_in("channels"))]
        dr.eval(moved, changes, self._channels, self._place)
        sums = dr.zeros(Float64, height * width * count)
        for pixel, inside, weight, slope in self._taps():
            by_place = dr.dot(slope, moved)
            for c, (value, change) in enumerate(zip(self._channels, changes, strict=True)):
                dr.scatter_add(sums, Float64(weight * change + by_place * value), pixel * count + c, inside)
        self.set_grad_out(TensorXf(Float(sums), (height, width, count)))

    def backward(self) -> None:
        count = len(self._channels)
        adjoint = cast(TensorXf, self.grad_out()).array
        by_place, by_channel = Point2f(0), [Float(0) for _ in self._channels]
        for pixel, inside, weight, slope in self._taps():
            for c, value in enumerate(self._channels):
                arrived = dr.gather(Float, adjoint, pixel * count + c, inside)
                by_channel[c] += weight * arrived
                by_place += slope * (value * arrived)
        dr.eval(by_place, by_channel)
        self.set_grad_in("place", by_place)
        self.set_grad_in("channels", by_channel)

    def name(self) -> str:
        return "moving samples"


def value_and_slope(rfilter: Any, x: Float) -> tuple[Float, Float]:
    """A filter and its derivative."""
    with dr.resume_grad():
        place = dr.detach(x)
        dr.enable_grad(place)
        value = rfilter.eval(place)
        if not dr.grad_enabled(value):
            return Float(value), Float(0)
        dr.set_grad(place, 1)
        slope = dr.forward_to(value)
    return Float(dr.detach(value)), Float(slope)

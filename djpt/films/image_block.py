"""Image blocks: pixels that samples are added to by scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, overload

import drjit as dr

from djpt.core.forms import accessors
from djpt.errors import RenderError
from djpt.jit.kernels import opaque
from djpt.jit.types import (
    Array4f,
    Bool,
    Color3f,
    Float,
    Float64,
    Int32,
    Point2f,
    ScalarArray2i,
    ScalarArray2u,
    TensorXf,
    UInt32,
)
from djpt.rfilters.base import ReconstructionFilter, is_wide

__all__ = ["ImageBlock"]


class ImageBlock:
    """A rectangle of pixels, each with sums of several channels, that any sample may be added to.

    A sample at `pos`, in pixels of the film, adds its values times the filter's weight to every pixel whose centre the
    filter reaches. Sums of floats by many lanes have no order: their last bits differ from run to run.

    Args:
        size: width and height; or a tensor (H, W, C) of the values to begin with.
        offset: the film's column and row of the first pixel.
        channel_count: the number of channels; not for a tensor, after whose offset the filter follows.
        rfilter: the reconstruction filter; None: a sample belongs to the pixel that it lies on.
        border: whether the block is widened on all sides, as far as the filter reaches.
        normalize: whether the weights of each sample are made to sum up to 1.
        coalesce: whether weights are taken for all pixels about the sample's own, up to half a pixel beyond the
            filter's radius; else for those within the radius.
        warn_negative, warn_invalid: kept for scripts that set them; nothing is reported.
        compensate: whether sums are in double precision. In single precision, a sum of n values of similar size may be
            off by a fraction of n 2^-24.

    Raises:
        RenderError: Shapes that don't fit.
    """

    @overload
    def __init__(
        self,
        size: Sequence[int],
        offset: Sequence[int],
        channel_count: int,
        rfilter: ReconstructionFilter | None = None,
        border: bool = False,
        normalize: bool = False,
        coalesce: bool = True,
        warn_negative: bool = False,
        warn_invalid: bool = False,
        compensate: bool = False,
    ) -> None: ...
    @overload
    def __init__(
        self,
        tensor: TensorXf,
        offset: Sequence[int] = (0, 0),
        rfilter: ReconstructionFilter | None = None,
        border: bool = False,
        normalize: bool = False,
        coalesce: bool = True,
        warn_negative: bool = False,
        warn_invalid: bool = False,
        compensate: bool = False,
    ) -> None: ...

    def __init__(self, *arguments: Any, **options: Any) -> None:
        first, *further = arguments or (options.pop("size", None),)
        offset = further.pop(0) if further else options.pop("offset", (0, 0))
        tensor = first if len(getattr(first, "shape", ())) == 3 else options.pop("tensor", None)
        given = settings(tensor is None, further, options)
        self._rfilter: ReconstructionFilter | None = given["rfilter"]
        self._border = self._rfilter.border_size() if given["border"] and self._rfilter is not None else 0
        self._normalize, self._coalesce = bool(given["normalize"]), bool(given["coalesce"])
        self._sum: type = Float64 if given["compensate"] else Float
        self._warn_negative, self._warn_invalid = bool(given["warn_negative"]), bool(given["warn_invalid"])
        self.set_offset(offset)
        if tensor is None:
            self._channels = int(given["channel_count"])
            self.set_size(first)
            return
        tensor = TensorXf(tensor)
        height, width, self._channels = tensor.shape
        self._size = (width - 2 * self._border, height - 2 * self._border)
        if min(self._size) < 0:
            raise RenderError(f"ImageBlock: {width} x {height} pixels are less than a border of {self._border}")
        self._data = self._sum(tensor.array)

    def __repr__(self) -> str:
        width, height = self._size
        return f"ImageBlock[size={width} x {height}, offset={self._offset}, channels={self._channels}]"

    # ---- what it consists of ----------------------------------------------------------

    def size(self) -> ScalarArray2u:
        """Width and height, without the border."""
        return ScalarArray2u(*self._size)

    def width(self) -> int:
        """The width without the border."""
        return self._size[0]

    def height(self) -> int:
        """The height without the border."""
        return self._size[1]

    def offset(self) -> ScalarArray2i:
        """The film's column and row of the first pixel."""
        return ScalarArray2i(*self._offset)

    def channel_count(self) -> int:
        """The number of channels."""
        return self._channels

    def border_size(self) -> int:
        """The width of the border in pixels."""
        return self._border

    def has_border(self) -> bool:
        """True if there is a border."""
        return self._border > 0

    def rfilter(self) -> ReconstructionFilter | None:
        """The reconstruction filter, or None."""
        return self._rfilter

    normalize, set_normalize = accessors("_normalize", "Whether the weights of each sample to come sum up to 1.")
    coalesce, set_coalesce = accessors("_coalesce", "Whether all pixels about a sample's own get a weight.")
    warn_negative, set_warn_negative = accessors("_warn_negative", "Kept for scripts; nothing is reported.")
    warn_invalid, set_warn_invalid = accessors("_warn_invalid", "Kept for scripts; nothing is reported.")

    def set_offset(self, offset: Sequence[int]) -> None:
        """Move the block; its sums stay as they are."""
        x, y = (int(n) for n in offset)
        self._offset = (x, y)

    def set_size(self, size: Sequence[int]) -> None:
        """Change the size, with sums of zero."""
        width, height = (int(n) for n in size)
        self._size = (width, height)
        self.clear()

    def clear(self) -> None:
        """Set all sums to zero."""
        columns, rows = self._extent()
        self._data = dr.zeros(self._sum, columns * rows * self._channels)

    def _extent(self) -> tuple[int, int]:
        """Width and height with the border."""
        return self._size[0] + 2 * self._border, self._size[1] + 2 * self._border

    def tensor(self) -> TensorXf:
        """The sums (H, W, C), border included."""
        columns, rows = self._extent()
        return TensorXf(Float(self._data), shape=(rows, columns, self._channels))

    # ---- samples ----------------------------------------------------------------------

    @overload
    def put(
        self, pos: Any, wavelengths: Any, value: Any, alpha: Any = 1.0, weight: Any = 1, active: Bool | bool = True
    ) -> None: ...
    @overload
    def put(self, pos: Any, values: Sequence[Any], active: Bool | bool = True) -> None: ...

    def put(self, pos: Any, *args: Any, **options: Any) -> None:
        """Add samples at positions `pos`, in pixels of the film; inactive lanes add nothing.

        Either ``put(pos, values, active=True)`` with one value per channel, or, for blocks with the 4 or 5 channels of
        a film, ``put(pos, wavelengths, value, alpha=1, weight=1, active=True)``: a colour, and what follows it.
        """
        names: tuple[str, ...]
        if "values" in options or (
            args and len(args[0]) == self._channels and len(args) < 3 and "value" not in options
        ):
            names = ("values", "active")
        else:
            names = ("wavelengths", "value", "alpha", "weight", "active")
        given = {**dict(zip(names, args, strict=False)), **options}
        active = Bool(given.pop("active", True))
        values = given["values"] if "values" in given else self._of_color(given)
        if len(values) != self._channels:
            raise RenderError(
                f"ImageBlock.put: {self._channels} values are expected, one per channel, found {len(values)}"
            )
        self._add(Point2f(pos), [Float(value) for value in values], active)

    def _of_color(self, given: dict[str, Any]) -> list[Float]:
        """The channels of a film's sample: colour, alpha if there are five, weight."""
        if self._channels not in (4, 5):
            raise RenderError(
                f"ImageBlock.put: a colour has 4 or 5 channels, the block has {self._channels}: pass values"
            )
        color = Color3f(given["value"])
        alpha = [given.get("alpha", 1)] if self._channels == 5 else []
        return [color.x, color.y, color.z, *alpha, given.get("weight", 1)]

    def _taps(self, x: Float, offset: int, size: int, whole: bool) -> tuple[Int32, list[tuple[Float, Bool]]]:
        """The first pixel that the filter reaches along an axis; weights, and whether the pixel is there, from it on.

        Unless `whole`, pixels beyond the filter's radius have no weight.
        """
        assert self._rfilter is not None
        reach, radius = self._rfilter.border_size(), self._rfilter.radius()
        own = Int32(dr.floor(x))
        first = own - reach
        start = Float(first) + 0.5 - x
        local = first + (self._border - offset)
        taps = []
        for i in range(2 * reach + 1):
            weight = self._rfilter.eval(start + i)
            if not whole:
                weight = dr.select(dr.abs(start + i) <= radius, weight, 0)
            taps.append((weight, (local + i >= 0) & (local + i < size)))
        return local, taps

    def _footprint(self, pos: Point2f, whole: bool) -> tuple[list[tuple[UInt32, Float, Bool]], Float]:
        """The pixels in reach of a sample, each with its weight and whether it is there; the sum of all weights."""
        assert self._rfilter is not None
        taps = 2 * self._rfilter.border_size() + 1
        if is_wide(taps):
            raise RenderError(
                f"ImageBlock: the filter reaches {taps} pixels along an axis; blocks support narrower filters only, "
                "'render' supports any"
            )
        columns, rows = self._extent()
        left, across = self._taps(pos.x, self._offset[0], columns, whole)
        top, down = self._taps(pos.y, self._offset[1], rows, whole)
        footprint = [
            (UInt32((top + j) * columns + left + i), weight_x * weight_y, here_x & here_y)
            for j, (weight_y, here_y) in enumerate(down)
            for i, (weight_x, here_x) in enumerate(across)
        ]
        return footprint, sum_of([w for w, _ in across]) * sum_of([w for w, _ in down])

    def _add(self, pos: Point2f, values: list[Float], active: Bool) -> None:
        if self._rfilter is None or self._rfilter.is_box_filter():
            pixel, inside = self._own_pixel(pos)
            self._scatter(pixel, values, active & inside)
            return
        footprint, total = self._footprint(pos, self._coalesce)
        scale = inverse_of(dr.detach(total)) if self._normalize else None
        for pixel, weight, here in footprint:
            if scale is not None:
                weight = weight * scale
            self._scatter(pixel, [value * weight for value in values], active & here)

    def _own_pixel(self, pos: Point2f) -> tuple[UInt32, Bool]:
        columns, rows = self._extent()
        x, y = (Int32(dr.floor(p)) + (self._border - offset) for p, offset in zip(pos, self._offset, strict=True))
        return UInt32(y * columns + x), (x >= 0) & (x < columns) & (y >= 0) & (y < rows)

    def _scatter(self, pixel: UInt32, values: Sequence[Float], active: Bool) -> None:
        if self._channels == 4 and self._sum is Float:
            dr.scatter_add(self._data, Array4f(*values), pixel, active)
            return
        for c, value in enumerate(values):
            dr.scatter_add(self._data, self._sum(value), pixel * self._channels + c, active)

    def read(self, pos: Point2f, active: Bool | bool = True) -> list[Float]:
        """The channels at positions `pos`, in pixels of the film: the pixels around, times the filter's weights.

        Weights sum up to 1 only with `normalize`. 0 on inactive lanes, and outside of the block and its border.
        """
        pos, active = Point2f(pos), Bool(active)
        if self._rfilter is None or self._rfilter.is_box_filter():
            pixel, inside = self._own_pixel(pos)
            return self._gather(pixel, active & inside)
        for x, first, size in zip(pos, self._offset, self._size, strict=True):
            active = active & (x >= first) & (x < first + size)
        result, total = [Float(0)] * self._channels, Float(0)
        for pixel, weight, here in self._footprint(pos, False)[0]:
            found = self._gather(pixel, active & here)
            result = [dr.fma(value, weight, part) for value, part in zip(found, result, strict=True)]
            total = total + dr.select(here, weight, 0)
        return [value * inverse_of(total) for value in result] if self._normalize else result

    def _gather(self, pixel: UInt32, active: Bool) -> list[Float]:
        entries = (pixel * self._channels + c for c in range(self._channels))
        return [Float(dr.gather(self._sum, self._data, entry, active)) for entry in entries]

    def put_block(self, block: ImageBlock) -> None:
        """Add the sums of another block, as far as they lie within this one.

        Raises:
            RenderError: The blocks have different numbers of channels.
        """
        if block.channel_count() != self._channels:
            raise RenderError(
                f"ImageBlock.put_block: a block of {self._channels} channels is expected, found {block.channel_count()}"
            )
        columns, rows = self._extent()
        width, height = block._extent()
        index = dr.arange(UInt32, width * height)
        row = index // opaque(UInt32(max(width, 1)))
        shift = [
            theirs - block._border - mine + self._border
            for theirs, mine in zip(block._offset, self._offset, strict=True)
        ]
        x, y = Int32(index - row * width) + shift[0], Int32(row) + shift[1]
        inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
        # Each pixel is met once: a read and a write, whose order doesn't matter.
        pixel = UInt32(y * columns + x) * self._channels
        for c in range(self._channels):
            value: Any = dr.gather(block._sum, block._data, index * self._channels + c)
            dr.scatter_add(self._data, self._sum(value), pixel + c, inside)


def sum_of(numbers: Sequence[Float]) -> Float:
    """The sum of some numbers, at least one."""
    total: Float = sum(numbers[1:], numbers[0])
    return total


def inverse_of(total: Float) -> Float:
    """One over a sum of weights; 0 if there are none."""
    inverse: Any = dr.select(total != 0, dr.rcp(dr.select(total != 0, total, 1)), 0)
    return inverse


DEFAULTS = {
    "rfilter": None,
    "border": False,
    "normalize": False,
    "coalesce": True,
    "warn_negative": False,
    "warn_invalid": False,
    "compensate": False,
}
"""The settings of a block, in the order of its arguments."""


def settings(counts: bool, further: Sequence[Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """The settings from the arguments after the offset; `counts`: the number of channels is the first of them."""
    names = ("channel_count", *DEFAULTS) if counts else tuple(DEFAULTS)
    unknown = set(options) - set(names) or set(names[: len(further)]) & set(options)
    if unknown or len(further) > len(names):
        what = f"'{sorted(unknown)[0]}'" if unknown else f"{len(further) + 2} arguments"
        raise TypeError(f"ImageBlock: {what} can't be given; possible after the offset: {', '.join(names)}")
    given = {**DEFAULTS, **dict(zip(names, further, strict=False)), **options}
    if counts and "channel_count" not in given:
        raise TypeError("ImageBlock: 'channel_count' is missing")
    return given

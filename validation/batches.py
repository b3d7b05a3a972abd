"""The mean and the variance of independent renders of one scene: its batches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.validation.metrics import ComparisonError

__all__ = ["BLOCK", "CELL", "Batches", "Moments", "block_sizes"]

Array = npt.NDArray[np.float64]

BLOCK = 32
"""Side of a block in pixels. Blocks at the right and lower border may be smaller."""

CELL = 8
"""Side of a cell in pixels: blocks consist of cells, whose averages are kept of each batch."""


@dataclass(frozen=True)
class Moments:
    """Mean, variance and degrees of freedom of some averages; all arrays have the shape of the averages."""

    mean: Array
    variance: Array  # of one batch's average, unbiased
    dof: Array  # degrees of freedom of `variance`
    count: int  # number of batches that were averaged


class Batches:
    """The mean and the variance of independent renders of one scene, accumulated by `add`.

    Memory: two float64 images, and per batch one number for each cell and channel.

    * `block`: the side of the blocks in pixels.
    * `cell`: the side of the cells, which divides it.
    """

    def __init__(self, block: int = BLOCK) -> None:
        self.block, self.cell = block, math.gcd(block, CELL)
        self.count = 0
        self._mean: Array = np.zeros(0)
        self._squares: Array = np.zeros(0)  # sum of squared deviations from the mean
        self._cells: list[Array] = []  # the averages of each batch

    def add(self, image: Any) -> None:
        """Add a render (H, W, C) with a seed of its own. Raises `ComparisonError` for NaN and for other shapes."""
        pixels = np.asarray(image, np.float64)
        if pixels.ndim != 3 or pixels.size == 0:
            raise ComparisonError(f"a batch has shape (H, W, C), found {pixels.shape}")
        if self.count == 0:
            self._mean, self._squares = np.zeros_like(pixels), np.zeros_like(pixels)
        if pixels.shape != self._mean.shape:
            raise ComparisonError(f"batches of different shapes: {self._mean.shape} and {pixels.shape}")
        bad = np.count_nonzero(~np.isfinite(pixels))
        if bad:
            raise ComparisonError(f"batch {self.count} has {bad} values that are NaN or infinite")
        # Welford's update: stable where sums of squares are not.
        self.count += 1
        deviation = pixels - self._mean
        self._mean = self._mean + deviation / self.count
        self._squares = self._squares + deviation * (pixels - self._mean)
        self._cells.append(block_means(pixels, self.cell))

    @classmethod
    def restored(cls, mean: Any, variance: Any, cells: Any, block: int = BLOCK) -> Batches:
        """The batches of which these are the `mean`, `pixels().variance` and `cells`."""
        found = cls(block)
        found.count = len(cells)
        found._mean = np.asarray(mean, np.float64)
        found._squares = np.asarray(variance, np.float64) * (found.count - 1)
        found._cells = [np.asarray(each, np.float64) for each in cells]
        found._need_two()
        return found

    @property
    def cells(self) -> Array:
        """The averages of the cells of each batch, (count, rows, columns, C)."""
        return np.stack(self._cells)

    @property
    def mean(self) -> Array:
        """The mean image (H, W, C)."""
        return self._mean

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W, C)."""
        return self._mean.shape

    def variance_of_mean(self) -> Array:
        """The variance of `mean` per pixel (H, W, C)."""
        return self.pixels().variance / self.count

    def pixels(self) -> Moments:
        """Moments of the single pixels, (H, W, C)."""
        self._need_two()
        dof = self.count - 1
        return Moments(self._mean, self._squares / dof, np.full(self._mean.shape, float(dof)), self.count)

    def blocks(self, independent_pixels: bool = False) -> Moments:
        """Moments of the block averages, (rows, columns, C).

        The variance is that of the batches' block averages, right for any filter, with count - 1 degrees
        of freedom. `independent_pixels` (true under the box filter) adds up the pixels' variances
        instead, which leaves thousands of degrees of freedom (Satterthwaite 1946, *An approximate distribution
        of estimates of variance components*) and so a sharper test from few batches.
        """
        self._need_two()
        if not independent_pixels:
            sizes = block_sizes(self.shape, self.cell)
            side = self.block // self.cell
            whole = block_sizes(self.shape, self.block)
            stack = np.stack([added(cells * sizes, side) / whole for cells in self._cells])
            dof = np.full(stack.shape[1:], self.count - 1.0)
            return Moments(stack.mean(axis=0), stack.var(axis=0, ddof=1), dof, self.count)
        return self._added_up(self.block)

    def _added_up(self, side: int) -> Moments:
        """Moments of the averages over blocks of independent pixels."""
        return _pooled(self.pixels(), lambda values: added(values, side), block_sizes(self.shape, side))

    def image(self, independent_pixels: bool = False) -> Moments:
        """Moments of the whole image's average per channel, (C,); see `blocks`."""
        self._need_two()
        height, width, channels = self._mean.shape
        if independent_pixels:
            return _pooled(self.pixels(), lambda values: values.sum(axis=(0, 1)), np.float64(height * width))
        weight = block_sizes(self._mean.shape, self.cell) / (height * width)
        stack = np.stack([(cells * weight).sum(axis=(0, 1)) for cells in self._cells])
        dof = np.full(channels, self.count - 1.0)
        return Moments(stack.mean(axis=0), stack.var(axis=0, ddof=1), dof, self.count)

    def noise(self) -> Moments:
        """Moments of the averages of cells as if pixels were independent, which need not be, (rows, columns, C)."""
        self._need_two()
        return self._added_up(self.cell)

    def weighted(self, weights: Array, independent_pixels: bool = False) -> Moments:
        """Moments of a weighted mean of the averages of cells per channel, (C,); see `blocks`.

        `weights`: of each cell and channel, (rows, columns, C), with the sum 1 for each channel.
        """
        self._need_two()
        if not independent_pixels:
            sums = np.stack([(cells * weights).sum(axis=(0, 1)) for cells in self._cells])
            dof = np.full(sums.shape[1], self.count - 1.0)
            return Moments(sums.mean(axis=0), sums.var(axis=0, ddof=1), dof, self.count)
        cells = self.noise()
        shares = cells.variance * weights**2
        total, squares = shares.sum(axis=(0, 1)), (shares**2 / cells.dof).sum(axis=(0, 1))
        dof = np.where(squares > 0, total**2 / np.where(squares > 0, squares, 1), cells.dof.sum(axis=(0, 1)))
        return Moments((cells.mean * weights).sum(axis=(0, 1)), total, dof, self.count)

    def _need_two(self) -> None:
        if self.count < 2:
            raise ComparisonError(f"a variance needs at least 2 batches, found {self.count}")


def _pooled(pixels: Moments, add_up: Any, size: Any) -> Moments:
    """The moments of averages of independent pixels: `add_up` sums an array (H, W, C) over groups of `size` pixels."""
    total = add_up(pixels.variance)
    squares = add_up(pixels.variance**2 / pixels.dof)
    one = add_up(pixels.dof)  # where there is no noise any number of degrees of freedom will do
    dof = np.where(squares > 0, total**2 / np.where(squares > 0, squares, 1), one)
    return Moments(add_up(pixels.mean) / size, total / size**2, dof, pixels.count)


def added(image: Array, side: int) -> Array:
    """The sums over blocks, (rows, columns, C)."""
    sums = np.add.reduceat(image, np.arange(0, image.shape[0], side), axis=0)
    return np.asarray(np.add.reduceat(sums, np.arange(0, image.shape[1], side), axis=1))


def block_means(image: Array, side: int) -> Array:
    """The averages over blocks, (rows, columns, C)."""
    return np.asarray(added(image, side) / block_sizes(image.shape, side))


def block_sizes(shape: tuple[int, ...], block: int) -> Array:
    """The number of pixels of each block, (rows, columns, 1)."""
    rows, columns = (np.diff(np.append(np.arange(0, n, block), n)).astype(np.float64) for n in shape[:2])
    return np.asarray(rows[:, None, None] * columns[None, :, None])

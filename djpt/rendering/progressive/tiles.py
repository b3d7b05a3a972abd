"""Tiles: the parts of an image that have numbers of samples of their own.

Each tile has a small film, wider than itself by what the reconstruction filter reaches. Its samples add up there, and
the image is the sum of these films, each divided by the number of its samples. So all places of the image count the
same, whatever the tiles beside them have.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

__all__ = ["Tiles"]

SIDE = 8
"""The largest width and height of a tile: small enough for what is noisy, large enough to know its variance."""

TOGETHER = 8
"""The rows of tiles that are added up at once: what that takes is small beside an image."""

Counts = npt.NDArray[np.int64]
Doubles = npt.NDArray[np.float64]
Number = TypeVar("Number", bound=np.generic)


@dataclass(frozen=True)
class Tiles:
    """The tiles of a sampled grid: the crop window of a film, widened by a border on each side."""

    grid: tuple[int, int]
    """Width and height of the grid in pixels."""
    border: int
    """The border of the film, in pixels."""
    reach: int
    """How many pixels away from its own pixel a sample counts: 0 with the box filter."""

    @property
    def columns(self) -> int:
        """The number of tiles in a row."""
        return -(-self.grid[0] // SIDE)

    @property
    def rows(self) -> int:
        """The number of rows of tiles."""
        return -(-self.grid[1] // SIDE)

    @property
    def count(self) -> int:
        """The number of tiles."""
        return self.columns * self.rows

    @property
    def width(self) -> int:
        """The width of a tile in pixels. The last ones of a row may reach beyond the grid."""
        return -(-self.grid[0] // self.columns)

    @property
    def height(self) -> int:
        """The height of a tile in pixels."""
        return -(-self.grid[1] // self.rows)

    @property
    def film(self) -> tuple[int, int]:
        """Height and width of a tile's film."""
        return self.height + 2 * self.reach, self.width + 2 * self.reach

    def joined(self, films: npt.NDArray[np.floating], counts: Counts | None = None) -> Doubles:
        """The sum of all tiles' films, (tile, row, column), at their places: (height, width) of the crop.

        Each is divided by its number among `counts`, if these are given.
        """
        high, wide = self.film
        parts = films.reshape(self.rows, self.columns, high, wide)
        divisors = None if counts is None else counts.reshape(self.rows, self.columns, 1, 1)
        whole = np.zeros((self.rows * self.height + 2 * self.reach, self.columns * self.width + 2 * self.reach))
        for start in range(0, self.rows, TOGETHER):
            some = slice(start, start + TOGETHER)
            across = np.zeros((len(parts[some]), high, whole.shape[1]))
            for column in range(self.columns):
                part = parts[some, column]
                first = column * self.width
                across[..., first : first + wide] += part if divisors is None else part / divisors[some, column]
            for row, film in enumerate(across, start):
                first = row * self.height
                whole[first : first + high] += film
        return np.ascontiguousarray(whole[self._crop])

    def parted(self, image: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """What each tile's film sees of an image of the crop, (height, width): (tile, row, column); 0 outside."""
        whole = np.zeros(
            (self.rows * self.height + 2 * self.reach, self.columns * self.width + 2 * self.reach), image.dtype
        )
        whole[self._crop] = image
        windows = np.lib.stride_tricks.sliding_window_view(whole, self.film)[:: self.height, :: self.width]
        return np.ascontiguousarray(windows[: self.rows, : self.columns]).reshape(self.count, *self.film)

    def means(self, image: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """The mean of an image of the crop over the pixels of each tile; 0 for tiles of the border alone."""
        inside = self._totals(np.ones_like(image))
        return self._totals(image) / np.maximum(inside, 1)

    def spread(self, of_tiles: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """A number of each tile at all its pixels: (height, width) of the crop."""
        rows = np.repeat(of_tiles.reshape(self.rows, self.columns), self.height, 0)
        (top, left), (width, height) = (self.border, self.border), self.grid
        return np.repeat(rows, self.width, 1)[top : height - top, left : width - left]

    @property
    def _crop(self) -> tuple[slice, slice]:
        """The place of the crop on the sum of all films."""
        first, (width, height) = self.reach + self.border, self.grid
        return slice(first, self.reach + height - self.border), slice(first, self.reach + width - self.border)

    def _totals(self, image: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        whole = np.zeros((self.rows * self.height, self.columns * self.width))
        (width, height), border = self.grid, self.border
        whole[border : height - border, border : width - border] = image
        return whole.reshape(self.rows, self.height, self.columns, self.width).sum((1, 3)).ravel()

"""Tiles: the parts of an image that have numbers of samples of their own.

Each tile has a small film, wider than itself by what the reconstruction filter reaches. Its samples add up there, and
the image is the sum of these films, each divided by the number of its samples. So all places of the image count the
same, whatever the tiles beside them have.

The choice of the tiles that rounds sample leaves the image unbiased. Rounds belong to two halves in turns, and the
image is the mean of the halves' images. Some rounds are *surveys*, which sample all tiles alike. How often the other
rounds of a half sample a tile follows from the surveys of the **other** half alone. So no number of samples depends on
values that it weights, and each half's image is unbiased, as with numbers of samples that are known beforehand. (D.
Kirk and J. Arvo, *Unbiased sampling techniques for image synthesis*, SIGGRAPH 1991, describe the bias of images whose
samples decide about their own number.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

__all__ = ["FIRST", "LEAST", "MOST", "Counts", "TileSums", "Tiles", "half_of", "is_survey", "shares", "surveys"]

SIDE = 8
"""The maximum width and height of a tile: small enough to isolate noise, large enough to estimate its variance."""

ROWS = 8
"""The rows of tiles that are added up at once: few, so that temporary arrays are small beside an image."""

TOGETHER = 2**8
"""The tiles whose films are processed at once: few, so that temporary arrays are small beside the sums."""

FIRST = 4
"""The surveys that come first: two of each half."""

EVERY = 16
"""Two of so many rounds are surveys later on: one of each half."""

LEAST = 0.1
"""The least standard deviation that is assumed of a tile, in means of all: surveys may have missed what is rare."""

MOST = 2**12 - 1
"""The maximum number of times that a round samples a tile."""

Counts = npt.NDArray[np.int64]
Doubles = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Number = TypeVar("Number", bound=np.generic)


@dataclass(frozen=True)
class Tiles:
    """The tiles of a sampled grid: the crop window of a film, widened by a border on each side."""

    grid: tuple[int, int]
    """Width and height of the grid in pixels."""
    border: int
    """The border of the film, in pixels."""
    reach: int
    """The distance in pixels up to which a sample counts beyond its own pixel: 0 with the box filter."""

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
        for start in range(0, self.rows, ROWS):
            some = slice(start, start + ROWS)
            across = np.zeros((len(parts[some]), high, whole.shape[1]))
            for column in range(self.columns):
                part = parts[some, column]
                first = column * self.width
                across[..., first : first + wide] += part if divisors is None else part / divisors[some, column]
            for row, film in enumerate(across, start):
                first = row * self.height
                whole[first : first + high] += film
        return np.ascontiguousarray(whole[self._crop])

    def developed(
        self, channels: int, of_channel: Callable[[int], npt.NDArray[np.floating]], counts: Counts | None = None
    ) -> Doubles:
        """The image of some `channels`, each divided by the weight, which is the last one.

        Args:
            channels: Their number, the weight included.
            of_channel: The films of a channel, (tile, row, column).
            counts: As for `joined`.
        """
        # One by one: the films of all channels together would be more than twice an image.
        weight = self.joined(of_channel(channels - 1), counts)
        weight[weight == 0] = 1
        image = np.empty((channels - 1, *weight.shape))
        for channel, pixels in enumerate(image):
            np.divide(self.joined(of_channel(channel), counts), weight, out=pixels)
        return image

    def parts(self) -> Iterator[slice]:
        """Groups of tiles in turn, so that temporary arrays are small beside their sums."""
        for start in range(0, self.count, TOGETHER):
            yield slice(start, start + TOGETHER)

    def parted(self, image: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """The part of an image of the crop, (height, width), on each tile's film: (tile, row, column); 0 outside."""
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


@dataclass(frozen=True)
class TileSums:
    """The films of the tiles that a round has sampled."""

    places: Counts
    """The numbers of the tiles, in order; a tile that was sampled several times is there as often."""
    parts: Sequence[Sequence[Floats]]
    """Films of some places after the other: for each channel, the last being the weight, (places, height, width)."""
    constant: Floats
    """The channels that come from the centres of pixels, (height, width, channels)."""

    def channel(self, number: int) -> Floats:
        """A channel of all films, (places, height, width)."""
        return np.concatenate([part[number] for part in self.parts])

    def by_tiles(self) -> Iterator[tuple[Counts, Floats]]:
        """Groups of tiles in turn, and their films (channels and weight, places, height, width).

        All films of a tile come together.
        """
        end, places = 0, self.places[:0]
        films: Floats | None = None
        for part in self.parts:
            for start in range(0, len(part[0]), TOGETHER):
                added = np.stack([channel[start : start + TOGETHER] for channel in part])
                films = added if films is None else np.concatenate([films, added], axis=1)
                places, end = np.concatenate([places, self.places[end : end + added.shape[1]]]), end + added.shape[1]
                # The last tile may go on in what follows.
                complete = len(places) if end == len(self.places) else int(np.searchsorted(places, places[-1]))
                if complete:
                    yield places[:complete], films[:, :complete]
                places, films = places[complete:], films[:, complete:]


# ---- which tiles a round samples ---------------------------------------------------------------


def half_of(number: int) -> int:
    """The half that a round belongs to, 0 or 1."""
    return number % 2


def is_survey(number: int) -> bool:
    """True if a round samples all tiles alike."""
    return number < FIRST or number % EVERY < 2


def surveys(rounds: int, half: int) -> int:
    """The number of surveys of a half among the first rounds."""
    return sum(is_survey(number) for number in range(half, rounds, 2))


def shares(tiles: Tiles, taken: Counts, variances: Doubles, places: int) -> Counts:
    """The number of times that a round of a half samples each tile.

    The mean squared error of the image, the sum of variance / count over the tiles, is least for counts in proportion
    to the standard deviations: tiles are sampled that have less than this fraction.

    Args:
        tiles: Those of the image.
        taken: How often the half has sampled each tile.
        variances: The variance of a pixel's luminance in a round, mean over each tile, by the other half's surveys.
        places: The sum of these numbers: in a whole round that of the tiles.
    """
    deviations = np.sqrt(smoothed(variances.reshape(tiles.rows, tiles.columns)).ravel())
    deviations = np.maximum(deviations, LEAST * deviations.mean())
    if deviations.any():
        wanted = deviations * ((taken.sum() + places) / deviations.sum())
        missing = np.cumsum(np.maximum(wanted - taken, 0))
    else:
        missing = np.arange(1.0, tiles.count + 1)
    ends = np.floor(missing * (places / missing[-1]) + 0.5).astype(np.int64)
    counts: Counts = np.minimum(np.diff(ends, prepend=0), MOST)
    return counts


def smoothed(variances: Doubles) -> Doubles:
    """Three quarters of each tile's variance, and one of the mean of the 3 x 3 tiles around it.

    A few surveys say little about a single tile.
    """
    rows, columns = variances.shape
    around = np.zeros((rows + 2, columns + 2))
    number = np.zeros_like(around)
    around[1:-1, 1:-1], number[1:-1, 1:-1] = variances, 1
    total, inside = (
        sum(a[y : y + rows, x : x + columns] for y in range(3) for x in range(3)) for a in (around, number)
    )
    blended: Doubles = (3 * variances + total / inside) / 4
    return blended

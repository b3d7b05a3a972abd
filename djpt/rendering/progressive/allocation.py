"""The choice of the tiles that adaptive rounds sample, which leaves their image unbiased.

Rounds belong to two halves in turns, and the image is the mean of the halves' images. Some rounds are *surveys*, which
sample all tiles alike. How often the other rounds of a half sample a tile follows from the surveys of the **other**
half alone. So no number of samples depends on values that it weights, and each half's image is unbiased, as with
numbers of samples that are known beforehand. (D. Kirk and J. Arvo, *Unbiased sampling techniques for image synthesis*,
SIGGRAPH 1991, describe the bias of images whose samples decide about their own number.)
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from djpt.rendering.progressive.tiles import Tiles

__all__ = ["FIRST", "MOST", "half_of", "is_survey", "shares", "surveys"]

Doubles = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

FIRST = 4
"""The surveys that come first: two of each half."""

EVERY = 16
"""Two of so many rounds are surveys later on: one of each half."""

LEAST = 0.1
"""The least standard deviation that is assumed of a tile, in means of all: surveys may have missed what is rare."""

MOST = 2**12 - 1
"""The most times that a round samples a tile."""


def half_of(number: int) -> int:
    """The half that a round belongs to, 0 or 1."""
    return number % 2


def is_survey(number: int) -> bool:
    """Whether a round samples all tiles alike."""
    return number < FIRST or number % EVERY < 2


def surveys(rounds: int, half: int) -> int:
    """The number of surveys of a half among the first rounds."""
    return sum(is_survey(number) for number in range(half, rounds, 2))


def shares(tiles: Tiles, taken: Counts, variances: Doubles, places: int) -> Counts:
    """How often a round of a half samples each tile.

    The mean squared error of the image, the sum of variance / count over the tiles, is least for counts in proportion
    to the standard deviations: tiles are sampled that have less than this share.

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

    Few surveys know little of a single tile.
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

"""Accumulations of renders that take more samples where there is more noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from djpt.long_renders.accumulation import Accumulation, Doubles, Floats, luminance
from djpt.long_renders.allocation import half_of, is_survey, shares, surveys
from djpt.long_renders.fingerprint import Fingerprint
from djpt.long_renders.tiles import Tiles
from djpt.types import TensorXf

__all__ = ["AdaptiveAccumulation", "TileSums"]

Counts = npt.NDArray[np.int64]


@dataclass(frozen=True)
class TileSums:
    """The films of the tiles that a round has sampled."""

    places: Counts
    """The numbers of the tiles, in order; a tile that was sampled several times is there as often."""
    sums: Floats
    """Their sums, (channels and weight, len(places), height, width)."""
    constant: Floats
    """The channels that come from the centres of pixels, (height, width, channels)."""


@dataclass(frozen=True)
class AdaptiveAccumulation(Accumulation):
    """The sum of some rounds over tiles: see `djpt.long_renders.tiles` and `djpt.long_renders.allocation`.

    `a + b` adds halves to halves, so that the image stays unbiased.
    """

    tiles: Tiles
    films: Doubles
    """Sums of the tiles' films in each half, (2, channels that are filtered and weight, tiles, height, width)."""
    products: Doubles
    """Over all rounds the sums of l l, l w and w w, l being the weighted luminance of a tile's film in a round and w
    its weight: (3, tiles, height, width)."""
    taken: Counts
    """How often each tile was sampled in each half, (2, tiles)."""
    last: Floats
    """The luminance of the last survey of each half, (2, height, width)."""
    changes: Doubles
    """Halves of the squared changes between the surveys of a half, summed; means over the tiles, (2, tiles)."""

    stored: ClassVar[Mapping[str, str]] = {
        "films": "<f8",
        "products": "<f8",
        "taken": "<i8",
        "last": "<f4",
        "changes": "<f8",
        "constant": "<f4",
    }

    @classmethod
    def empty(
        cls, fingerprint: Fingerprint, channels: Sequence[str], constant: int, tiles: Tiles, round_spp: int
    ) -> AdaptiveAccumulation:
        """The accumulation of no rounds; `constant` channels aren't filtered."""
        width, height = (n - 2 * tiles.border for n in tiles.grid)
        return cls(
            fingerprint=fingerprint,
            channels=tuple(channels),
            round_spp=round_spp,
            seeds=(),
            constant=np.zeros((height, width, constant), np.float32),
            tiles=tiles,
            films=np.zeros((2, len(channels) - constant + 1, tiles.count, *tiles.film)),
            products=np.zeros((3, tiles.count, *tiles.film)),
            taken=np.zeros((2, tiles.count), np.int64),
            last=np.zeros((2, height, width), np.float32),
            changes=np.zeros((2, tiles.count)),
        )

    # ---- the image ----------------------------------------------------------------------------

    def samples(self) -> TensorXf:
        return TensorXf(self.tiles.spread(self.taken.sum(0) * self.round_spp).astype(np.float32))

    def filtered(self) -> Doubles:
        """The mean of the images of both halves."""
        halves = [self._image_of(half)[:-1] for half in (0, 1) if self.taken[half].any()]
        if not halves:
            width, height = self.size
            return np.zeros((self.films.shape[1] - 1, height, width))
        return halves[0] if len(halves) == 1 else (halves[0] + halves[1]) / 2

    def _image_of(self, half: int) -> Doubles:
        """The image of a half, and the weight of its pixels if each tile had been sampled once."""
        return developed(self.tiles, self.films[half] / np.maximum(self.taken[half], 1)[:, None, None])

    def variance(self) -> Doubles:
        """The variance of a film's luminance between the rounds, divided by their number, added up over the tiles.

        Where pixels are divided by weights that are random, too, it is that of l - w x with the pixel's luminance x.
        """
        if not self.taken.all():
            width, height = self.size
            return np.full((height, width), np.inf)
        count = self.taken.sum(0)[:, None, None]
        x = self.tiles.parted(luminance(self.filtered(), self.channels))
        totals = self.films.sum(0)
        mean = luminance(totals[:-1], self.channels) - x * totals[-1]
        square = self.products[0] - 2 * x * self.products[1] + x * x * self.products[2]
        of_round = np.maximum(square - mean * mean / count, 0) / (count - 1)
        # The image is the mean of two images, of which each divides by its own counts.
        of_image = of_round * (1 / self.taken).sum(0)[:, None, None] / 4
        weights = self.tiles.joined(totals[-1] / count)
        return self.tiles.joined(of_image) / np.where(weights == 0, 1, weights) ** 2

    def mean_luminance(self) -> float:
        return float(luminance(self.filtered(), self.channels).mean()) if self.rounds else 0.0

    # ---- sums ----------------------------------------------------------------------------------

    def places(self, number: int) -> Counts:
        """The tiles that a round is to sample, in order: see `TileSums`."""
        half = half_of(number)
        every = np.arange(self.tiles.count)
        known = surveys(self.rounds, 1 - half) - 1
        if is_survey(number) or known < 1:
            return every
        return np.repeat(every, shares(self.tiles, self.taken[half], self.changes[1 - half] / known))

    def with_round(self, seed: int, part: TileSums) -> AdaptiveAccumulation:
        """This accumulation and one more round."""
        half, every = half_of(self.rounds), np.arange(self.tiles.count)
        bright, weight = luminance(part.sums[:-1], self.channels).astype(np.float64), part.sums[-1].astype(np.float64)
        products = np.stack([bright * bright, bright * weight, weight * weight])
        films, taken = self.films.copy(), self.taken.copy()
        if len(part.places) == len(every) and (part.places == every).all():
            films[half] += part.sums
            taken[half] += 1
            products += self.products
        else:
            sampled, first, number = np.unique(part.places, return_index=True, return_counts=True)
            films[half][:, sampled] += np.add.reduceat(part.sums, first, axis=1, dtype=np.float64)
            taken[half][sampled] += number
            added = np.add.reduceat(products, first, axis=1)
            products = self.products.copy()
            products[:, sampled] += added
        found = replace(
            self, seeds=(*self.seeds, seed), constant=part.constant, films=films, products=products, taken=taken
        )
        return found.with_survey(half, part) if is_survey(self.rounds) else found

    def with_survey(self, half: int, part: TileSums) -> AdaptiveAccumulation:
        """This accumulation with what is known of the tiles after the round `part` has sampled all of them."""
        now = luminance(developed(self.tiles, part.sums.astype(np.float64))[:-1], self.channels)
        last, changes = self.last.copy(), self.changes.copy()
        if surveys(self.rounds, half) > 1:
            changes[half] += self.tiles.means(np.square(now - last[half]) / 2)
        last[half] = now
        return replace(self, last=last, changes=changes)

    def joined(self, other: AdaptiveAccumulation) -> AdaptiveAccumulation:
        return replace(
            self,
            seeds=self.seeds + other.seeds,
            films=self.films + other.films,
            products=self.products + other.products,
            taken=self.taken + other.taken,
            changes=self.changes + other.changes,
        )

    # ---- files ----------------------------------------------------------------------------------

    def facts(self) -> dict[str, Any]:
        return {"tiles": {"border": self.tiles.border, "reach": self.tiles.reach}}

    @classmethod
    def further(cls, header: Mapping[str, Any]) -> dict[str, Any]:
        border, reach = (header["tiles"][name] for name in ("border", "reach"))
        if not all(type(n) is int and 0 <= n < 2**10 for n in (border, reach)):
            raise ValueError("'tiles' is out of range")
        width, height = header["size"]
        return {"tiles": Tiles((width + 2 * border, height + 2 * border), border, reach)}

    @classmethod
    def shapes(cls, header: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
        (width, height), constant = header["size"], header["constant"]
        tiles: Tiles = cls.further(header)["tiles"]
        return {
            "films": (2, len(header["channels"]) - constant + 1, tiles.count, *tiles.film),
            "products": (3, tiles.count, *tiles.film),
            "taken": (2, tiles.count),
            "last": (2, height, width),
            "changes": (2, tiles.count),
            "constant": (height, width, constant),
        }


def developed(tiles: Tiles, films: Doubles) -> Doubles:
    """The image that films of tiles add up to, divided by its weight; the weight is its last channel."""
    whole = tiles.joined(films)
    return np.concatenate([whole[:-1] / np.where(whole[-1] == 0, 1, whole[-1]), whole[-1:]])

"""Accumulations of renders that take more samples where there is more noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from djpt.jit.types import TensorXf
from djpt.rendering.progressive.accumulation import Accumulation, Doubles, Floats, luminance, versions
from djpt.rendering.progressive.allocation import MOST, half_of, is_survey, shares, surveys
from djpt.rendering.progressive.fingerprint import Fingerprint
from djpt.rendering.progressive.tiles import Tiles

__all__ = ["AdaptiveAccumulation", "TileSums"]

Counts = npt.NDArray[np.int64]

TOGETHER = 2**8
"""The tiles whose films are computed with at once: what is needed meanwhile is small beside the sums."""


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
        """Some tiles after the other, and their films (channels and weight, places, height, width).

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


@dataclass(frozen=True)
class AdaptiveAccumulation(Accumulation):
    """The sum of some rounds over tiles.

    See `djpt.rendering.progressive.tiles` and `djpt.rendering.progressive.allocation`.

    `a + b` adds halves to halves, so that the image stays unbiased.
    """

    tiles: Tiles
    even: Doubles
    """Sums of the tiles' films in the half of the even rounds, (channels that are filtered and weight, tiles, height,
    width)."""
    odd: Doubles
    """The same in the other half. A round leaves the half that it doesn't belong to as it is, without a copy."""
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
        "even": "<f8",
        "odd": "<f8",
        "products": "<f8",
        "taken": "<i8",
        "last": "<f4",
        "changes": "<f8",
        "constant": "<f4",
    }
    added: ClassVar[Sequence[str]] = ("even", "odd", "products", "taken", "changes")

    @classmethod
    def empty(
        cls,
        fingerprint: Fingerprint,
        channels: Sequence[str],
        constant: int,
        tiles: Tiles,
        round_spp: int,
        schedule: str,
    ) -> AdaptiveAccumulation:
        """The accumulation of no rounds; `constant` channels aren't filtered."""
        width, height = (n - 2 * tiles.border for n in tiles.grid)
        return cls(
            software=versions(),
            fingerprint=fingerprint,
            channels=tuple(channels),
            round_spp=round_spp,
            schedule=schedule,
            seeds=(),
            counts=(),
            beginning=None,
            constant=np.zeros((height, width, constant), np.float32),
            tiles=tiles,
            even=np.zeros((len(channels) - constant + 1, tiles.count, *tiles.film)),
            odd=np.zeros((len(channels) - constant + 1, tiles.count, *tiles.film)),
            products=np.zeros((3, tiles.count, *tiles.film)),
            taken=np.zeros((2, tiles.count), np.int64),
            last=np.zeros((2, height, width), np.float32),
            changes=np.zeros((2, tiles.count)),
        )

    # ---- the image ----------------------------------------------------------------------------

    @property
    def layout(self) -> Any:
        return super().layout, self.tiles

    def samples(self) -> TensorXf:
        return TensorXf(self.tiles.spread(self.taken.sum(0) * self.round_spp).astype(np.float32))

    def filtered(self) -> Doubles:
        """The mean of the images of both halves."""
        halves = [half for half in (0, 1) if self.taken[half].any()]
        if not halves:
            width, height = self.size
            return np.zeros((len(self.even) - 1, height, width))
        first, *others = [self._image_of(half) for half in halves]
        return (first + others[0]) / 2 if others else first

    def _image_of(self, half: int) -> Doubles:
        """The image of a half."""
        counts, films = np.maximum(self.taken[half], 1), self._films[half]
        return developed(len(films), lambda channel: self.tiles.joined(films[channel], counts))

    @property
    def _films(self) -> tuple[Doubles, Doubles]:
        return self.even, self.odd

    def variance(self) -> Doubles:
        """The variance of a film's luminance between the rounds, divided by their number, added up over the tiles.

        Where pixels are divided by weights that are random, too, it is that of l - w x with the pixel's luminance x.
        """
        if not self.taken.all():
            width, height = self.size
            return np.full((height, width), np.inf)
        x = self.tiles.parted(luminance(self.filtered(), self.channels))
        of_films, weights = np.empty_like(x), np.empty_like(x)
        for start in range(0, self.tiles.count, TOGETHER):
            some = slice(start, start + TOGETHER)
            taken, count = self.taken[:, some], self.taken[:, some].sum(0)[:, None, None]
            totals = self.even[:, some] + self.odd[:, some]
            mean, products = luminance(totals[:-1], self.channels), self.products[:, some]
            mean = mean - x[some] * totals[-1]
            square = products[0] - 2 * x[some] * products[1] + x[some] * x[some] * products[2]
            of_round = np.maximum(square - mean * mean / count, 0) / (count - 1)
            # The image is the mean of two images, of which each divides by its own counts.
            of_films[some] = of_round * (1 / taken).sum(0)[:, None, None] / 4
            weights[some] = totals[-1] / count
        of_image, weight = self.tiles.joined(of_films), self.tiles.joined(weights)
        return of_image / np.where(weight == 0, 1, weight) ** 2

    def mean_luminance(self) -> float:
        return float(luminance(self.filtered(), self.channels).mean()) if self.rounds else 0.0

    # ---- sums ----------------------------------------------------------------------------------

    def places(self, number: int, count: int) -> Counts:
        """The tiles that a round of `count` samples per pixel is to sample, in order: see `TileSums`.

        A smaller round samples fewer tiles.
        """
        half = half_of(number)
        every = np.arange(self.tiles.count)
        known = surveys(self.rounds, 1 - half) - 1
        if self._is_survey(number, count) or known < 1:
            return every
        places = max(1, round(self.tiles.count * count / self.round_spp))
        return np.repeat(every, shares(self.tiles, self.taken[half], self.changes[1 - half] / known, places))

    def _is_survey(self, number: int, count: int) -> bool:
        """Whether a round samples all tiles alike: a smaller one can't."""
        return is_survey(number) and count == self.round_spp

    def with_round(self, seed: int, count: int, part: TileSums) -> AdaptiveAccumulation:
        """This accumulation and one more round, of `count` samples per pixel."""
        half, survey = half_of(self.rounds), self._is_survey(self.rounds, count)
        last, changes = self._surveyed(half, part) if survey else (self.last, self.changes)
        films, products, taken = self._films[half].copy(), self.products.copy(), self.taken.copy()
        for places, sums in part.by_tiles():
            bright, weight = luminance(sums[:-1], self.channels).astype(np.float64), sums[-1].astype(np.float64)
            of_places = np.stack([bright * bright, bright * weight, weight * weight])
            sampled, first, number = np.unique(places, return_index=True, return_counts=True)
            films[:, sampled] += np.add.reduceat(sums, first, axis=1, dtype=np.float64)
            products[:, sampled] += np.add.reduceat(of_places, first, axis=1)
            taken[half][sampled] += number
        return replace(
            self,
            seeds=(*self.seeds, seed),
            counts=(*self.counts, count),
            beginning=self if count < self.round_spp else None,
            constant=part.constant,
            even=self.even if half else films,
            odd=films if half else self.odd,
            products=products,
            taken=taken,
            last=last,
            changes=changes,
        )

    def _surveyed(self, half: int, part: TileSums) -> tuple[Floats, Doubles]:
        """The luminance and the changes that are known after a survey `part`, which has sampled all tiles."""
        image = developed(len(self.even), lambda channel: self.tiles.joined(part.channel(channel)))
        now = luminance(image, self.channels)
        last, changes = self.last.copy(), self.changes.copy()
        if surveys(self.rounds + 1, half) > 1:
            changes[half] += self.tiles.means(np.square(now - last[half]) / 2)
        last[half] = now
        return last, changes

    # ---- files ----------------------------------------------------------------------------------

    def facts(self) -> dict[str, Any]:
        return {"tiles": {"border": self.tiles.border, "reach": self.tiles.reach}}

    def check(self) -> None:
        super().check()
        places = sum(max(1, round(self.tiles.count * count / self.round_spp)) for count in self.counts)
        # Where there are very many tiles, a round may leave out what would be too much for one.
        least = places if self.tiles.count <= MOST else min(places, self.tiles.count)
        if (self.taken < 0).any() or not least <= self.taken.sum() <= places:
            raise ValueError(f"its tiles were sampled {self.taken.sum()} times, by its rounds {places} times")

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
        films = len(header["channels"]) - constant + 1, tiles.count, *tiles.film
        return {
            "even": films,
            "odd": films,
            "products": (3, tiles.count, *tiles.film),
            "taken": (2, tiles.count),
            "last": (2, height, width),
            "changes": (2, tiles.count),
            "constant": (height, width, constant),
        }


def developed(channels: int, of_channel: Callable[[int], Doubles]) -> Doubles:
    """The image of some `channels`, each divided by the weight, which is the last one.

    `of_channel` adds up the films of a channel: together they would be more than twice an image.
    """
    weight = of_channel(channels - 1)
    weight[weight == 0] = 1
    image = np.empty((channels - 1, *weight.shape))
    for channel, pixels in enumerate(image):
        np.divide(of_channel(channel), weight, out=pixels)
    return image

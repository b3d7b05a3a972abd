"""Accumulations: the partial results of renders that can be continued."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from djpt.core.color import luminance
from djpt.errors import RenderError
from djpt.jit.types import TensorXf
from djpt.rendering.progressive import checkpoint
from djpt.rendering.progressive.checkpoint import Fingerprint, difference, versions
from djpt.rendering.progressive.tiles import MOST, Counts, Tiles, TileSums, half_of, is_survey, shares, surveys

if TYPE_CHECKING:
    from djpt.rendering.progressive.rounds import RoundSums

__all__ = ["Accumulation", "AdaptiveAccumulation", "Error", "EvenAccumulation"]

Doubles = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]

Same = TypeVar("Same", bound="Accumulation")


class Error(NamedTuple):
    """The distance of an image from one of infinitely many samples, estimated from its rounds' differences."""

    overall: float
    """The relative RMSE: the root of the mean squared error of the pixels' luminance, divided by the mean luminance."""
    pixels: TensorXf
    """The standard error of the luminance of each pixel, (height, width)."""


@dataclass(frozen=True, kw_only=True)
class Accumulation:
    """The sum of some rounds of a render: an image, its error, and everything needed to continue.

    `djpt.render_passes` makes them: an `EvenAccumulation`, and with `adaptive` an `AdaptiveAccumulation`. An
    accumulation doesn't change: the next round makes another one. Sums are of 64 bits and are added up in the order of
    rounds, so that the image is a function of (scene, spp, seed, round_spp).
    """

    software: str = field(default_factory=versions)
    """The versions of djpt and Dr.Jit that its rounds come from: see `versions`."""
    fingerprint: Fingerprint
    """The fingerprint of the render: see `djpt.rendering.progressive.checkpoint`."""
    channels: tuple[str, ...]
    """The names of the image's channels."""
    round_spp: int
    """Samples per pixel of each whole round, on average."""
    schedule: str
    """The schedule that fills lanes, as for `render`."""
    seeds: tuple[int, ...] = ()
    """The seed of each round."""
    counts: tuple[int, ...] = ()
    """The samples per pixel of each round, on average: `round_spp`, or fewer in a last one."""
    beginning: Accumulation | None = None
    """The whole rounds, if a last one is smaller: a render continues from them."""
    constant: Floats
    """The channels that come from the centres of pixels, (height, width, channels)."""

    stored: ClassVar[Mapping[str, str]] = {"constant": "<f4"}
    """The arrays in the order of files, and their types there."""
    added: ClassVar[Sequence[str]] = ()
    """The arrays that `a + b` adds up."""

    # ---- the image ----------------------------------------------------------------------------

    @property
    def rounds(self) -> int:
        """The number of rounds."""
        return len(self.seeds)

    @property
    def spp(self) -> int:
        """Samples per pixel that the image consists of, on average."""
        return sum(self.counts)

    @property
    def share(self) -> float:
        """Samples per pixel in units of whole rounds."""
        return self.spp / self.round_spp

    @property
    def whole(self: Same) -> Same:
        """The accumulation that a render continues from: this one, without a last round that is smaller."""
        if self.beginning is None:
            return self
        assert isinstance(self.beginning, type(self))
        return self.beginning

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        height, width, _ = self.constant.shape
        return width, height

    @property
    def layout(self) -> Any:
        """The layout that determines the arrays' shapes: the numbers of all channels and of unfiltered ones."""
        return len(self.channels), self.constant.shape[2]

    def image(self) -> TensorXf:
        """The image, (height, width, channels), as `render` returns it."""
        filtered = np.moveaxis(self.filtered().astype(np.float32), 0, 2)
        return TensorXf(np.ascontiguousarray(np.concatenate([filtered, self.constant], axis=2)))

    def error(self) -> Error:
        """The error of the image's luminance, estimated from the variance between rounds; infinite for one round.

        It is unbiased also for samplers whose samples within a round depend on each other, as rounds don't. Light that
        no round has found yet is no part of it. Without colour channels, the mean of all channels is the luminance.
        """
        return self._error

    @cached_property
    def _error(self) -> Error:
        variance, mean = self.variance(), self.mean_luminance()
        squared = float(variance.mean()) if variance.size else 0.0
        relative = math.sqrt(squared) / abs(mean) if mean else math.inf if squared else 0.0
        if self.rounds < 2:
            relative = math.inf
        return Error(relative, TensorXf(np.sqrt(variance).astype(np.float32)))

    def samples(self) -> TensorXf:
        """Samples of each pixel, (height, width)."""
        raise NotImplementedError

    def filtered(self) -> Doubles:
        """The channels that samples are filtered for, (channels, height, width)."""
        raise NotImplementedError

    def variance(self) -> Doubles:
        """The squared standard error of the luminance of each pixel, (height, width); infinite for one round."""
        raise NotImplementedError

    def mean_luminance(self) -> float:
        """The mean luminance of all pixels."""
        raise NotImplementedError

    # ---- sums ----------------------------------------------------------------------------------

    def __add__(self: Same, other: object) -> Same:
        """The sum of two accumulations of one image, with rounds of one size and different seeds.

        Raises:
            RenderError: They are of different images or versions, or share rounds, or only one is adaptive.
        """
        if not isinstance(other, Accumulation):
            return NotImplemented
        problem = "accumulations can't be added"
        self.require_same(other.software, other.fingerprint, problem)
        if type(other) is not type(self):
            raise RenderError(f"{problem}: one is adaptive")
        for name in ("size", "channels", "round_spp"):
            mine, others = getattr(self, name), getattr(other, name)
            if mine != others:
                raise RenderError(f"{problem}: '{name}' is {mine} and {others}")
        shared = set(self.seeds) & set(other.seeds)
        if shared:
            raise RenderError(
                f"{problem}: both contain the round of seed {min(shared)}; render them with different seeds"
            )
        sums: dict[str, Any] = {name: getattr(self, name) + getattr(other, name) for name in self.added}
        seeds, counts = self.seeds + other.seeds, self.counts + other.counts
        return replace(self, seeds=seeds, counts=counts, beginning=None, **sums)

    def require_same(self, software: str, fingerprint: Fingerprint, problem: str) -> None:
        """Raise `RenderError` if versions or a fingerprint aren't these."""
        if software != self.software:
            raise RenderError(f"{problem}: its rounds come from {self.software}, others would come from {software}")
        differing = difference(self.fingerprint, fingerprint)
        if differing:
            raise RenderError(f"{problem}: what is rendered differs in {differing}")

    # ---- files ----------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file that `load` reads. It appears when it is complete; until then an old one stays.

        Raises:
            FileError: It can't be written.
        """
        checkpoint.save(path, self.header(), [self] if self.beginning is None else [self, self.beginning])

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Accumulation:
        """Read a file that `save` has written; untrusted files can't run code.

        Raises:
            FileError: It can't be read, is of another kind or version, or is damaged.
        """
        return checkpoint.load(path, kind_of)

    def header(self) -> dict[str, Any]:
        """The facts about the render that files hold: strings and integers."""
        return {
            "software": self.software,
            "fingerprint": dict(self.fingerprint),
            "channels": self.channels,
            "constant": self.constant.shape[2],
            "size": self.size,
            "round_spp": self.round_spp,
            "schedule": self.schedule,
            "seeds": self.seeds,
            "counts": self.counts,
        }

    @classmethod
    def stored_in(
        cls: type[Same], header: Mapping[str, Any], rounds: int, beginning: Same | None, arrays: Mapping[str, Any]
    ) -> Same:
        """The accumulation of the first `rounds` of a header that has been checked, with arrays by name."""
        return cls(
            software=header["software"],
            fingerprint=header["fingerprint"],
            channels=tuple(header["channels"]),
            round_spp=header["round_spp"],
            schedule=header["schedule"],
            seeds=tuple(header["seeds"][:rounds]),
            counts=tuple(header["counts"][:rounds]),
            beginning=beginning,
            **cls.further(header),
            **arrays,
        )

    def facts(self) -> dict[str, Any]:
        """The facts that files hold besides the arrays and the common header: strings and integers."""
        return {}

    def check(self) -> None:
        """Raise `ValueError` if the arrays of a file contradict each other, or the rounds."""
        if not self.rounds and any(getattr(self, name).any() for name in self.stored):
            raise ValueError("it has sums but no rounds")

    @classmethod
    def shapes(cls, header: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
        """The shapes of the arrays of a file with a header whose common entries have been checked.

        Raises:
            ValueError: The other entries are wrong.
            KeyError: They are missing.
        """
        raise NotImplementedError

    @classmethod
    def further(cls, header: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes that a header holds in its `facts`."""
        return {}


@dataclass(frozen=True, kw_only=True)
class EvenAccumulation(Accumulation):
    """The sum of some rounds over all pixels."""

    sums: Doubles
    """Weighted sums, (channels that are filtered, height, width)."""
    weights: Doubles
    """Their weights, (height, width), or (1, 1) if all pixels have the same."""
    luminance: Doubles
    """Sums over the even rounds, and over the odd ones, of the image's luminance, (2, height, width).

    A smaller round counts by its fraction of the samples of a whole one.
    """
    squares: Doubles
    """The sum over all rounds of the squared luminance, by the same shares, (height, width)."""

    stored: ClassVar[Mapping[str, str]] = {
        "sums": "<f8",
        "weights": "<f8",
        "constant": "<f4",
        "luminance": "<f8",
        "squares": "<f8",
    }
    added: ClassVar[Sequence[str]] = ("sums", "weights", "luminance", "squares")

    @classmethod
    def empty(
        cls,
        fingerprint: Fingerprint,
        channels: Sequence[str],
        constant: int,
        size: tuple[int, int],
        round_spp: int,
        schedule: str,
    ) -> EvenAccumulation:
        """The accumulation of no rounds, of `size` (width, height); `constant` channels aren't filtered."""
        width, height = size
        return cls(
            fingerprint=fingerprint,
            channels=tuple(channels),
            round_spp=round_spp,
            schedule=schedule,
            constant=np.zeros((height, width, constant), np.float32),
            sums=np.zeros((len(channels) - constant, height, width)),
            weights=np.zeros((1, 1)),
            luminance=np.zeros((2, height, width)),
            squares=np.zeros((height, width)),
        )

    def samples(self) -> TensorXf:
        width, height = self.size
        return TensorXf(np.full((height, width), self.spp, np.float32))

    def filtered(self) -> Doubles:
        return self.sums / np.where(self.weights == 0, 1, self.weights)

    def variance(self) -> Doubles:
        """With R rounds of luminance x and share f: (sum of f x^2 - (sum of f x)^2 / F) / (F (R - 1)), F = sum of f.

        It is unbiased if the variance of x is in proportion to 1 / f.
        """
        if self.rounds < 2:
            return np.full_like(self.squares, np.inf)
        spread = self.squares - self.luminance.sum(0) ** 2 / self.share
        return np.maximum(spread, 0) / (self.share * (self.rounds - 1))

    def mean_luminance(self) -> float:
        return float(self.luminance.sum(0).mean()) / self.share if self.rounds else 0.0

    def with_round(self, seed: int, count: int, part: RoundSums) -> EvenAccumulation:
        """This accumulation and one more round, of `count` samples per pixel."""
        share = count / self.round_spp
        if self.rounds and self.weights.shape != part.weights.shape:
            raise RenderError("the render can't continue: its weights don't match the film's")
        weights = np.where(part.weights == 0, 1, part.weights)
        brightness = luminance(part.sums / weights, self.channels).astype(np.float64)
        halves = self.luminance.copy()
        halves[self.rounds % 2] += share * brightness
        return replace(
            self,
            seeds=(*self.seeds, seed),
            counts=(*self.counts, count),
            beginning=self if count < self.round_spp else None,
            sums=self.sums + part.sums,
            weights=self.weights + part.weights,
            constant=part.constant,
            luminance=halves,
            squares=self.squares + share * (brightness * brightness),
        )

    def facts(self) -> dict[str, Any]:
        return {"weighted": self.weights.shape == self.squares.shape}

    def check(self) -> None:
        super().check()
        if self.weights.size == 1 != self.squares.size and self.weights.item() != self.spp:
            raise ValueError(f"its weights are of {self.weights.item():g} samples per pixel, its rounds of {self.spp}")
        if (self.squares < 0).any() or (self.rounds < 2 and self.luminance[1].any()):
            raise ValueError("its luminance doesn't match its rounds")

    @classmethod
    def shapes(cls, header: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
        (width, height), constant = header["size"], header["constant"]
        if not isinstance(header["weighted"], bool):
            raise ValueError("'weighted' must be true or false")
        return {
            "sums": (len(header["channels"]) - constant, height, width),
            "weights": (height, width) if header["weighted"] else (1, 1),
            "constant": (height, width, constant),
            "luminance": (2, height, width),
            "squares": (height, width),
        }


@dataclass(frozen=True, kw_only=True)
class AdaptiveAccumulation(Accumulation):
    """The sum of some rounds over tiles.

    See `djpt.rendering.progressive.tiles`.

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
    """The number of times that each tile was sampled in each half, (2, tiles)."""
    last_even: Floats
    """The luminance of the last survey in the half of the even rounds, (height, width)."""
    last_odd: Floats
    """The same in the other half; left as it is like `odd`."""
    changes: Doubles
    """Halves of the squared changes between the surveys of a half, summed; means over the tiles, (2, tiles)."""

    stored: ClassVar[Mapping[str, str]] = {
        "even": "<f8",
        "odd": "<f8",
        "products": "<f8",
        "taken": "<i8",
        "last_even": "<f4",
        "last_odd": "<f4",
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
            fingerprint=fingerprint,
            channels=tuple(channels),
            round_spp=round_spp,
            schedule=schedule,
            constant=np.zeros((height, width, constant), np.float32),
            tiles=tiles,
            even=np.zeros((len(channels) - constant + 1, tiles.count, *tiles.film)),
            odd=np.zeros((len(channels) - constant + 1, tiles.count, *tiles.film)),
            products=np.zeros((3, tiles.count, *tiles.film)),
            taken=np.zeros((2, tiles.count), np.int64),
            last_even=np.zeros((height, width), np.float32),
            last_odd=np.zeros((height, width), np.float32),
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
        return self.tiles.developed(len(films), lambda channel: films[channel], counts)

    @property
    def _films(self) -> tuple[Doubles, Doubles]:
        return self.even, self.odd

    @property
    def _last(self) -> tuple[Floats, Floats]:
        return self.last_even, self.last_odd

    def variance(self) -> Doubles:
        """The variance of a film's luminance between the rounds, divided by their number, added up over the tiles.

        Where pixels are divided by weights that are random, too, it is that of l - w x with the pixel's luminance x.
        """
        if not self.taken.all():
            width, height = self.size
            return np.full((height, width), np.inf)
        x = self.tiles.parted(luminance(self.filtered(), self.channels))
        of_films, weights = np.empty_like(x), np.empty_like(x)
        for some in self.tiles.parts():
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
        """True if a round samples all tiles alike: a smaller one can't."""
        return is_survey(number) and count == self.round_spp

    def with_round(self, seed: int, count: int, part: TileSums) -> AdaptiveAccumulation:
        """This accumulation and one more round, of `count` samples per pixel."""
        half, survey = half_of(self.rounds), self._is_survey(self.rounds, count)
        last, changes = self._surveyed(half, part) if survey else (self._last[half], self.changes)
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
            last_even=self.last_even if half else last,
            last_odd=last if half else self.last_odd,
            changes=changes,
        )

    def _surveyed(self, half: int, part: TileSums) -> tuple[Floats, Doubles]:
        """The luminance of a survey `part`, which has sampled all tiles, and the changes that are known after it."""
        last = np.empty_like(self._last[half])  # before arrays that go again: above their memory it would keep it
        image = self.tiles.developed(len(self.even), part.channel)
        now = luminance(image, self.channels)
        changes = self.changes.copy()
        if surveys(self.rounds + 1, half) > 1:
            changes[half] += self.tiles.means(np.square(now - self._last[half]) / 2)
        last[:] = now
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
            "last_even": (height, width),
            "last_odd": (height, width),
            "changes": (2, tiles.count),
            "constant": (height, width, constant),
        }


def kind_of(header: Mapping[str, Any]) -> type[Accumulation]:
    """The class of the accumulation of a header, by its entries besides the common `header`."""
    return AdaptiveAccumulation if "tiles" in header["sets"][0] else EvenAccumulation

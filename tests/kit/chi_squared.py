"""Pearson's chi-squared test, on a grid, that samples follow the density that is claimed for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

import djpt
from djpt.mitsuba.math import chi2, rlgamma
from tests.kit.arrays import floats, in_numpy

__all__ = ["PLANE", "SPHERE", "Domain", "Partition", "p_value", "probability_of_counts", "uniform"]

SIGNIFICANCE = 1e-5
"""The smallest p-value that passes: a suite of hundreds of tests then fails falsely less than once in 100 times."""


class Domain:
    """A rectangle of coordinates (a, b) that covers the values of a sampler, with an area-preserving map."""

    def __init__(self, low: Any, high: Any, point: Callable[..., Any], coordinates: Callable[..., Any]) -> None:
        self.low, self.high = np.array(low, float), np.array(high, float)
        self.point, self.coordinates = point, coordinates


def _direction(cos: np.ndarray, phi: np.ndarray) -> Any:
    sin = np.sqrt(np.maximum(0, 1 - cos**2))
    return djpt.Vector3f(*(floats(x) for x in (sin * np.cos(phi), sin * np.sin(phi), cos)))


def _cylinder(d: Any) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = in_numpy(d)
    # Near the pole float32 knows x and y better than z.
    z = np.where(z > 0.9, np.sqrt(np.maximum(0, 1 - x * x - y * y)), np.clip(z, -1, 1))
    return z, np.mod(np.arctan2(y, x), 2 * np.pi)


SPHERE = Domain((-1, 0), (1, 2 * np.pi), _direction, _cylinder)
"""Directions by (cos theta, phi): equal areas, by Archimedes."""

PLANE = Domain(
    (-1, -1),
    (1, 1),
    lambda x, y: djpt.Point2f(floats(x), floats(y)),
    lambda p: tuple(in_numpy(p)),
)
"""The square [-1, 1]^2."""


def uniform(count: int, dimensions: int = 2, seed: int = 0) -> list[Any]:
    """Independent uniform numbers, one Float per dimension."""
    u = np.random.default_rng(seed).random((dimensions, count), dtype=np.float32)
    return [floats(row) for row in u]


def p_value(
    domain: Domain,
    values: Any,
    valid: Any,
    density: Callable[[Any], Any],
    bins: tuple[int, int] = (20, 24),
    fine: int = 24,
) -> tuple[float, float]:
    """The p-value, and the integral of the density.

    `values` are all samples, of which the `valid` ones count. The density is integrated with `fine` x `fine`
    points per bin; the share that its integral lacks must be invalid.
    """
    valid = np.broadcast_to(np.array(valid, bool), (dr.width(values),))
    a, b = (x[valid] for x in domain.coordinates(values))
    observed, _, _ = np.histogram2d(a, b, bins, [(domain.low[0], domain.high[0]), (domain.low[1], domain.high[1])])

    n = np.array(bins) * fine
    # Stratified, since a regular grid errs alike along the edge of a density.
    cell, jitter = np.indices(n), np.random.default_rng(9).random((2, *n))
    at = [domain.low[i] + (cell[i] + jitter[i]) / n[i] * (domain.high[i] - domain.low[i]) for i in range(2)]
    found = np.array(density(domain.point(at[0].ravel(), at[1].ravel())), np.float64)
    grid = np.broadcast_to(found, (at[0].size,)).reshape(bins[0], fine, bins[1], fine)
    area = np.prod(domain.high - domain.low) / np.prod(n)
    expected = grid.sum(axis=(1, 3)) * area
    lost = valid.size - int(valid.sum())
    return probability_of_counts(observed, expected, lost), float(expected.sum())


def probability_of_counts(
    observed: np.ndarray,
    expected: np.ndarray,
    lost: int | None = None,
    error: float = 1e-3,
    lost_error: float = 0.0,
    slack: float = 4.0,
) -> float:
    """The p-value of Pearson's test of the counts in bins against the bins' probabilities.

    Rare bins are pooled, so that counts are nearly normal. The density, or its quadrature, may err by `error` of
    its value. Samples that are `lost` fill what the probabilities lack of 1, up to `lost_error`. The cell of rare bins
    and that of lost samples may be nearly empty, and the quadrature isn't exact: their variance is larger by `slack`.
    """
    observed, e = observed.ravel(), expected.ravel() * (observed.sum() + (lost or 0))
    common = e > 20
    counts = np.append(observed[common], observed[~common].sum())
    means = np.append(e[common], e[~common].sum())
    extra = (error * means) ** 2
    extra[-1] += slack
    if lost is not None:
        n = observed.sum() + lost
        rest = n * max(0.0, 1 - expected.sum())
        counts, means = np.append(counts, lost), np.append(means, rest)
        extra = np.append(extra, (error * rest) ** 2 + slack + (lost_error * n) ** 2)
    statistic, freedom, _, _ = chi2(counts, means, 0, extra)
    return 1 - rlgamma(max(1, freedom) / 2, statistic / 2)


# ---------------------------------------------------------------- narrow densities


class Partition:
    """The sphere in rectangles of (cos theta, phi), small where there are many samples: a quadtree.

    `low`, `high` are (bins, 2). Its corners lie on cos theta = 0, where densities often end.
    """

    def __init__(self, directions: Any, share: float = 1 / 200, depth: int = 12) -> None:
        """Split rectangles that hold more than this `share` of the directions."""
        points = _unit_coordinates(directions)
        limit = share * len(points)
        self._leaves: list[np.ndarray] = []  # per level the rectangles that aren't split, as sorted codes
        codes = np.arange(BASE[0] * BASE[1])
        for level in range(depth + 1):
            at = _codes(points, level)
            found, counts = np.unique(at, return_counts=True)
            crowded = np.intersect1d(codes, found[counts > limit]) if level < depth else codes[:0]
            self._leaves.append(np.setdiff1d(codes, crowded))
            points = points[np.isin(at, crowded)]
            row, column = crowded // (BASE[1] << level), crowded % (BASE[1] << level)
            width = BASE[1] << (level + 1)
            codes = np.concatenate([(2 * row + i) * width + 2 * column + j for i in (0, 1) for j in (0, 1)])
        corners = []
        for level, leaves in enumerate(self._leaves):
            size = np.array(BASE) << level
            place = np.stack([leaves // size[1], leaves % size[1]], axis=1)
            corners.append(np.stack([place / size, (place + 1) / size], axis=1))
        low, high = np.concatenate(corners).swapaxes(0, 1)
        self.low, self.high = (SPHERE.low + x * (SPHERE.high - SPHERE.low) for x in (low, high))

    def count(self, directions: Any, valid: np.ndarray) -> np.ndarray:
        """The number of directions in each rectangle."""
        points = _unit_coordinates(directions)[valid]
        parts = []
        for level, leaves in enumerate(self._leaves):
            at = _codes(points, level)
            here = np.isin(at, leaves)
            parts.append(np.bincount(np.searchsorted(leaves, at[here]), minlength=len(leaves)))
            points = points[~here]
        return np.concatenate(parts)

    def integrate(self, function: Callable[[Any], np.ndarray], tolerance: float = 2e-6, depth: int = 7) -> np.ndarray:
        """Integrals over the rectangles of functions of the direction, (functions, bins), by adaptive Gauss quadrature.

        `tolerance` is the error allowed for each piece that a rectangle is divided into.
        """
        low, high = self.low, self.high
        bins = np.arange(len(low))
        coarse = _gauss(function, low, high)
        total = np.zeros((len(coarse), len(bins)))
        for level in range(depth + 1):
            middle = (low + high) / 2
            quarters = []
            for i in (0, 1):
                for j in (0, 1):
                    upper = np.array([i, j], bool)
                    quarters.append((np.where(upper, middle, low), np.where(upper, high, middle)))
            lows, highs = (np.concatenate(x) for x in zip(*quarters, strict=True))
            fine = _gauss(function, lows, highs)
            better = fine.reshape(len(fine), 4, -1).sum(axis=1)
            done = (np.abs(better - coarse) <= tolerance).all(axis=0) | (level == depth)
            np.add.at(total.T, bins[done], better.T[done])
            again = np.tile(~done, 4)
            low, high, bins, coarse = lows[again], highs[again], np.tile(bins, 4)[again], fine[:, again]
            if not len(bins):
                break
        return total


BASE = (16, 32)
"""The number of rectangles, along both axes, that a `Partition` starts with."""


def _unit_coordinates(directions: Any) -> np.ndarray:
    at = np.stack(_cylinder(directions), axis=1)
    return (at - SPHERE.low) / (SPHERE.high - SPHERE.low)


def _codes(points: np.ndarray, level: int) -> np.ndarray:
    """The code of the rectangle of a level that each point lies in."""
    size = np.array(BASE) << level
    place = np.clip((points * size).astype(np.int64), 0, size - 1)
    return place[:, 0] * size[1] + place[:, 1]


def _gauss(function: Callable[[Any], np.ndarray], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Integrals over rectangles by 4 x 4 nodes each, (functions, rectangles)."""
    x, w = np.polynomial.legendre.leggauss(4)
    nodes = np.stack([a.ravel() for a in np.meshgrid((x + 1) / 2, (x + 1) / 2, indexing="ij")], axis=1)
    weights = np.outer(w, w).ravel() / 4
    at = low[:, None] + nodes * (high - low)[:, None]
    values = np.asarray(function(_direction(at[..., 0].ravel(), at[..., 1].ravel())), np.float64)
    values = values.reshape(len(values), len(low), len(weights))
    return (values * weights).sum(axis=2) * np.prod(high - low, axis=1)

"""Do samples follow the density that is claimed for them? Pearson's chi-squared test on a grid."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
from scipy.stats import chi2

import djpt

__all__ = ["PLANE", "SPHERE", "Domain", "p_value", "uniform"]

SIGNIFICANCE = 1e-5
"""Of one test: a suite of hundreds then fails falsely less than once in a hundred changes of the random numbers."""


class Domain:
    """A rectangle of coordinates (a, b) that covers the values of a sampler, with an area-preserving map."""

    def __init__(self, low: Any, high: Any, point: Callable[..., Any], coordinates: Callable[..., Any]) -> None:
        self.low, self.high = np.array(low, float), np.array(high, float)
        self.point, self.coordinates = point, coordinates


def _direction(cos: np.ndarray, phi: np.ndarray) -> Any:
    sin = np.sqrt(np.maximum(0, 1 - cos**2))
    return djpt.Vector3f(*(x.astype(np.float32) for x in (sin * np.cos(phi), sin * np.sin(phi), cos)))


def _cylinder(d: Any) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = np.array(d, np.float64)
    # Near the pole float32 knows x and y better than z.
    z = np.where(z > 0.9, np.sqrt(np.maximum(0, 1 - x * x - y * y)), np.clip(z, -1, 1))
    return z, np.mod(np.arctan2(y, x), 2 * np.pi)


SPHERE = Domain((-1, 0), (1, 2 * np.pi), _direction, _cylinder)
"""Directions by (cos theta, phi): equal areas, by Archimedes."""

PLANE = Domain(
    (-1, -1),
    (1, 1),
    lambda x, y: djpt.Point2f(x.astype(np.float32), y.astype(np.float32)),
    lambda p: tuple(np.array(p, np.float64)),
)
"""The square [-1, 1]^2."""


def uniform(count: int, dimensions: int = 2, seed: int = 0) -> list[Any]:
    """Independent uniform numbers, one Float per dimension."""
    u = np.random.default_rng(seed).random((dimensions, count), dtype=np.float32)
    return [djpt.Float(row) for row in u]


def p_value(
    domain: Domain,
    values: Any,
    valid: Any,
    density: Callable[[Any], Any],
    bins: tuple[int, int] = (20, 24),
    fine: int = 24,
) -> tuple[float, float]:
    """(p-value, integral of the density).

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
    integral = grid.sum() * area
    expected = grid.sum(axis=(1, 3)) * area * valid.size

    # Rare bins are pooled, so that counts are nearly normal.
    expected, observed = expected.ravel(), observed.ravel()
    common = expected > 20
    cells = [*zip(expected[common], observed[common], strict=True), (expected[~common].sum(), observed[~common].sum())]
    cells.append((valid.size * max(0.0, 1 - integral), valid.size - valid.sum()))
    # Cells that are all but empty by quadrature may hold a few samples; the quadrature itself errs a little.
    statistic = sum((o - e) ** 2 / (e + (1e-3 * e) ** 2 + 4) for e, o in cells)
    return float(chi2.sf(statistic, max(1, len(cells) - 1))), float(integral)

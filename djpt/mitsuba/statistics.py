"""Statistics of tests: Pearson's statistic, and the distribution function that its significance follows from.

The names of `djpt.math_py`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

__all__ = ["chi2", "rlgamma"]


def chi2(obs: Any, exp: Any, pool_threshold: float) -> tuple[float, int, int, int]:
    """Pearson's statistic, the sum of (observed - expected)^2 / expected.

    Args:
        obs: observed counts.
        exp: expected ones.
        pool_threshold: cells with smaller expectations are pooled in order until their sum exceeds it.

    Returns:
        The statistic; the degrees of freedom; how many cells were pooled; into how many.
    """
    observed, expected = (np.array(values, np.float64).ravel() for values in (obs, exp))
    common = expected >= pool_threshold
    statistic = float(((observed - expected)[common] ** 2 / expected[common]).sum())
    rare = ~common & ((observed != 0) | (expected != 0))
    pooled, sums = 0, np.zeros(2)
    for pair in zip(observed[rare], expected[rare], strict=True):
        sums += pair
        if sums[1] > pool_threshold:
            statistic += float((sums[0] - sums[1]) ** 2 / sums[1])
            sums[:] = 0
            pooled += 1
    return statistic, int(common.sum()) + pooled - 1, int(rare.sum()), pooled


def rlgamma(a: float, x: float) -> float:
    """The regularised lower incomplete gamma function P(a, x), for a > 0 and x >= 0.

    By its power series for x < a + 1, else 1 - Q by Lentz's evaluation of the continued fraction (W. H. Press et al.,
    "Numerical Recipes", 3rd ed., 6.2). With a = n / 2 and x = s / 2 it is the chance that Pearson's statistic with n
    degrees of freedom is at most s.
    """
    if a < 0 or x < 0:
        raise ValueError(f"rlgamma(): 'a' and 'x' must not be negative, found {a} and {x}")
    if x == 0:
        return 0.0
    scale = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1:
        term = total = 1 / a
        n = a
        while abs(term) > 1e-16 * abs(total):
            n += 1
            term *= x / n
            total += term
        return scale * total
    tiny = 1e-300
    b = x + 1 - a
    c, d = 1 / tiny, 1 / b
    fraction = d
    for i in range(1, 100000):
        numerator = -i * (i - a)
        b += 2
        d, c = numerator * d + b, b + numerator / c
        d = 1 / (d if abs(d) > tiny else tiny)
        c = c if abs(c) > tiny else tiny
        fraction *= c * d
        if abs(c * d - 1) < 1e-15:
            break
    return 1 - scale * fraction

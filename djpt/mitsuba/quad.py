"""Rules of numerical integration over [-1, 1]: nodes and weights. The names of `djpt.quad`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from djpt.errors import ArgumentError
from djpt.jit.types import Float

__all__ = ["chebyshev", "composite_simpson", "composite_simpson_38", "gauss_legendre", "gauss_lobatto"]


def check(name: str, fits: bool, needed: str, n: int) -> None:
    """Raise an `ArgumentError` if a rule has no such number of nodes."""
    if not fits:
        raise ArgumentError(f"{name}(): n must be {needed}, found {n}")


def gauss_legendre(n: int) -> tuple[Float, Float]:
    """The Gauss rule with `n` >= 1 nodes, exact for polynomials up to degree 2 n - 1: the roots of P_n."""
    check("gauss_legendre", n >= 1, ">= 1", n)
    nodes, weights = legendre.leggauss(n)
    return Float(nodes), Float(weights)


def gauss_lobatto(n: int) -> tuple[Float, Float]:
    """The Lobatto rule with `n` >= 2 nodes, exact up to degree 2 n - 3: both ends, and the roots of P'_(n-1).

    Weights are 2 / (n (n - 1) P_(n-1)^2) (Abramowitz and Stegun, "Handbook of Mathematical Functions", 25.4.32).
    """
    check("gauss_lobatto", n >= 2, ">= 2", n)
    polynomial = legendre.Legendre.basis(n - 1)
    slope, curvature = polynomial.deriv(), polynomial.deriv(2)
    inner: Any = slope.roots() if n > 2 else np.zeros(0)
    for _ in range(2):
        inner = inner - slope(inner) / curvature(inner)
    # They lie in pairs about 0.
    inner = 0.5 * (inner - inner[::-1])
    nodes = np.concatenate([[-1.0], inner, [1.0]])
    return Float(nodes), Float(2 / (n * (n - 1) * polynomial(nodes) ** 2))


def composite_simpson(n: int) -> tuple[Float, Float]:
    """Simpson's rule in (n - 1) / 2 intervals side by side, exact up to degree 3; `n` is odd and >= 3."""
    check("composite_simpson", n >= 3 and n % 2 == 1, ">= 3 and odd", n)
    return composite(n, (1, 4), 1 / 3)


def composite_simpson_38(n: int) -> tuple[Float, Float]:
    """Simpson's 3/8 rule in (n - 1) / 3 intervals side by side, exact up to degree 3; `n` - 1 is a multiple of 3."""
    check("composite_simpson_38", n >= 4 and n % 3 == 1, ">= 4, and n - 1 divisible by 3", n)
    return composite(n, (1, 3, 3), 3 / 8)


def composite(n: int, pattern: tuple[int, ...], factor: float) -> tuple[Float, Float]:
    """Equidistant nodes with repeated weights; nodes that two intervals share have the sum of both."""
    step = 2 / (n - 1)
    weights = np.resize(np.array(pattern, float), n)
    weights[:: len(pattern)] = 2
    weights[[0, -1]] = 1
    return Float(np.linspace(-1, 1, n)), Float(weights * step * factor)


def chebyshev(n: int) -> Float:
    """Chebyshev's `n` nodes, the roots of the polynomial of the first kind T_n, in increasing order."""
    check("chebyshev", n >= 1, ">= 1", n)
    return Float(-np.cos(math.pi * (np.arange(n) + 0.5) / n))

"""`djpt.math`, `quad`, `spline`, `math_py`: the same numbers as Mitsuba's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest
from scipy.special import gammainc

import djpt
from djpt.errors import ArgumentError
from tests.kit.same_calls import same

X = [-0.9, -0.3, 0.0, 0.25, 0.8]
NODES = [0.0, 0.3, 0.5, 1.1, 2.0]
RISING = [0.1, 0.2, 0.3, 0.35, 1.0]
WAVE = [0.5, 1.0, 0.25, 2.0, 0.75]

CALLS: list[Callable[[Any], Any]] = [
    *(lambda m, n=n: m.math.legendre_p(n, X) for n in range(6)),
    *(lambda m, n=n, k=k: m.math.legendre_p(n, k, X) for n in range(4) for k in range(n + 1)),
    *(lambda m, n=n: m.math.legendre_pd(n, X) for n in range(6)),
    *(lambda m, n=n: m.math.legendre_pd_diff(n, X) for n in range(1, 5)),
    lambda m: m.math.solve_quadratic([1, 2, 0, 0], [4, -3, 5, -5], [-5, 1, -10, 10]),
    lambda m: m.math.solve_quadratic(1, 0, 1)[0],
    lambda m: m.math.morton_encode2([[1, 123, 65535], [0, 456, 65535]]),
    lambda m: m.math.morton_encode3([[1, 123, 1023], [0, 456, 1023], [7, 789, 1023]]),
    lambda m: m.math.morton_decode2([5, 177605, 2**32 - 1]),
    lambda m: m.math.morton_decode3([5, 12345, 2**30 - 1]),
    lambda m: [m.math.round_to_power_of_two(n) for n in range(20)],
    lambda m: [m.math.is_power_of_two(n) for n in range(20)],
    lambda m: m.math.ulpdiff(1.0, 1.0000002),
    lambda m: m.math.ulpdiff(-3.0, -2.9999995),
    lambda m: [m.math.linear_to_srgb(x) for x in (-0.5, 0.0, 0.003, 0.5, 0.9)],
    lambda m: [m.math.srgb_to_linear(x) for x in (-0.5, 0.0, 0.03, 0.5, 0.9)],
    lambda m: m.math.linear_to_srgb([0.5, 1, 0.2]),
    lambda m: m.math.srgb_to_linear(m.Color3f(0.5, 1, 0.2)),
    lambda m: m.math.find_interval(5, lambda i: i < 3),
    lambda m: m.math.chi2(m.Float64([10, 20, 1, 2, 7]), m.Float64([12, 18, 2, 2, 3.5]), 5.0),
    lambda m: [m.math.RayEpsilon, m.math.ShadowEpsilon, m.math.ShapeEpsilon],
    *(lambda m, n=n: m.quad.gauss_legendre(n) for n in (1, 2, 3, 8, 33)),
    *(lambda m, n=n: m.quad.gauss_lobatto(n) for n in (2, 3, 4, 9, 32)),
    *(lambda m, n=n: m.quad.composite_simpson(n) for n in (3, 7)),
    *(lambda m, n=n: m.quad.composite_simpson_38(n) for n in (4, 10)),
    lambda m: m.quad.chebyshev(7),
    *(lambda m, t=t: m.spline.eval_spline(0.2, 1, -1, 3, t) for t in (0.0, 0.3, 1.0)),
    *(lambda m, t=t: m.spline.eval_spline_d(0.2, 1, -1, 3, t) for t in (0.0, 0.3, 1.0)),
    *(lambda m, t=t: m.spline.eval_spline_i(0.2, 1, -1, 3, t) for t in (0.0, 0.3, 1.0)),
    lambda m: m.spline.eval_1d(0.0, 2.0, WAVE, [-0.1, 0, 0.2, 0.9, 1.7, 2, 2.1]),
    lambda m: m.spline.eval_1d(NODES, WAVE, [-0.1, 0, 0.2, 0.9, 1.7, 2, 2.1]),
    lambda m: m.spline.eval_1d(nodes=NODES, values=WAVE, x=0.7),
    lambda m: m.spline.integrate_1d(0.0, 2.0, WAVE),
    lambda m: m.spline.integrate_1d(NODES, WAVE),
    lambda m: m.spline.invert_1d(0.0, 2.0, RISING, [0, 0.1, 0.15, 0.32, 0.8, 1, 2]),
    lambda m: m.spline.invert_1d(NODES, RISING, [0, 0.1, 0.15, 0.32, 0.8, 1, 2]),
    lambda m: m.spline.sample_1d(0.0, 2.0, WAVE, m.spline.integrate_1d(0.0, 2.0, WAVE), [0, 0.1, 0.5, 0.95]),
    lambda m: m.spline.sample_1d(NODES, WAVE, m.spline.integrate_1d(NODES, WAVE), [0, 0.1, 0.5, 0.95]),
]


@pytest.mark.sparse(36)
@pytest.mark.parametrize("call", CALLS)
def test_same_numbers(call: Callable[[Any], Any], mi: Any) -> None:
    same(call, mi)


def test_legendre_polynomials_of_no_degree_have_the_width_of_their_argument() -> None:
    assert dr.width(djpt.math.legendre_p(0, X)) == len(X)


@pytest.mark.parametrize(("a", "x"), [(0.5, 0.1), (0.5, 9.0), (3.0, 2.9), (3.0, 4.5), (60.0, 40.0), (60.0, 90.0)])
def test_the_incomplete_gamma_function(a: float, x: float) -> None:
    assert djpt.math_py.rlgamma(a, x) == pytest.approx(gammainc(a, x), rel=1e-12)


def test_pooled_statistics_are_those_of_both_modules(mi: Any) -> None:
    rng = np.random.default_rng(2)
    expected = np.sort(rng.exponential(8, 200))
    observed = rng.poisson(expected).astype(float)
    assert djpt.math_py.chi2(observed, expected, 5) == pytest.approx(mi.math_py.chi2(observed, expected, 5))


def test_errors_of_expectations_add_to_the_variance() -> None:
    """Of common cells, and of those that are pooled."""
    statistic, freedom, rare, pooled = djpt.math_py.chi2([24, 4, 3, 4], [20, 2, 2, 2], 5, [5, 1, 2, 3])
    assert (freedom, rare, pooled) == (1, 3, 1)
    assert statistic == pytest.approx(4**2 / (20 + 5) + 5**2 / (6 + 6))
    plain, wide = (djpt.math_py.chi2([24, 18], [20, 20], 5, slack)[0] for slack in (0, 20))
    assert wide == pytest.approx(plain / 2)


# Mitsuba's `eval_spline_weights` and `eval_2d` end the process in its variants with Dr.Jit.


def test_weights_of_a_spline_give_its_values() -> None:
    x = [0.05, 0.4, 0.9, 1.9]
    for grid in ((0.0, 2.0, 5), (NODES,)):
        inside, first, weights = djpt.spline.eval_spline_weights(*grid, x)
        assert dr.all(inside)
        total = sum(
            w * dr.gather(djpt.Float, djpt.Float(WAVE), djpt.UInt32(first + k), w != 0) for k, w in enumerate(weights)
        )
        expected = djpt.spline.eval_1d(*(grid[:2] if len(grid) == 3 else grid), WAVE, x)
        np.testing.assert_allclose(total.numpy(), expected.numpy(), rtol=1e-5)


def test_splines_of_two_variables_are_products() -> None:
    x, y = [0.1, 0.3, 0.5, 0.2], [0.0, 0.4, 2.0, 3.0]
    nodes, along = NODES[:3], WAVE[:3]
    values = [a * b for b in RISING for a in along]
    expected = djpt.spline.eval_1d(nodes, along, x) * djpt.spline.eval_1d(NODES, RISING, y)
    np.testing.assert_allclose(djpt.spline.eval_2d(nodes, NODES, values, x, y).numpy(), expected.numpy(), rtol=1e-5)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: djpt.quad.gauss_legendre(0), "gauss_legendre.*>= 1, found 0"),
        (lambda: djpt.quad.gauss_lobatto(1), "gauss_lobatto.*>= 2, found 1"),
        (lambda: djpt.quad.composite_simpson(4), "composite_simpson.*odd, found 4"),
        (lambda: djpt.quad.composite_simpson_38(5), "composite_simpson_38.*divisible by 3, found 5"),
        (lambda: djpt.spline.eval_1d([0, 1, 2], [0, 1], 0.5), "found 2 values, and 3 nodes"),
        (lambda: djpt.spline.eval_1d(1, 2), r"eval_1d\(\) takes \(min, max, values, x\) or \(nodes, values, x\)"),
        (lambda: djpt.spline.sample_1d(0, 1, WAVE, [1, 2], 0.5), "must have the same size, found 5, 2"),
        (lambda: djpt.math.legendre_p(1, 2, 3, 4), "found 4 arguments"),
    ],
)
def test_what_is_refused(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        call()

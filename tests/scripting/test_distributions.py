"""Distributions given by tables: the same numbers as Mitsuba's, and its errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import ArgumentError
from tests.kit.same_calls import same

U = [0.0, 0.05, 0.3, 0.5, 0.77, 1.0]
X = [-0.5, 0.0, 0.4, 1.1, 1.99, 2.0, 3.0]
WEIGHTS = [0.0, 1.0, 0.0, 3.0, 2.0, 0.0]
PDF = [0.0, 1.0, 4.0, 0.5]
NODES = [0.0, 0.3, 1.5, 2.0]

DISCRETE: list[Callable[[Any], Any]] = [
    lambda d: [d.sum(), d.normalization(), d.pmf, d.cdf, len(d), d.size(), d.empty()],
    lambda d: [d.eval_pmf([1, 3, 5]), d.eval_pmf_normalized([1, 3, 5])],
    lambda d: [d.eval_cdf([1, 3, 5]), d.eval_cdf_normalized([1, 3, 5])],
    lambda d: [d.sample([*U, -1, 2]), d.sample_pmf([*U, -1, 2])],
    lambda d: [d.sample_reuse(U), d.sample_reuse_pmf(U)],
]

CONTINUOUS: list[Callable[[Any], Any]] = [
    lambda d: [d.integral(), d.normalization(), d.pdf, d.cdf, len(d), d.size(), d.empty(), d.max()],
    lambda d: [list(d.range), d.interval_resolution()],
    lambda d: [d.eval_pdf(X, True), d.eval_pdf_normalized(X, True)],
    lambda d: [d.eval_cdf(X), d.eval_cdf_normalized(X)],
    lambda d: [d.sample(U), d.sample_pdf(U)],
]

MADE: list[tuple[Callable[[Any], Any], list[Callable[[Any], Any]]]] = [
    (lambda m: m.DiscreteDistribution(WEIGHTS), DISCRETE),
    (lambda m: m.DiscreteDistribution(m.DiscreteDistribution([1, 2, 3, 4, 5, 6])), DISCRETE),
    (lambda m: m.ContinuousDistribution([0, 2], PDF), CONTINUOUS),
    (lambda m: m.ContinuousDistribution(range=[-1, 2.5], pdf=[1, 1, 1]), CONTINUOUS),
    (lambda m: m.ContinuousDistribution(m.ContinuousDistribution([0, 2], PDF)), CONTINUOUS),
    (lambda m: m.IrregularContinuousDistribution(NODES, PDF), CONTINUOUS),
    (lambda m: m.IrregularContinuousDistribution(nodes=NODES, pdf=[1, 2, 2, 1]), CONTINUOUS),
]


@pytest.mark.parametrize(("make", "queries"), MADE)
def test_one_number(make: Callable[[Any], Any], queries: list[Callable[[Any], Any]], mi: Any) -> None:
    ours, theirs = make(djpt), make(mi)
    for query in queries:
        same(lambda m, query=query: query(ours if m is djpt else theirs), mi, rtol=2e-5, atol=1e-5)
    assert repr(ours).split("[")[0] == repr(theirs).split("[")[0]


def test_edits_count_after_an_update(mi: Any) -> None:
    def edited(m: Any) -> Any:
        d = m.ContinuousDistribution([0, 2], PDF)
        d.pdf, d.range = [1, 2, 1], [1, 3]
        d.update()
        e = m.DiscreteDistribution()
        e.pmf = [1, 1, 2]
        e.update()
        return [d.sample(U), e.sample(U), d.integral(), e.sum()]

    same(edited, mi)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.DiscreteDistribution().update(), "empty distribution"),
        (lambda m: m.ContinuousDistribution([1, 2], [1]), "needs at least two entries"),
        (lambda m: m.ContinuousDistribution([2, 1], [1, 1]), "invalid range"),
        (lambda m: m.ContinuousDistribution([1, 2], [0, 0, 0]), "no probability mass found"),
        (lambda m: m.ContinuousDistribution([1, 2], [1, -1, 1]), "entries must be non-negative"),
        (lambda m: m.IrregularContinuousDistribution([1], [1]), "needs at least two entries"),
        (lambda m: m.IrregularContinuousDistribution([1, 2], [1]), "size mismatch"),
        (lambda m: m.IrregularContinuousDistribution([2, 1], [1, 1]), "strictly increasing"),
        (lambda m: m.IrregularContinuousDistribution([1, 2, 3], [0, 0, 0]), "no probability mass found"),
        (lambda m: m.IrregularContinuousDistribution([1, 2, 3], [1, -1, 1]), "entries must be non-negative"),
    ],
)
def test_errors_are_mitsubas(call: Callable[[Any], Any], message: str, mi: Any) -> None:
    for module in (mi, djpt):
        with pytest.raises(RuntimeError, match=message):
            call(module)


def test_tables_have_gradients() -> None:
    weights = djpt.Float([1, 3, 2])
    dr.enable_grad(weights)
    dr.backward(djpt.DiscreteDistribution(weights).eval_pmf_normalized([1]))
    np.testing.assert_allclose(weights.grad.numpy(), [-3 / 36, 1 / 6 - 3 / 36, -3 / 36], rtol=1e-5)


# ---------------------------------------------------------------- conditions

TABLE = np.random.default_rng(4).uniform(0, 2, (2, 3, 4)).astype(np.float32)
CONDITIONS = [[0.0, 0.4, 1.0], [0.5, 0.9, 2.0]]

CONDITIONAL: list[Callable[[Any, Any], Any]] = [
    lambda m, d: [d.max(), d.integral_array, d.cdf_array, list(d.pdf.shape), d.pdf.array, d.empty()],
    lambda m, d: [d.eval_pdf(m.Float(0.3), [m.Float(c) for c in CONDITIONS])],
    lambda m, d: [d.eval_pdf_normalized(m.Float(1.7), [m.Float(c) for c in CONDITIONS])],
    lambda m, d: [d.integral([m.Float(c) for c in CONDITIONS])],
    lambda m, d: d.sample_pdf(m.Float([0.1, 0.5, 0.9]), [m.Float(c) for c in CONDITIONS], True),
    lambda m, d: [d.eval_pdf(m.Float([-1, 3]), [m.Float(0.5), m.Float(1)])],
]


@pytest.mark.parametrize(
    "make",
    [
        lambda m: m.ConditionalIrregular1D(
            m.Float(NODES), m.Float(TABLE.ravel()), [m.Float([0, 1]), m.Float([0.4, 1, 2.5])]
        ),
        lambda m: m.ConditionalIrregular1D(
            m.Float(NODES), m.TensorXf(TABLE), [m.Float([0, 1]), m.Float([0.4, 1, 2.5])]
        ),
        lambda m: m.ConditionalRegular1D(m.Float(TABLE.ravel()), [0, 2], [[0, 1], [0.4, 2.5]], [2, 3]),
        lambda m: m.ConditionalRegular1D(m.TensorXf(TABLE), [0, 2], [[0, 1], [0.4, 2.5]]),
    ],
)
def test_one_number_under_conditions(make: Callable[[Any], Any], mi: Any) -> None:
    ours, theirs = make(djpt), make(mi)
    theirs.update()
    for query in CONDITIONAL:
        same(lambda m, query=query: query(m, ours if m is djpt else theirs), mi, rtol=5e-5, atol=1e-5)


def test_conditions_without_a_table() -> None:
    assert djpt.ConditionalIrregular1D().empty() and djpt.ConditionalRegular1D().empty()
    with pytest.raises(ArgumentError, match="2 conditions are needed, found 1"):
        djpt.ConditionalRegular1D(djpt.TensorXf(TABLE), [0, 2], [[0, 1], [0.4, 2.5]]).integral([0.5])
    with pytest.raises(ArgumentError, match=r"must have the shape \(2, 4\)"):
        djpt.ConditionalIrregular1D(NODES, djpt.TensorXf(TABLE), [[0, 1]]).update()


# ---------------------------------------------------------------- two numbers

GRIDS = ("Hierarchical2D", "MarginalDiscrete2D", "MarginalContinuous2D")
POINTS = [[0.0, 0.2, 0.55, 0.9, 1.0], [0.0, 0.7, 0.45, 0.1, 1.0]]


def grid(dimension: int) -> tuple[np.ndarray, list[list[float]], list[list[float]]]:
    """Numbers, the values of the parameters that they are for, and parameters of some queries."""
    shape = (*(3, 2, 4)[:dimension], 4, 6)
    values = np.random.default_rng(dimension).uniform(0.1, 3, shape).astype(np.float32)
    at = [[0.0, 0.5, 2.0], [1.0, 3.0], [0.0, 0.1, 0.2, 0.7]][:dimension]
    asked = [[-1.0, 0.2, 0.5, 1.3, 3.0], [2.0, 1.0, 3.0, 1.5, 0.0], [0.0, 0.15, 0.7, 0.3, 0.05]][:dimension]
    return values, at, asked


@pytest.mark.sparse(9)
@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("dimension", range(4))
@pytest.mark.parametrize("name", GRIDS)
def test_points_of_the_square(name: str, dimension: int, normalize: bool, mi: Any) -> None:
    values, at, asked = grid(dimension)

    def queries(m: Any) -> Any:
        distribution = getattr(m, f"{name}{dimension}")(values, at, normalize)
        point, density = distribution.sample(POINTS, asked)
        # Mitsuba's quadtree is inverted wrongly, to numbers that aren't any, in its variants with Dr.Jit.
        inverse = [] if name == "Hierarchical2D" else distribution.invert(POINTS, asked)
        return [point, density, inverse, distribution.eval(POINTS, asked)]

    same(queries, mi, rtol=3e-4, atol=1e-4)


@pytest.mark.parametrize("name", GRIDS)
def test_inverses_lead_back(name: str) -> None:
    values, at, asked = grid(1)
    distribution = getattr(djpt, f"{name}1")(values, at)
    samples = djpt.Point2f([0.1, 0.4, 0.6, 0.8, 0.95], [0.5, 0.2, 0.9, 0.7, 0.3])
    point, density = distribution.sample(samples, asked)
    back, again = distribution.invert(point, asked)
    np.testing.assert_allclose(np.array(back), np.array(samples), atol=2e-4)
    np.testing.assert_allclose(again.numpy(), density.numpy(), rtol=1e-3)
    np.testing.assert_allclose(distribution.eval(point, asked).numpy(), density.numpy(), rtol=1e-3)


def test_cells_of_a_grid(mi: Any) -> None:
    weights = np.array([[1, 2, 3], [0, 1, 3]], np.float32)

    def queries(m: Any) -> Any:
        distribution = m.DiscreteDistribution2D(weights)
        cells = [[0, 1, 2, 2], [0, 0, 1, 0]]
        sampled = distribution.sample([[0.0, 0.3, 0.9, 0.1, 1.0], [0.0, 0.7, 0.45, 0.9, 1.0]])
        return [sampled, distribution.eval(cells), distribution.pdf(cells)]

    same(queries, mi)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: djpt.Hierarchical2D0(np.ones((1, 4))), "at least two entries; found the shape"),
        (lambda: djpt.Hierarchical2D1(np.ones((2, 3, 4)), [[0, 1, 2]]), r"has \(3,\) entries, 'data' \(2,\)"),
        (lambda: djpt.MarginalDiscrete2D0(np.zeros((3, 4))), "positive integral"),
        (
            lambda: djpt.MarginalDiscrete2D1(np.ones((2, 3, 4)), [[0, 1]], build_hierarchy=False).sample(
                [0.1, 0.2], [0]
            ),
            "enable_sampling=False",
        ),
        (lambda: djpt.DiscreteDistribution2D([1, 2, 3]), "must have two axes, found 1"),
    ],
)
def test_what_is_refused(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        call()

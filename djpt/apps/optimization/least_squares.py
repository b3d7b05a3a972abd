"""`least_squares`: damped Gauss-Newton steps for variables that brighten some pixels and darken others.

Places, turns, normals and roughness change pixels in both directions, so that a diagonal (see `GaussNewton`) knows
little of their curvature. Here a step s solves

    (J^T J + l diag(J^T J)) s = -J^T r

for the residuals r and their derivatives J, with a damping l that falls after steps that lower the loss and rises after
those that don't, which are taken back (Levenberg 1944, Marquardt 1963). Few variables have all columns of J computed,
one forward derivative each. Many have J^T J v by one forward and one reverse derivative per product, and conjugate
gradients that stop early (Steihaug 1983).

Noise: r and J come from different samples, so that J^T r has the right mean, and its zero is where the search ends.
The product of one estimate of J with itself is too large by its variance, which makes steps too short, tenfold where
silhouettes move. So columns are computed twice, and J^T J is the product of two independent estimates. Conjugate
gradients need one matrix without negative eigenvalues, and use one estimate: their steps are shorter, their minimum is
the same. Steps are judged by two images with the same random numbers, whose noise mostly cancels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.errors import RenderError
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.settings import check_count, check_seed

__all__ = ["LeastSquares", "least_squares"]

Doubles = npt.NDArray[np.float64]
Residual = Callable[[Mapping[str, Any], int], Any]
"""A function of variables by name and a seed that returns an array attached to the variables."""

DENSE = 16
"""The number of entries, of all variables together, up to which all columns of J are computed."""

PRODUCTS = 8
"""The most products of a step by conjugate gradients."""

REDUCED = 0.1
"""The residual of conjugate gradients, relative to the first, at which a step is good enough."""

TRIES = 5
"""The number of dampings that are tried from one place."""

FALLS, RISES = 0.2, 5.0
"""The factors of the damping after a step that is kept, and after one that is taken back."""

LEAST, MOST = 1e-6, 1e8
"""The ends of the damping's range."""

ALONE = 1e-3
"""The share of the largest curvature that is added for damping: entries without any effect don't move."""


@dataclass(frozen=True)
class LeastSquares:
    """The result of `least_squares`.

    * `values`: the variables by name; `average`: their means over the last quarter of the iterations, which have less
      noise, as NumPy arrays.
    * `losses`: the mean of the squared residuals before each step.
    * `damping`: the last one; `taken_back`: the number of steps that were.
    """

    values: dict[str, Any]
    average: dict[str, Doubles]
    losses: list[float]
    damping: float
    taken_back: int


def least_squares(
    residual: Residual,
    start: Mapping[str, Any],
    *,
    iterations: int = 20,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    coarse: int = 0,
    damping: float = 1e-2,
    seed: int = 0,
    callback: Callable[[int, float, Mapping[str, Any]], bool | None] | None = None,
) -> LeastSquares:
    """Minimise a mean of squares of noisy residuals, by steps that are tested and taken back.

    For instance the place of a ball, from a picture::

        def residual(variables, seed):
            params["ball.to_world"] = djpt.Transform4f().translate(variables["place"])
            params.update()
            return djpt.render(scene, params, spp=16, seed=seed) - target

        found = least_squares(residual, {"place": djpt.Point3f(0.2, 0, 0)})

    Args:
        residual: Called with the variables and a seed: the same seed must give the same residuals.
        start: Where the search begins: Dr.Jit arrays or tensors by name.
        iterations: The number of steps; each takes two or more images, and two derivatives for each entry of up to
            16 entries together, or else up to 18 in all.
        bounds: (low, high) by name; values are moved back within them.
        coarse: The number of times that residuals, which must be images (H, W, C) then, are halved in size at first;
            once less after equal parts of the iterations. An edge moves by about a pixel in a step, so for what is far
            from its place choose pixels as large as the way.
        damping: The first one.
        seed: Of all residuals.
        callback: Called with the iteration, the loss before its step, and the variables after it; returning True ends
            the search.

    Raises:
        RenderError: The residuals don't depend on the variables, or aren't finite at the start.
    """
    iterations, seed = check_count("iterations", iterations), check_seed("seed", seed)
    problem = Problem(residual, start, bounds or {})
    x, losses, taken_back = problem.start, list[float](), 0
    sums, counted = np.zeros_like(x), 0
    for i in range(iterations):
        problem.halvings = max(0, coarse - i * (coarse + 1) // iterations)
        number = round_seed(seed, i)
        now = problem.residuals(x, number)
        loss = float(np.mean(np.square(now)))
        if not np.isfinite(loss) and i == 0:
            raise RenderError("least_squares: the residuals aren't finite at the start; djpt.find_nan says why")
        losses.append(loss)
        system = problem.system(x, now, number)
        for _ in range(TRIES):
            moved = problem.within(x + system.step(damping))
            after = float(np.mean(np.square(problem.residuals(moved, number))))
            if after < loss:
                x, damping = moved, max(damping * FALLS, LEAST)
                break
            damping, taken_back = min(damping * RISES, MOST), taken_back + 1
        if i >= iterations - max(1, iterations // 4):
            sums, counted = sums + x, counted + 1
        if callback is not None and callback(i, loss, problem.variables(x)):
            break
    mean = sums / counted if counted else x
    average = {name: np.array(value, np.float64) for name, value in problem.variables(mean).items()}
    return LeastSquares(problem.variables(x), average, losses, damping, taken_back)


def halved(image: Any) -> Any:
    """An image (H, W, C) of half the size, of means over 2 x 2 pixels; a last odd row or column is left out."""
    even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2, :]
    rows = even[0::2, :, :] + even[1::2, :, :]
    return (rows[:, 0::2, :] + rows[:, 1::2, :]) / 4


class Problem:
    """Residuals and their derivatives as functions of one vector of all entries."""

    def __init__(self, residual: Residual, start: Mapping[str, Any], bounds: Mapping[str, tuple[float, float]]) -> None:
        self._function = residual
        self.halvings = 0
        """The number of times that residuals are halved in size."""
        self._types = {name: type(dr.detach(value)) for name, value in start.items()}
        arrays = {name: np.array(dr.detach(value), np.float64) for name, value in start.items()}
        self._shapes = {name: array.shape for name, array in arrays.items()}
        self.start = np.concatenate([array.ravel() for array in arrays.values()])
        limits = {name: bounds.get(name, (-np.inf, np.inf)) for name in arrays}
        self._low, self._high = (
            np.concatenate([np.full(arrays[name].size, limits[name][end]) for name in arrays]) for end in (0, 1)
        )

    def within(self, x: Doubles) -> Doubles:
        """A vector moved back within the bounds."""
        return np.asarray(np.clip(x, self._low, self._high))

    def variables(self, x: Doubles) -> dict[str, Any]:
        """The variables that a vector holds."""
        found, first = {}, 0
        for name, shape in self._shapes.items():
            size = int(np.prod(shape))
            found[name] = self._typed(name, x[first : first + size].reshape(shape))
            first += size
        return found

    def _residual(self, variables: Mapping[str, Any], seed: int) -> Any:
        found = self._function(variables, seed)
        for _ in range(self.halvings):
            found = halved(found)
        return found

    def _typed(self, name: str, array: Doubles) -> Any:
        return self._types[name](np.ascontiguousarray(array, np.float32))

    def residuals(self, x: Doubles, seed: int) -> Doubles:
        """The residuals at a vector."""
        return np.array(dr.detach(self._residual(self.variables(x), seed)), np.float64).ravel()

    def forward(self, x: Doubles, direction: Doubles, seed: int) -> Doubles:
        """J v: the derivative of the residuals in a direction."""
        variables, tangents = self.variables(x), self.variables(direction)
        for name, value in variables.items():
            dr.enable_grad(value)
            dr.set_grad(value, tangents[name])
        residuals = self._residual(variables, seed)
        if not dr.grad_enabled(residuals):
            raise RenderError("least_squares: the residuals don't depend on the variables")
        dr.enqueue(dr.ADMode.Forward, *variables.values())
        dr.traverse(dr.ADMode.Forward)
        return np.array(dr.grad(residuals), np.float64).ravel()

    def reverse(self, x: Doubles, weights: Doubles, seed: int) -> Doubles:
        """J^T w: the gradient of the weighted sum of the residuals."""
        variables = self.variables(x)
        for value in variables.values():
            dr.enable_grad(value)
        residuals = self._residual(variables, seed)
        shape = np.shape(np.array(dr.detach(residuals)))
        kind = type(dr.detach(residuals))
        dr.backward(dr.sum(residuals * kind(weights.reshape(shape).astype(np.float32)), axis=None))
        return np.concatenate([np.array(dr.grad(value), np.float64).ravel() for value in variables.values()])

    def system(self, x: Doubles, now: Doubles, seed: int) -> Dense | MatrixFree:
        """The equations of a step from a vector with the residuals `now`."""
        if x.size > DENSE:
            return MatrixFree(self, x, now, seed)
        first, second = self._columns(x, seed), self._columns(x, round_seed(seed, 1))
        product = first.T @ second
        return Dense.of((product + product.T) / 2, (first + second).T @ now / 2)

    def _columns(self, x: Doubles, seed: int) -> Doubles:
        """J, one column for each entry."""
        return np.stack([self.forward(x, direction, seed) for direction in np.eye(x.size)], axis=1)


@dataclass(frozen=True)
class Dense:
    """J^T J and J^T r in full."""

    normal: Doubles
    slope: Doubles

    @classmethod
    def of(cls, normal: Doubles, slope: Doubles) -> Dense:
        """The equations of an estimate of J^T J, whose negative eigenvalues are noise."""
        values, vectors = np.linalg.eigh(normal)
        return cls((vectors * np.maximum(values, 0)) @ vectors.T, slope)

    def step(self, damping: float) -> Doubles:
        """The step at a damping."""
        diagonal = np.diag(self.normal)
        floor = ALONE * max(float(diagonal.max(initial=0)), 1e-30)
        return np.asarray(-np.linalg.solve(self.normal + damping * np.diag(diagonal + floor), self.slope))


class MatrixFree:
    """J^T J as products. The damping is relative to the mean of its diagonal, which random signs estimate."""

    def __init__(self, problem: Problem, x: Doubles, now: Doubles, seed: int) -> None:
        self._problem, self._x, self._seed = problem, x, seed
        self._slope = problem.reverse(x, now, seed)
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], x.size)
        ahead = problem.forward(x, signs, seed)
        # Hutchinson 1990: the mean of v^T H v over random signs is the trace.
        self._mean = float(ahead @ ahead) / x.size

    def _product(self, v: Doubles) -> Doubles:
        return self._problem.reverse(self._x, self._problem.forward(self._x, v, self._seed), self._seed)

    def step(self, damping: float) -> Doubles:
        """The step at a damping, by conjugate gradients that end after few products."""
        s, left = np.zeros_like(self._slope), -self._slope
        way, norm = left.copy(), float(left @ left)
        first = norm
        for _ in range(PRODUCTS):
            if norm <= REDUCED**2 * first or norm == 0:
                break
            bent = self._product(way) + damping * self._mean * way
            curvature = float(way @ bent)
            if curvature <= 0:
                break
            size = norm / curvature
            s, left = s + size * way, left - size * bent
            before, norm = norm, float(left @ left)
            way = left + norm / before * way
        return s

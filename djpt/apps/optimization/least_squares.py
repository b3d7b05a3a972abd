"""`least_squares`: damped Gauss-Newton steps for variables that brighten some pixels and darken others.

Places, turns, normals and roughness change pixels in both directions, so that a diagonal (see `GaussNewton`) knows
little of their curvature. Here a step s solves

    (J^T J + l D) s = -J^T r

for the residuals r and their derivatives J, with D = diag(J^T J) and a damping l that falls after steps that lower the
loss and rises after those that don't, which are taken back (Levenberg 1944, Marquardt 1963).

* Few variables have all columns of J computed: one forward derivative each, or the difference of two images with the
  same random numbers. A difference over the width of a pixel is the derivative of a blurred picture, edges and shadows
  included, costs two images without any derivative, and knows the way from farther away (Fischer and Ritschel 2023).
* Many have J^T J v by one forward and one reverse derivative per product. Lanczos' basis of few products serves all
  dampings, since D scales the variables to equal curvature, after which damping is a shift.

Noise: r and J come from different samples, so that J^T r has the right mean, and its zero is where the search ends.
The product of one estimate of J with itself is too large by its variance, which makes steps too short, tenfold where
silhouettes move. So columns of derivatives are computed twice, and J^T J is the product of two independent estimates.
Lanczos needs one matrix without negative eigenvalues, and uses one estimate: steps are shorter, their minimum is the
same. Steps are judged by two images with the same random numbers, whose noise mostly cancels. Where the loss hardly
falls any more, noise is larger than what is left to gain, and from then on twice as many images are averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.errors import RenderError, near_miss
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.settings import check_count, check_seed

__all__ = ["LeastSquares", "least_squares"]

Doubles = npt.NDArray[np.float64]
Residual = Callable[[Mapping[str, Any], int], Any]
"""A function of variables by name and a seed that returns an array attached to the variables."""

DENSE = 16
"""The number of entries, of all variables together, up to which all columns of J are computed."""

PRODUCTS = 8
"""The most products of a step by Lanczos' basis."""

TRIES = 5
"""The number of dampings that are tried from one place."""

FALLS, RISES = 0.2, 5.0
"""The factors of the damping after a step that is kept, and after one that is taken back."""

LEAST, MOST = 1e-6, 1e8
"""The ends of the damping's range."""

ALONE = 1e-3
"""The share of the largest curvature that is added for damping: entries without any effect don't move."""


SMALL = 1e-3
"""The length of a Lanczos vector, relative to the slope's, below which the space holds all that matters."""

FELL = 0.9
"""The ratio of a loss to the one before above which twice as many images are averaged: their noise hides what falls."""

DOUBLINGS = 2
"""The most times that the number of averaged images is doubled."""


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
    differences: Mapping[str, float] | None = None,
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

        found = least_squares(residual, {"place": djpt.Point3f(0.2, 0, 0)}, differences={"place": 0.1}, coarse=3)

    Args:
        residual: Called with the variables and a seed: the same seed must give the same residuals.
        start: Where the search begins: Dr.Jit arrays or tensors by name.
        iterations: The number of steps; each takes two or more images, and of up to 16 entries together two
            derivatives of each, or else up to 18 in all.
        bounds: (low, high) by name; values are moved back within them.
        differences: By name the distance over which images are compared in place of a derivative, for instance the
            width of a pixel of the first, coarse images; it is halved as these are refined. For what moves.
        coarse: The number of times that residuals, which must be images (H, W, C) then, are halved in size at first;
            once less after equal parts of the iterations. An edge moves by about a pixel in a step, so for what is far
            from its place choose pixels as large as the way.
        damping: The first one.
        seed: Of all residuals.
        callback: Called with the iteration, the loss before its step, and the variables after it; returning True ends
            the search.

    Raises:
        RenderError: The residuals don't depend on the variables, or aren't finite at the start, or an option is given
            for something else.
    """
    iterations, seed = check_count("iterations", iterations), check_seed("seed", seed)
    for option, by_name in (("bounds", bounds), ("differences", differences)):
        for name in by_name or {}:
            if name not in start:
                found = near_miss(name, start)
                raise RenderError(f"least_squares: '{option}' is given for '{name}', not one of the variables{found}")
    problem = Problem(residual, start, bounds or {}, differences or {})
    x, losses, taken_back, first = problem.start, list[float](), 0, damping
    sums, counted = np.zeros_like(x), 0
    for i in range(iterations):
        halvings = max(0, coarse - i * (coarse + 1) // iterations)
        if halvings != problem.halvings:
            problem.halvings, damping = halvings, min(damping, first)
            problem.refined = coarse - halvings
        number = round_seed(seed, i)
        now = problem.residuals(x, number)
        loss = float(np.mean(np.square(now)))
        if not np.isfinite(loss) and i == 0:
            raise RenderError("least_squares: the residuals aren't finite at the start; djpt.find_nan says why")
        if losses and loss > FELL * losses[-1]:
            problem.images = min(2 * problem.images, 2**DOUBLINGS)
        losses.append(loss)
        system = problem.system(x, now, number)
        for _ in range(TRIES):
            moved = problem.within(x + system.step(damping))
            after = float(np.mean(np.square(problem.residuals(moved, number))))
            if after < loss:
                x, damping = moved, max(damping * FALLS, LEAST)
                break
            damping, taken_back = min(damping * RISES, MOST), taken_back + 1
        else:
            damping = first
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

    def __init__(
        self,
        residual: Residual,
        start: Mapping[str, Any],
        bounds: Mapping[str, tuple[float, float]],
        differences: Mapping[str, float],
    ) -> None:
        self._function = residual
        self.halvings = 0
        """The number of times that residuals are halved in size."""
        self.refined = 0
        """The number of times that they are halved less often than at first."""
        self.images = 1
        """The number of images that are averaged."""
        self._types = {name: type(dr.detach(value)) for name, value in start.items()}
        arrays = {name: np.array(dr.detach(value), np.float64) for name, value in start.items()}
        self._shapes = {name: array.shape for name, array in arrays.items()}
        self.start = np.concatenate([array.ravel() for array in arrays.values()])
        limits = {name: bounds.get(name, (-np.inf, np.inf)) for name in arrays}
        self._low, self._high = (self._spread({name: limit[end] for name, limit in limits.items()}) for end in (0, 1))
        self._distances = self._spread({name: differences.get(name, 0.0) for name in arrays})
        self.squares, self.estimates = np.zeros_like(self.start), 0
        """The sum of estimates of diag(J^T J), and their number."""

    def _spread(self, numbers: Mapping[str, float]) -> Doubles:
        """The vector whose entries are these numbers, of the variables that they belong to."""
        return np.concatenate([np.full(int(np.prod(shape)), numbers[name]) for name, shape in self._shapes.items()])

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

    def seeds(self, seed: int) -> list[int]:
        """The seeds of the images that are averaged."""
        return [seed, *(round_seed(seed, 16 + k) for k in range(1, self.images))]

    def residuals(self, x: Doubles, seed: int) -> Doubles:
        """The residuals at a vector: means over as many images as are averaged."""
        found = [dr.detach(self._residual(self.variables(x), each)) for each in self.seeds(seed)]
        return np.asarray(sum(np.array(one, np.float64) for one in found)).ravel() / len(found)

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

    def difference(self, x: Doubles, entry: int, seed: int) -> Doubles:
        """A column of J: the difference of residuals on both sides of an entry's value, within its bounds."""
        ends = np.stack([x, x])
        ends[:, entry] += self._distances[entry] * 0.5**self.refined * np.array([-1, 1])
        low, high = self.within(ends)
        change = self.residuals(high, seed) - self.residuals(low, seed)
        return change / (high[entry] - low[entry])

    def system(self, x: Doubles, now: Doubles, seed: int) -> Dense | MatrixFree:
        """The equations of a step from a vector with the residuals `now`."""
        if x.size > DENSE:
            return MatrixFree(self, x, now, round_seed(seed, 1))
        first = self._columns(x, round_seed(seed, 1), range(x.size))
        # Differences have little noise: one estimate is enough.
        second = first.copy()
        derived = np.flatnonzero(self._distances == 0)
        if derived.size:
            second[:, derived] = self._columns(x, round_seed(seed, 2), derived)
        product = first.T @ second
        return Dense.of((product + product.T) / 2, (first + second).T @ now / 2)

    def _columns(self, x: Doubles, seed: int, entries: Iterable[int]) -> Doubles:
        """Columns of J, one for each of these entries."""
        columns = [
            self.difference(x, k, seed) if self._distances[k] else self.forward(x, np.eye(x.size)[k], seed)
            for k in entries
        ]
        return np.stack(columns, axis=1)


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
    """J^T J as products, in the space that Lanczos' vectors q span, begun with the slope, where it is tridiagonal.

    Variables are divided by the roots of diag(J^T J). It is the mean of (J^T v)^2 over random signs v of the residuals,
    of which each step adds one estimate; since few are noisy, their mean is added.
    """

    def __init__(self, problem: Problem, x: Doubles, now: Doubles, seed: int) -> None:
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], now.size)
        problem.squares += np.square(problem.reverse(x, signs, seed))
        problem.estimates += 1
        squares = problem.squares / problem.estimates
        self._scale = 1 / np.sqrt(np.maximum(squares + squares.mean(), 1e-30))
        slope = -self._scale * problem.reverse(x, now, seed)
        self._norm = float(np.linalg.norm(slope))
        basis, products = list[Doubles](), list[Doubles]()
        left = slope
        for _ in range(min(PRODUCTS, x.size)):
            length = float(np.linalg.norm(left))
            if length <= SMALL * max(self._norm, 1e-30):
                break
            basis.append(left / length)
            bent = self._scale * problem.reverse(x, problem.forward(x, self._scale * basis[-1], seed), seed)
            products.append(bent)
            # Twice, since a single pass leaves the rounding of single precision.
            q = np.stack(basis)
            left = bent - q.T @ (q @ bent)
            left = left - q.T @ (q @ left)
        self._basis = np.stack(basis) if basis else np.zeros((0, x.size))
        small = self._basis @ np.stack(products).T if basis else np.zeros((0, 0))
        self._small = (small + small.T) / 2

    def step(self, damping: float) -> Doubles:
        """The step at a damping."""
        count = len(self._basis)
        first = self._norm * np.eye(count)[:, 0] if count else np.zeros(0)
        inner = np.linalg.solve(self._small + damping * np.eye(count), first)
        return np.asarray(self._scale * (inner @ self._basis))

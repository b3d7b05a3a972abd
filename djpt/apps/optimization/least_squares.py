"""`least_squares`: damped Gauss-Newton steps for variables that brighten some pixels and darken others.

Places, turns, normals and roughness change pixels in both directions, so that a diagonal (see `GaussNewton`) knows
little of their curvature. Here a step s solves

    (J^T J + l D) s = -J^T r

for the residuals r and their derivatives J, with D = diag(J^T J) and a damping l that falls after steps that lower the
loss and rises after those that don't, which are taken back (Levenberg 1944, Marquardt 1963).

* Few variables have all columns of J computed: one forward derivative each, or the difference of two images with the
  same random numbers. A difference over the width of a pixel is the derivative of a blurred picture, edges and shadows
  included, costs two images without any derivative, and knows the way from farther away (Fischer and Ritschel 2023).
  After a step that went as expected they are corrected by what it has changed (Broyden, "A Class of Methods for Solving
  Nonlinear Simultaneous Equations", Mathematics of Computation 19, 1965), which costs no image.
* Many have J^T J v by one forward and one reverse derivative per product. A basis of few products serves all
  dampings, since D scales the variables to equal curvature, after which damping is a shift. It ends where one more
  product would hardly lower the loss further, after two or three far from the minimum; those of the last steps are
  used again, since J^T J changes little.

Noise: r and J come from different samples, so that J^T r has the right mean, and its zero is where the search ends.
The product of one estimate of J with itself is too large by its variance, which makes steps too short, tenfold where
silhouettes move. So J^T J is the product of two independent estimates of the columns: that of the step, and that of the
step before, since J changes little. The first step has one, and is shorter for it. Where tables of J are averaged over
the steps, see below, the product of the mean with itself serves: its bias falls with the number of steps.
Matrix-free it is that of one, so steps are shorter where derivatives are noisy, and their minimum is the same. That is
of use there: what the noise adds to J^T J keeps combinations in place which pictures hardly show.
Steps are judged by images with the same random numbers, whose noise mostly cancels: by half of those that are averaged.
Where the loss hardly falls any more, noise is larger than what is left to gain, and from then on twice as many images
are averaged. When there are as many as may be, steps become shorter, in the end like 1 / i, which averages over steps.

Products with J need no paths: it is tabulated once a step (`djpt.rendering.gradients.jacobian`), or, where images have
a graph, that graph is traversed again and again. Tables are averaged over the steps, and r as well: the prediction of
the steps before, r + J (x - x_before), has noise of its own, and is averaged with the new residuals; the more it is
off, since J has changed, the less it counts (after Nicolet et al., "Recursive Control Variates for Inverse Rendering",
ACM Transactions on Graphics 42, 2023, who do so with images).

Of small images most time goes into tracing. With `frozen`, `dr.freeze` does that once for each of five functions: the
residuals, J, and products with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.apps.optimization.passes import Linear, Passes, Residual
from djpt.errors import RenderError, near_miss
from djpt.jit.kernels import mapped, own_array, own_floats
from djpt.rendering.known_images import Images
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.settings import check_count, check_seed

__all__ = ["LeastSquares", "least_squares"]

Doubles = npt.NDArray[np.float64]

DENSE = 12
"""The number of entries, of all variables together, up to which all columns of J are computed."""

PRODUCTS = 8
"""The most products of a step."""

ENOUGH, ENOUGH_TABULATED = 0.1, 0.03
"""The share of what a step gains below which the last product hasn't changed it; the second with a table for J."""

KEPT = 24
"""The number of products that are kept for later steps."""

APART = 0.3
"""The length of a kept vector without its part in the space, relative to the whole, below which it is left out."""

ESTIMATES = 4
"""The number of estimates of diag(J^T J), from as many steps."""

TRIES = 5
"""The number of dampings that are tried from one place."""

FALLS, RISES = 0.2, 5.0
"""The factors of the damping after a step that is kept, and after one that is taken back."""

LEAST, MOST = 1e-6, 1e8
"""The ends of the damping's range."""

PATIENCE = 4
"""The number of iterations without a lower loss after which steps are half as long: their noise averages out."""

ALONE = 1e-3
"""The share of the largest curvature that is added for damping: entries without any effect don't move."""

FELL_MUCH = 0.5
"""The ratio of a loss to that before a step below which the differences of that step serve for the next one."""

LEAST_WEIGHT = 0.1
"""The least weight of a step in the means over steps, of its J and of its residuals."""

SMALL = 1e-3
"""The length of a vector of the basis, relative to the slope's, below which the space holds all that matters."""

FELL = 0.9
"""The ratio of a loss to the one before above which twice as many images are averaged: their noise hides what falls."""


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
    images: int = 4,
    frozen: bool = False,
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
        iterations: The number of steps; each takes two or more images, and of up to 12 entries together one
            derivative of each, or else a table of derivatives, or up to 18 if they are too large.
        bounds: (low, high) by name; values are moved back within them.
        differences: By name the distance over which images are compared in place of a derivative, for instance the
            width of a pixel of the first, coarse images; it is halved as these are refined. For what moves.
        coarse: The number of times that residuals, which must be images (H, W, C) then, are halved in size at first;
            once less after equal parts of the iterations. An edge moves by about a pixel in a step, so for what is far
            from its place choose pixels as large as the way.
        images: The most images that are averaged for one of less noise. A search from afar is fastest with few samples
            per pixel at first, and many images in the end.
        frozen: Whether `dr.freeze` traces images and derivatives once and repeats their kernels, which takes a third
            of the time or less for small images. `residual` then gets the seed as an array, must not read arrays on
            the host, edit shapes or cameras, and finds scenes and other arrays as variables of the code around it.
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
    problem = Problem(Passes(residual, frozen), start, bounds or {}, differences or {})
    x, losses, taken_back, first = problem.start, list[float](), 0, damping
    sums, counted, stalled = np.zeros_like(x), 0, 0
    last: tuple[Doubles, int] | None = None
    for i in range(iterations):
        halvings = max(0, coarse - i * (coarse + 1) // iterations)
        if halvings != problem.halvings:
            problem.halvings, damping = halvings, min(damping, first)
            problem.products.clear()
            problem.columns = problem.means_before = problem.differences = None
            problem.refined = coarse - halvings
        number = round_seed(seed, i)
        now = problem.residuals(x, number)
        loss = float(np.mean(np.square(now)))
        if not np.isfinite(loss) and i == 0:
            raise RenderError("least_squares: the residuals aren't finite at the start; djpt.find_nan says why")
        if last is not None and i and len(last[0]) == len(now):
            problem.noise = float(np.mean(np.square(now - last[0]))) / (1 / problem.images + 1 / last[1])
        last = None
        if losses and loss > FELL * losses[-1]:
            stalled += problem.images >= images
            problem.images = min(2 * problem.images, max(1, images))
        losses.append(loss)
        # The same random numbers: half of the images are enough to judge steps by.
        judging, begun = problem.judged
        before = float(np.mean(np.square(begun)))
        system = problem.system(x, now, number, damping)
        for _ in range(TRIES):
            moved = problem.within(x + system.step(damping) / (1 + stalled / PATIENCE))
            there = problem.residuals(moved, number, judging)
            after = float(np.mean(np.square(there)))
            if after < before:
                last = there, judging
                problem.follow(moved - x, there - begun, after / before)
                x, damping = moved, max(damping * FALLS, LEAST)
                break
            damping, taken_back = min(damping * RISES, MOST), taken_back + 1
        else:
            # Kept products may belong to a place too far away.
            damping = first
            problem.products.clear()
        if i >= iterations - max(1, iterations // 4):
            sums, counted = sums + x, counted + 1
        if callback is not None and callback(i, loss, problem.variables(x)):
            break
    mean = sums / counted if counted else x
    average = {name: np.array(value, np.float64) for name, value in problem.variables(mean).items()}
    return LeastSquares(problem.variables(x), average, losses, damping, taken_back)


@dataclass
class Means:
    """Means over the steps of a search."""

    linear: Linear
    """With the mean of J."""
    residuals: Doubles
    """The mean of r at `x`."""
    x: Doubles
    """Where the last of these steps began."""
    steps: int
    """The number of steps."""


class Problem:
    """Residuals and their derivatives as functions of one vector of all entries."""

    def __init__(
        self,
        passes: Passes,
        start: Mapping[str, Any],
        bounds: Mapping[str, tuple[float, float]],
        differences: Mapping[str, float],
    ) -> None:
        self._passes = passes
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
        self._images: Images = {}
        """The images of the last residuals."""
        self._linear: Linear
        """The residuals about the place from which a step begins."""
        self.judged: tuple[int, Doubles] = 1, np.zeros(0)
        """The number of the images that steps are judged by, and the residuals by them where a step begins."""
        self.differences: Doubles | None = None
        """The columns of the last step if all are differences and its end was as they said, of this size of images."""
        self.means_before: Means | None = None
        """The means where the last step began."""
        self.noise = 0.0
        """The mean square of the noise of a residual from one image."""
        self.columns: Doubles | None = None
        """The derivatives of the last step by those entries that have some, of this size of images."""
        self.products: list[tuple[Doubles, Doubles]] = []
        """Vectors v and estimates of J^T J v, the latest last, of this size of images."""
        self.squares, self.estimates = np.zeros_like(self.start), 0
        """The sum of estimates of diag(J^T J), and their number."""

    def _spread(self, numbers: Mapping[str, float]) -> Doubles:
        """The vector whose entries are these numbers, of the variables that they belong to."""
        return np.concatenate([np.full(int(np.prod(shape)), numbers[name]) for name, shape in self._shapes.items()])

    def means(self, x: Doubles) -> Doubles:
        """The vector whose entries are the means of the variables that they belong to."""
        sizes = [int(np.prod(shape)) for shape in self._shapes.values()]
        return np.concatenate([np.full(len(part), part.mean()) for part in np.split(x, np.cumsum(sizes)[:-1])])

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

    def _typed(self, name: str, array: Doubles) -> Any:
        return in_own_memory(self._types[name], array)

    def seeds(self, seed: int) -> list[int]:
        """The seeds of the images that are averaged."""
        return [seed, *(round_seed(seed, 16 + k) for k in range(1, self.images))]

    def residuals(self, x: Doubles, seed: int, count: int = 0) -> Doubles:
        """The residuals at a vector: means over `count` images, or as many as are averaged.

        `judged` is then the first half of the images, their number and the loss of their mean.
        """
        total, seeds = np.zeros(()), self.seeds(seed)[: count or None]
        for k, each in enumerate(seeds):
            # New arrays each time: the scene keeps them, and to `dr.freeze` two inputs that are one array are news.
            found, self._images = self._passes.residuals(self.variables(x), each, self.halvings)
            total = total + np.array(found, np.float64)
            if k == (len(seeds) - 1) // 2:
                self.judged = k + 1, total.ravel() / (k + 1)
        self._shape, self._kind = found.shape, type(found)
        return total.ravel() / len(seeds)

    def forward(self, direction: Doubles) -> Doubles:
        """J v: the derivative of the residuals in a direction."""
        return np.array(self._linear.forward(self.variables(direction)), np.float64).ravel()

    def reverse(self, weights: Doubles) -> Doubles:
        """J^T w: the gradient of the weighted sum of the residuals."""
        return self._vector(self._linear.reverse(in_own_memory(self._kind, weights.reshape(self._shape))))

    def normal(self, direction: Doubles) -> Doubles:
        """J^T J v, of one estimate of J."""
        return self._vector(self._linear.normal(self.variables(direction)))

    def _vector(self, slopes: Mapping[str, Any]) -> Doubles:
        """The vector that holds variables."""
        return np.concatenate([np.array(slopes[name], np.float64).ravel() for name in self._types])

    def difference(self, x: Doubles, entry: int, seed: int) -> Doubles:
        """A column of J: the difference of residuals on both sides of an entry's value, within its bounds."""
        ends = np.stack([x, x])
        ends[:, entry] += self._distances[entry] * 0.5**self.refined * np.array([-1, 1])
        low, high = self.within(ends)
        change = self.residuals(high, seed) - self.residuals(low, seed)
        return change / (high[entry] - low[entry])

    def system(self, x: Doubles, now: Doubles, seed: int, damping: float) -> Dense | MatrixFree:
        """The equations of a step from a vector with the residuals `now`, the last ones that were computed."""
        if x.size > DENSE or not self._distances.all():
            self._linearise(x, seed)
        if not self._distances.any():
            now = self._averaged(x, now)
            if x.size > DENSE:
                return MatrixFree(self, x, now, seed, damping)
        known = self.differences
        first = self._columns(x, round_seed(seed, 1), range(x.size)) if known is None else known
        self.differences = first if self._distances.all() else None
        # Differences have little noise, and so have means over steps: one estimate is enough. Derivatives of the last
        # step are another estimate.
        second = first.copy()
        derived = np.flatnonzero(self._distances == 0)
        if derived.size and self.means_before is None:
            if self.columns is not None:
                second[:, derived] = self.columns
            self.columns = first[:, derived]
        product = first.T @ second
        return Dense(positive(product), first.T @ now)

    def follow(self, step: Doubles, change: Doubles, ratio: float) -> None:
        """Correct differences by what a step has changed, or forget them if the loss fell little, to a `ratio`.

        The correction is the least one by which they explain the change.
        """
        if self.differences is not None and ratio < FELL_MUCH:
            missing = change - self.differences @ step
            self.differences = self.differences + np.outer(missing, step / (step @ step))
        else:
            self.differences = None

    def slope(self, x: Doubles, now: Doubles, seed: int) -> Doubles:
        """J^T r at a vector with the residuals `now`, averaged with the steps before if there are tables of J."""
        self._linearise(x, seed)
        return self.reverse(self._averaged(x, now))

    def _linearise(self, x: Doubles, seed: int) -> None:
        """Find what products with J take at a vector, whose residuals are the last ones that were computed."""
        self._linear = self._passes.linear(self.variables(x), self._images, round_seed(seed, 1), self.halvings)

    def _averaged(self, x: Doubles, now: Doubles) -> Doubles:
        """The residuals at x, averaged with what those of the steps before predict, as their derivatives are.

        The weight of new residuals is that of least error: their own is noise, that of the prediction is the rest of
        the difference of both. Derivatives have more noise, and change less: as long as the prediction holds, all steps
        count the same.
        """
        here = self._linear
        before = self.means_before or Means(here, now, x, 0)
        predicting = here.by(before.linear)
        if predicting is None:
            return now
        if before.steps and self.noise:
            self._linear = predicting
            predicted = before.residuals + self.forward(x - before.x)
            apart = float(np.mean(np.square(now - predicted)))
            weight = float(np.clip(1 - self.noise / self.images / max(apart, 1e-30), LEAST_WEIGHT, 1))
            self._linear = here.mixed(before.linear, 1 - min(weight, max(1 / (before.steps + 1), LEAST_WEIGHT)))
            now = weight * now + (1 - weight) * predicted
        self.means_before = Means(self._linear, now, x, before.steps + 1)
        return now

    def _columns(self, x: Doubles, seed: int, entries: Iterable[int]) -> Doubles:
        """Columns of J, one for each of these entries."""
        columns = [
            self.difference(x, k, seed) if self._distances[k] else self.forward(np.eye(x.size)[k]) for k in entries
        ]
        return np.stack(columns, axis=1)


def in_own_memory(kind: type[Any], array: Doubles) -> Any:
    """Numbers as arrays or tensors of Dr.Jit, in its own memory.

    Memory of NumPy, which Dr.Jit shares, is aligned by chance, and `dr.freeze` records a function anew when the
    alignment of an input has changed.
    """
    shared = kind(np.ascontiguousarray(array, np.float32))
    if dr.is_tensor_v(kind):
        return kind(own_floats(array.ravel().astype(np.float32)), shared.shape)
    return mapped(shared, lambda numbers: own_array(type(numbers), numbers.numpy()))


def positive(matrix: Doubles) -> Doubles:
    """The symmetric part of an estimate of J^T J, without its negative eigenvalues."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray((vectors * np.maximum(values, 0)) @ vectors.T)


@dataclass(frozen=True)
class Dense:
    """J^T J and J^T r in full."""

    normal: Doubles
    slope: Doubles

    def step(self, damping: float) -> Doubles:
        """The step at a damping."""
        diagonal = np.diag(self.normal)
        floor = ALONE * max(float(diagonal.max(initial=0)), 1e-30)
        return np.asarray(-np.linalg.solve(self.normal + damping * np.diag(diagonal + floor), self.slope))


class MatrixFree:
    """J^T J as products, in the space of the vectors of the last steps and of those that are added for the residuals.

    The Gauss-Newton matrix changes little from step to step. So products with it serve again, as in Krylov methods that
    recycle (Parks et al., "Recycling Krylov Subspaces for Sequences of Linear Systems", SIAM Journal on Scientific
    Computing 28, 2006), and their noise averages out. The first vector to be added is the slope, the next ones are what
    the step leaves of it.

    Variables are divided by the roots of diag(J^T J). It is the mean of (J^T v)^2 over random signs v of the residuals,
    of which each of the first steps adds one estimate; since few are noisy, the mean of each variable is added: units
    may differ.

    Args:
        problem: What is solved.
        x: Where.
        now: The residuals there.
        seed: Those of derivatives follow from it.
        damping: Products end when one more would hardly change the step at this damping.
    """

    def __init__(self, problem: Problem, x: Doubles, now: Doubles, seed: int, damping: float) -> None:
        if problem.estimates < ESTIMATES:
            signs = np.random.default_rng(seed).choice([-1.0, 1.0], now.size)
            problem.squares += np.square(problem.reverse(signs))
            problem.estimates += 1
        squares = problem.squares / problem.estimates
        self._scale = 1 / np.sqrt(np.maximum(squares + problem.means(squares), 1e-30))
        self._slope = -self._scale * problem.reverse(now)
        norm = float(np.linalg.norm(self._slope))
        self._basis, self._bent = np.zeros((0, x.size)), np.zeros((0, x.size))
        for v, product in problem.products[::-1]:
            self._extend(v / self._scale, self._scale * product)
        left, gain = self._slope, self._gain(damping)
        enough = ENOUGH if problem.means_before is None else ENOUGH_TABULATED
        for _ in range(min(PRODUCTS, x.size)):
            q = self._apart(left)
            length = float(np.linalg.norm(q))
            if length <= SMALL * max(norm, 1e-30):
                break
            q /= length
            bent = self._scale * problem.normal(self._scale * q)
            problem.products.append((self._scale * q, bent / self._scale))
            self._extend(q, bent)
            before, gain = gain, self._gain(damping)
            if gain - before < enough * gain:
                break
            # What the step leaves of the slope, by all products so far.
            left = self._slope - self._inner(damping) @ self._bent
        del problem.products[:-KEPT]

    def _apart(self, vector: Doubles) -> Doubles:
        """A vector without its part in the space. Twice, since one pass leaves the rounding of single precision."""
        for _ in range(2):
            vector = vector - self._basis.T @ (self._basis @ vector)
        return vector

    def _extend(self, vector: Doubles, product: Doubles) -> None:
        """Add a vector and its product with J^T J to the space."""
        across = self._basis @ vector
        rest = vector - self._basis.T @ across
        length = float(np.linalg.norm(rest))
        if length <= APART * float(np.linalg.norm(vector)):
            return
        self._basis = np.vstack([self._basis, rest / length])
        self._bent = np.vstack([self._bent, (product - across @ self._bent) / length])

    def _inner(self, damping: float) -> Doubles:
        """The step in the basis."""
        small = positive(self._basis @ self._bent.T)
        return np.asarray(np.linalg.solve(small + damping * np.eye(len(small)), self._basis @ self._slope))

    def _gain(self, damping: float) -> float:
        """A number in proportion to what the step gains."""
        return float(self._basis @ self._slope @ self._inner(damping)) if len(self._basis) else 0.0

    def step(self, damping: float) -> Doubles:
        """The step at a damping."""
        return np.asarray(self._scale * (self._inner(damping) @ self._basis))

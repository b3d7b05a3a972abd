"""Tests, with a stated false-alarm rate, whether noise explains the difference of two images.

Each renderer renders the same scene several times with independent seeds: its *batches*. They give, for every
pixel, block of pixels or whole image, a mean and an unbiased variance of that mean, without
any data from the renderer but images. If both means estimate the same number, then

    t = (mean_a - mean_b) / sqrt(variance_a + variance_b)

follows Student's distribution. Four families of tests look at three scales:

* **pixels**, each channel by itself: detects a defect of a few pixels;
* **blocks** of 32 x 32 pixels: detects a defect of an object or of a shadow;
* **image mean** per channel: detects a missing factor, and a uniform bias that is smaller than the least one that
  the pixel test detects by about the square root of the number of pixels;
* **weighted mean** per channel, in which noisy cells of 8 x 8 pixels have little weight: detects a bias of the
  whole image where the noise of a few bright places hides it from the image mean.

A family of n tests alarms falsely with probability `significance` altogether: each single test uses Sidak's level
``1 - (1 - significance)^(1/n)`` (Z. Sidak 1967, *Rectangular confidence regions for the means of multivariate
normal distributions*), which is exact for independent tests, and safe for the correlated
ones (neighbours under a wide filter, channels of a pixel), since it bounds any normal vector.

Both images must come from different seeds, since images of equal seeds aren't independent: for those see
`djpt.validation.comparison`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.errors import BackendError
from djpt.validation.metrics import ComparisonError

__all__ = [
    "CELL",
    "RESOLUTION",
    "Batches",
    "TestResult",
    "block_test",
    "deviate",
    "limit_of",
    "mean_test",
    "noise_ratio",
    "pixel_test",
    "pooled_dof",
    "sidak",
    "weighted_test",
    "z_map",
]

Array = npt.NDArray[np.float64]

BLOCK = 32
"""Side of a block in pixels. Blocks at the right and lower border may be smaller."""

CELL = 8
"""Side of a cell in pixels: blocks consist of cells, whose averages are kept of each batch."""


@dataclass(frozen=True)
class Moments:
    """Mean, variance and degrees of freedom of some averages; all arrays have the shape of the averages."""

    mean: Array
    variance: Array  # of one batch's average, unbiased
    dof: Array  # degrees of freedom of `variance`
    count: int  # number of batches that were averaged


class Batches:
    """The mean and the variance of independent renders of one scene, accumulated by `add`.

    Memory: two float64 images, and per batch one number for each cell and channel.

    * `block`: the side of the blocks in pixels.
    * `cell`: the side of the cells, which divides it.
    """

    def __init__(self, block: int = BLOCK) -> None:
        self.block, self.cell = block, math.gcd(block, CELL)
        self.count = 0
        self._mean: Array = np.zeros(0)
        self._squares: Array = np.zeros(0)  # sum of squared deviations from the mean
        self._cells: list[Array] = []  # the averages of each batch

    def add(self, image: Any) -> None:
        """Add a render (H, W, C) with a seed of its own. Raises `ComparisonError` for NaN and for other shapes."""
        pixels = np.asarray(image, np.float64)
        if pixels.ndim != 3 or pixels.size == 0:
            raise ComparisonError(f"a batch has shape (H, W, C), found {pixels.shape}")
        if self.count == 0:
            self._mean, self._squares = np.zeros_like(pixels), np.zeros_like(pixels)
        if pixels.shape != self._mean.shape:
            raise ComparisonError(f"batches of different shapes: {self._mean.shape} and {pixels.shape}")
        bad = np.count_nonzero(~np.isfinite(pixels))
        if bad:
            raise ComparisonError(f"batch {self.count} has {bad} values that are NaN or infinite")
        # Welford's update: stable where sums of squares are not.
        self.count += 1
        deviation = pixels - self._mean
        self._mean = self._mean + deviation / self.count
        self._squares = self._squares + deviation * (pixels - self._mean)
        self._cells.append(added(pixels, self.cell) / block_sizes(pixels.shape, self.cell))

    @classmethod
    def restored(cls, mean: Any, variance: Any, cells: Any, block: int = BLOCK) -> Batches:
        """The batches of which these are the `mean`, `pixels().variance` and `cells`."""
        found = cls(block)
        found.count = len(cells)
        found._mean = np.asarray(mean, np.float64)
        found._squares = np.asarray(variance, np.float64) * (found.count - 1)
        found._cells = [np.asarray(each, np.float64) for each in cells]
        found._need_two()
        return found

    @property
    def cells(self) -> Array:
        """The averages of the cells of each batch, (count, rows, columns, C)."""
        return np.stack(self._cells)

    @property
    def mean(self) -> Array:
        """The mean image (H, W, C)."""
        return self._mean

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W, C)."""
        return self._mean.shape

    def variance_of_mean(self) -> Array:
        """The variance of `mean` per pixel (H, W, C)."""
        return self.pixels().variance / self.count

    def pixels(self) -> Moments:
        """Moments of the single pixels, (H, W, C)."""
        self._need_two()
        dof = self.count - 1
        return Moments(self._mean, self._squares / dof, np.full(self._mean.shape, float(dof)), self.count)

    def blocks(self, independent_pixels: bool = False) -> Moments:
        """Moments of the block averages, (rows, columns, C).

        The variance is that of the batches' block averages, right for any filter, with count - 1 degrees
        of freedom. `independent_pixels` (true under the box filter) adds up the pixels' variances
        instead, which leaves thousands of degrees of freedom (Satterthwaite 1946, *An approximate distribution
        of estimates of variance components*) and so a sharper test from few batches.
        """
        self._need_two()
        if independent_pixels:
            return self._added_up(self.block)
        sizes, whole = block_sizes(self.shape, self.cell), block_sizes(self.shape, self.block)
        side = self.block // self.cell
        return moments_of([added(cells * sizes, side) / whole for cells in self._cells])

    def _added_up(self, side: int) -> Moments:
        """Moments of the averages over blocks of independent pixels."""
        pixels, size = self.pixels(), block_sizes(self.shape, side)
        total = added(pixels.variance, side)
        dof = pooled_dof(total, added(pixels.variance**2 / pixels.dof, side), added(pixels.dof, side))
        return Moments(added(pixels.mean, side) / size, total / size**2, dof, self.count)

    def image(self, independent_pixels: bool = False) -> Moments:
        """Moments of the whole image's average per channel, (C,); see `blocks`."""
        height, width, _ = self.shape
        return self.weighted(block_sizes(self.shape, self.cell) / (height * width), independent_pixels)

    def noise(self) -> Moments:
        """Moments of the averages of cells as if pixels were independent, which need not be, (rows, columns, C)."""
        self._need_two()
        return self._added_up(self.cell)

    def weighted(self, weights: Array, independent_pixels: bool = False) -> Moments:
        """Moments of a weighted mean of the averages of cells per channel, (C,); see `blocks`.

        `weights`: of each cell and channel, (rows, columns, C or 1), with the sum 1 for each channel.
        """
        self._need_two()
        if not independent_pixels:
            return moments_of([(cells * weights).sum(axis=(0, 1)) for cells in self._cells])
        cells = self.noise()
        shares = cells.variance * weights**2
        total, squares = shares.sum(axis=(0, 1)), (shares**2 / cells.dof).sum(axis=(0, 1))
        dof = pooled_dof(total, squares, cells.dof.sum(axis=(0, 1)))
        return Moments((cells.mean * weights).sum(axis=(0, 1)), total, dof, self.count)

    def _need_two(self) -> None:
        if self.count < 2:
            raise ComparisonError(f"a variance needs at least 2 batches, found {self.count}")


def moments_of(averages: list[Array]) -> Moments:
    """Moments of the averages of batches, from their spread."""
    stack = np.stack(averages)
    dof = np.full(stack.shape[1:], len(stack) - 1.0)
    return Moments(stack.mean(axis=0), stack.var(axis=0, ddof=1), dof, len(stack))


def pooled_dof(total: Any, squares: Any, noiseless: Any) -> Array:
    """The degrees of freedom of a sum of variances v: (sum of v)^2 / (sum of v^2 / dof), by Satterthwaite.

    `total` and `squares` are these sums. Where there is no noise any number will do: `noiseless`.
    """
    return np.asarray(np.where(squares > 0, total**2 / np.where(squares > 0, squares, 1), noiseless))


def added(image: Array, side: int) -> Array:
    """The sums over blocks, (rows, columns, C)."""
    sums = np.add.reduceat(image, np.arange(0, image.shape[0], side), axis=0)
    return np.asarray(np.add.reduceat(sums, np.arange(0, image.shape[1], side), axis=1))


def block_sizes(shape: tuple[int, ...], block: int) -> Array:
    """The number of pixels of each block, (rows, columns, 1)."""
    rows, columns = (np.diff(np.append(np.arange(0, n, block), n)).astype(np.float64) for n in shape[:2])
    return np.asarray(rows[:, None, None] * columns[None, :, None])


# ---- tests -----------------------------------------------------------------------------------


RESOLUTION = 1e-5
"""Relative differences up to this count as rounding: Mitsuba's own renders differ by 7e-6 (order of atomics)."""


@dataclass(frozen=True)
class TestResult:
    """One family of tests.

    * `name`, `count`: which family, and how many tests it has.
    * `z`: the most extreme test, as the normal deviate with the same p-value; positive = too bright.
    * `critical`: the largest |z| that passes, by Sidak.
    * `p_value`: the probability that noise alone gives such an extreme in any of the tests.
    * `rejected`: how many tests exceed `critical`; `where`: the index of the extreme one.
    * `detectable`: the bias that a single test of this family, of median noise, detects in every
      second comparison, as a share of the reference's mean: the resolution of this comparison.
    """

    __test__ = False  # not a class of tests for pytest

    name: str
    count: int
    z: float
    critical: float
    p_value: float
    rejected: int
    where: tuple[int, ...]
    detectable: float

    @property
    def passed(self) -> bool:
        """True if noise explains the difference at the significance that was asked for."""
        return abs(self.z) <= self.critical

    def __str__(self) -> str:
        verdict = "ok" if self.passed else "FAILED"
        beyond = f"limit {self.critical:.2f}, {self.rejected} of {self.count} beyond"
        return (
            f"{self.name}: {verdict}, worst z {self.z:+.2f} ({beyond}) at {self.where}, detects {self.detectable:.2%}"
        )


def pixel_test(a: Batches, b: Batches, significance: float = 1e-3, equal_variance: bool = True) -> TestResult:
    """Test whether any pixel of `a` differs from `b`'s by more than noise: one test per pixel and channel."""
    return _test("pixels", a.pixels(), b.pixels(), significance, equal_variance)


def block_test(
    a: Batches,
    b: Batches,
    significance: float = 1e-3,
    equal_variance: bool = True,
    independent_pixels: bool = False,
) -> TestResult:
    """Test whether any block's mean differs: one test per block and channel; see `Batches.blocks` for arguments."""
    if a.block != b.block:
        raise ComparisonError(f"blocks of different sizes: {a.block} and {b.block}")
    return _test(
        f"{a.block} x {a.block} blocks",
        a.blocks(independent_pixels),
        b.blocks(independent_pixels),
        significance,
        equal_variance,
    )


def mean_test(
    a: Batches,
    b: Batches,
    significance: float = 1e-3,
    equal_variance: bool = True,
    independent_pixels: bool = False,
    critical: float | None = None,
) -> TestResult:
    """Test whether any channel's mean differs: one test per channel; see `Batches.blocks` for `independent_pixels`.

    `critical`: the largest |z| that passes, in place of the one that follows from `significance`.
    """
    first, second = a.image(independent_pixels), b.image(independent_pixels)
    return _test("image mean", first, second, significance, equal_variance, critical)


def weighted_test(
    a: Batches,
    b: Batches,
    significance: float = 1e-3,
    equal_variance: bool = True,
    independent_pixels: bool = False,
) -> TestResult:
    """Test whether any channel's mean differs in which noisy cells have little weight: one test per channel.

    A bias in proportion to the brightness M of cells of variance V is seen best with the weights M / V (least
    squares). The median variance is added to V, so that what is free of noise, such as a background, doesn't hide
    the rest. Both sides share the weights, which follow from both alike, so equal renderers differ by them in
    neither direction.
    """
    if a.shape != b.shape:
        raise ComparisonError(f"images of different shapes: {a.shape} and {b.shape}")
    first, second = a.noise(), b.noise()
    brightness = np.abs(first.mean + second.mean) / 2
    variance = first.variance / a.count + second.variance / b.count
    noisy = [values[values > 0] for values in np.moveaxis(variance, 2, 0)]
    variance = variance + [np.median(values) if values.size else 1.0 for values in noisy]
    weights = brightness / variance
    weights = np.where(weights.sum(axis=(0, 1)) > 0, weights, 1.0) * block_sizes(a.shape, a.cell)
    weights = weights / weights.sum(axis=(0, 1))
    first, second = (each.weighted(weights, independent_pixels) for each in (a, b))
    return _test("weighted mean", first, second, significance, equal_variance)


def z_map(a: Batches, b: Batches, equal_variance: bool = True) -> Array:
    """The deviate of each pixel's worst channel, (H, W): positive where `a` is brighter; see `pixel_test`."""
    first, second = a.pixels(), b.pixels()
    size = _deviates(first, second, equal_variance, 0.5)[0]
    worst = size.argmax(axis=2)[..., None]
    signed = np.copysign(size, first.mean - second.mean)
    return np.asarray(np.take_along_axis(signed, worst, axis=2)[..., 0])


def noise_ratio(a: Batches, b: Batches) -> float:
    """The standard deviation of a batch of `a` / of `b`: the geometric mean over all pixels that have noise.

    A few very noisy pixels, such as the edge of a lamp, have little weight in it. The logarithm of an estimated
    variance is on average too small by log(dof/2) - digamma(dof/2), which is corrected. 1 if neither has noise.
    """
    first, second = a.pixels(), b.pixels()
    both = (first.variance > 0) & (second.variance > 0)
    if not both.any():
        return 1.0
    digamma = _scipy().special.digamma
    logs = [
        float(np.mean(np.log(moments.variance[both]))) + math.log(dof / 2) - float(digamma(dof / 2))
        for moments, dof in ((first, a.count - 1), (second, b.count - 1))
    ]
    return math.exp((logs[0] - logs[1]) / 2)


def sidak(significance: float, count: int) -> float:
    """The level of each of `count` tests such that all together alarm falsely with probability `significance`."""
    return -math.expm1(math.log1p(-significance) / count)


def _test(
    name: str,
    a: Moments,
    b: Moments,
    significance: float,
    equal_variance: bool,
    critical: float | None = None,
) -> TestResult:
    """Run the tests of a family; `critical` replaces the limit by Sidak."""
    if a.mean.shape != b.mean.shape:
        raise ComparisonError(f"images of different shapes: {a.mean.shape} and {b.mean.shape}")
    if not 0 < significance < 1:
        raise ComparisonError(f"the significance must lie between 0 and 1, found {significance}")
    normal = _scipy().stats.norm

    difference = a.mean - b.mean
    single = sidak(significance, difference.size) if critical is None else 2 * float(normal.sf(critical))
    size, seen = _deviates(a, b, equal_variance, single)
    worst = int(np.argmax(size))
    limit = float(normal.isf(single / 2))
    p = min(2 * float(normal.sf(size.flat[worst])), 1 - 1e-16)
    scale = float(np.mean(np.abs(b.mean)))
    return TestResult(
        name=name,
        count=difference.size,
        z=math.copysign(size.flat[worst], difference.flat[worst]),
        critical=limit,
        p_value=-math.expm1(difference.size * math.log1p(-p)),
        rejected=int(np.count_nonzero(size > limit)),
        where=tuple(int(i) for i in np.unravel_index(worst, difference.shape)),
        detectable=seen / scale if scale else math.inf,
    )


def _deviates(a: Moments, b: Moments, equal_variance: bool, single: float) -> tuple[Array, float]:
    """The |z| of two-sample t-tests of all averages, and the difference that a test at level `single` detects.

    `equal_variance`: both renderers use the same estimator with the same samples per batch, so one variance is
    estimated from both (Student): exact for normal noise, and conservative for skewed noise (fireflies) as long
    as both have equally many batches, since the difference is symmetric then. With unequal counts skewness would
    cause false alarms: rare bright paths are found by many batches and missed by few, or meet one of the few.
    Then Welch's test, which estimates two variances, must reject as well. Without `equal_variance` Welch's test
    alone decides.
    """
    student = _scipy().stats.t
    difference = a.mean - b.mean
    rounding = RESOLUTION * np.maximum(np.abs(a.mean), np.abs(b.mean))
    variances = [_student(a, b)] if equal_variance else []
    if not equal_variance or a.count != b.count:
        variances.append(_welch(a, b))

    size = np.full_like(difference, np.inf)  # |z|
    seen = 0.0
    for variance, dof in variances:
        error = np.sqrt(variance + rounding**2)
        t = np.abs(np.divide(difference, error, out=np.zeros_like(difference), where=error > 0))
        size = np.minimum(size, deviate(t, dof))
        seen = max(seen, float(np.median(student.isf(single / 2, dof) * error)))
    return size, seen


def deviate(t: Any, dof: Any) -> Any:
    """The normal deviates with the same p-values as values t >= 0 of Student's distribution."""
    stats = _scipy().stats
    # A normal deviate is never larger than the t with the same p; this also replaces the infinity of p = 0.
    return np.minimum(stats.norm.isf(stats.t.sf(t, dof)), t)


def limit_of(significance: float, count: int) -> float:
    """The largest absolute deviate that passes in each of `count` tests, at Sidak's level."""
    return float(_scipy().stats.norm.isf(sidak(significance, count) / 2))


def _student(a: Moments, b: Moments) -> tuple[Array, Array]:
    """The variance of the difference of the means and its degrees of freedom, from one pooled variance."""
    dof = a.dof + b.dof
    return (a.dof * a.variance + b.dof * b.variance) / dof * (1 / a.count + 1 / b.count), dof


def _welch(a: Moments, b: Moments) -> tuple[Array, Array]:
    """The variance of the difference of the means from two variances (Welch 1947), and Satterthwaite's dof."""
    va, vb = a.variance / a.count, b.variance / b.count
    spread = va**2 / a.dof + vb**2 / b.dof
    return va + vb, pooled_dof(va + vb, spread, a.dof + b.dof)


def _scipy() -> Any:
    try:
        import scipy.special
        import scipy.stats
    except ImportError:
        raise BackendError("the statistical tests need SciPy: pip install scipy") from None
    return scipy

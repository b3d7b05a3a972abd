"""The tests that judge images are themselves tested: they accept noise at their rate and see planted defects."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

import djpt  # noqa: F401  (before anything that might load LLVM)
from djpt.validation.comparison import agreement
from djpt.validation.metrics import ComparisonError, mean_bias, relative_bias, relative_rmse, rmse
from djpt.validation.statistics import Batches, TestResult, block_test, mean_test, noise_ratio, pixel_test, sidak

pytest.importorskip("scipy")

Noise = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]


def normal(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return rng.normal(1.0, 0.3, shape)


def fireflies(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """As skewed as a render of 8 samples a pixel: mostly dark, seldom very bright; mean 1."""
    return rng.exponential(1.0, (8, *shape)).mean(axis=0) * 0.5 + 0.5 * (rng.random(shape) < 0.05) / 0.05


def batches(
    rng: np.random.Generator, count: int, shape: tuple[int, ...], noise: Noise = normal, block: int = 8
) -> Batches:
    result = Batches(block)
    for _ in range(count):
        result.add(noise(rng, shape))
    return result


def families() -> dict[str, Callable[..., TestResult]]:
    return {
        "pixel": pixel_test,
        "block": block_test,
        "mean": mean_test,
        "block, independent pixels": lambda *a, **k: block_test(*a, independent_pixels=True, **k),
        "mean, independent pixels": lambda *a, **k: mean_test(*a, independent_pixels=True, **k),
    }


FAMILIES = families()


# ---------------------------------------------------------------- false alarms


@pytest.mark.sparse(6)
@pytest.mark.parametrize("equal_variance", [True, False])
@pytest.mark.parametrize("counts", [(3, 3), (4, 9)])
@pytest.mark.slow
def test_noise_is_accepted_at_the_stated_rate(equal_variance: bool, counts: tuple[int, int]) -> None:
    trials, significance = 400, 0.05
    rng = np.random.default_rng(1)
    alarms = dict.fromkeys(FAMILIES, 0)
    for _ in range(trials):
        a, b = (batches(rng, count, (20, 12, 2)) for count in counts)
        for name, test in FAMILIES.items():
            alarms[name] += not test(a, b, significance=significance, equal_variance=equal_variance).passed
    spread = 4.5 * math.sqrt(trials * significance * (1 - significance))
    for name, found in alarms.items():
        assert found <= trials * significance + spread, f"{name}: {found} alarms"
        # Student's test is exact for normal noise; Welch's only near, and Satterthwaite's careful.
        if equal_variance and counts[0] == counts[1] and "independent" not in name:
            assert found >= trials * significance - spread, f"{name}: only {found} alarms"


@pytest.mark.parametrize("counts", [(4, 4), (4, 64)])
@pytest.mark.sparse(2)
def test_fireflies_raise_no_alarm(counts: tuple[int, int]) -> None:
    """Noise that isn't normal, and a reference that has seen far more of it, as in a real comparison."""
    trials, significance = 60, 0.01
    rng = np.random.default_rng(2)
    alarms = dict.fromkeys(FAMILIES, 0)
    for _ in range(trials):
        a, b = (batches(rng, count, (24, 24, 3), fireflies) for count in counts)
        for name, test in FAMILIES.items():
            alarms[name] += not test(a, b, significance=significance).passed
    assert all(found <= 4 for found in alarms.values()), alarms  # 4 or more of 60 at 1 %: 0.3 %


@pytest.mark.slow
def test_filtered_noise_raises_no_alarm() -> None:
    """A wide filter correlates neighbours: the block test measures that instead of assuming independence."""

    def filtered(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        raw = rng.normal(1, 0.3, (shape[0] + 3, shape[1] + 3, shape[2]))
        return sum(raw[i : i + shape[0], j : j + shape[1]] for i in range(4) for j in range(4)) / 16

    rng = np.random.default_rng(3)
    alarms = assumed = 0
    for _ in range(200):
        a, b = (batches(rng, 6, (16, 16, 1), filtered) for _ in range(2))
        alarms += not block_test(a, b, significance=0.05).passed
        assumed += not block_test(a, b, significance=0.05, independent_pixels=True).passed
    assert alarms <= 10 + 14
    assert assumed > 50, "and assuming independence would be wrong here"


def test_rounding_is_no_bias() -> None:
    """A furnace without noise: 1e-6 is rounding, 1e-3 is not."""
    a, b, c = Batches(), Batches(), Batches()
    for _ in range(4):
        a.add(np.full((8, 8, 3), 1.0))
        b.add(np.full((8, 8, 3), 1.0 + 1e-6))
        c.add(np.full((8, 8, 3), 1.0 + 1e-3))
    for name, test in FAMILIES.items():
        assert test(b, a).passed, name
        assert not test(c, a).passed, name
    black = Batches()
    for _ in range(4):
        black.add(np.zeros((8, 8, 3)))
    assert all(test(black, black).passed for test in FAMILIES.values())


# ---------------------------------------------------------------- power


def planted(rng: np.random.Generator, family: str, size: float, where: tuple[slice, slice]) -> bool:
    """Whether the family sees a bias of `size` standard deviations of a batch, planted at `where`."""
    shape, count = (64, 64, 3), 8
    a, b = Batches(), Batches()
    for _ in range(count):
        image = normal(rng, shape)
        image[where] += size * 0.3
        a.add(image)
        b.add(normal(rng, shape))
    return not FAMILIES[family](a, b, significance=1e-3).passed


ALL = (slice(None), slice(None))
ONE = (slice(40, 41), slice(7, 8))
OBJECT = (slice(0, 32), slice(32, 64))


@pytest.mark.parametrize(
    ("family", "size", "where"),
    [
        ("pixel", 12.0, ONE),  # one wrong pixel
        ("block", 0.15, OBJECT),  # a wrong object
        ("block, independent pixels", 0.10, OBJECT),
        ("mean", 0.07, ALL),  # a wrong factor
        ("mean, independent pixels", 0.045, ALL),
    ],
)
def test_planted_defects_are_seen(family: str, size: float, where: tuple[slice, slice]) -> None:
    rng = np.random.default_rng(4)
    assert sum(planted(rng, family, size, where) for _ in range(10)) >= 9


def test_the_mean_sees_what_pixels_do_not() -> None:
    """A uniform bias of 5 % of a batch's noise: no pixel shows it, the mean shows it always."""
    rng = np.random.default_rng(5)
    assert not any(planted(rng, "pixel", 0.05, ALL) for _ in range(5))
    assert all(planted(rng, "mean, independent pixels", 0.05, ALL) for _ in range(5))


@pytest.mark.sparse(6)
@pytest.mark.parametrize("family", FAMILIES)
def test_detectable_is_what_is_seen_every_second_time(family: str) -> None:
    rng = np.random.default_rng(6)
    trials, shape, count = 200, (16, 16, 1), 4
    test = FAMILIES[family]
    seen = 0
    for trial in range(trials):
        b = batches(rng, count, shape)
        if trial == 0:
            expected = [test(*(batches(rng, count, shape) for _ in range(2))).detectable for _ in range(100)]
            size = float(np.median(expected))
        # One place for the pixel and block tests, so that only one test of the family can see it.
        shifted = Batches(8)
        where = {"p": (slice(3, 4), slice(5, 6)), "b": (slice(0, 8), slice(8, 16)), "m": ALL}[family[0]]
        for _ in range(count):
            image = normal(rng, shape)
            image[where] += size
            shifted.add(image)
        seen += not test(shifted, b).passed
    assert 0.3 < seen / trials < 0.7


def test_result_says_where_and_which_way() -> None:
    rng = np.random.default_rng(7)
    a, b = Batches(), Batches()
    for _ in range(6):
        image = normal(rng, (64, 96, 3))
        image[32:, 64:, 1] -= 0.2
        a.add(image)
        b.add(normal(rng, (64, 96, 3)))
    result = block_test(a, b)
    assert result.where == (1, 2, 1)
    assert result.z < -result.critical
    assert result.count == 2 * 3 * 3
    assert result.p_value < 1e-3
    assert result.rejected == 1
    assert "FAILED" in str(result) and "(1, 2, 1)" in str(result)


# ---------------------------------------------------------------- arithmetic


def test_sidak() -> None:
    assert sidak(0.05, 1) == pytest.approx(0.05)
    level = sidak(0.01, 200_000)
    assert 1 - (1 - level) ** 200_000 == pytest.approx(0.01, rel=1e-6)


def test_moments_are_numpys() -> None:
    rng = np.random.default_rng(8)
    images = rng.normal(5, 1, (7, 21, 19, 2))
    accumulated = Batches(block=8)
    for image in images:
        accumulated.add(image.astype(np.float32))
    np.testing.assert_allclose(accumulated.mean, images.mean(0), rtol=1e-6)
    np.testing.assert_allclose(accumulated.pixels().variance, images.var(0, ddof=1), rtol=1e-4)
    np.testing.assert_allclose(accumulated.variance_of_mean(), images.var(0, ddof=1) / 7, rtol=1e-4)
    corner = images[:, 16:, 16:].mean(axis=(1, 2))  # 5 x 3 pixels
    np.testing.assert_allclose(accumulated.blocks().mean[2, 2], corner.mean(0), rtol=1e-6)
    np.testing.assert_allclose(accumulated.blocks().variance[2, 2], corner.var(0, ddof=1), rtol=1e-4)
    np.testing.assert_allclose(accumulated.blocks(True).mean, accumulated.blocks().mean, rtol=1e-9)
    means = images.mean(axis=(1, 2))
    for independent in (False, True):
        np.testing.assert_allclose(accumulated.image(independent).mean, means.mean(0), rtol=1e-6)
    np.testing.assert_allclose(accumulated.image().variance, means.var(0, ddof=1), rtol=1e-4)
    np.testing.assert_allclose(accumulated.image(True).variance, images.var(0, ddof=1).sum((0, 1)) / 399**2, rtol=1e-4)
    assert np.all(accumulated.image(True).dof > 1000)


@pytest.mark.parametrize("counts", [(3, 3), (3, 20), (9, 4)])
def test_noise_ratio_is_that_of_the_typical_pixel(counts: tuple[int, int]) -> None:
    rng = np.random.default_rng(10)
    noisy = batches(rng, counts[0], (48, 48, 3), lambda rng, shape: 1 + 1.05 * (normal(rng, shape) - 1))
    assert noise_ratio(noisy, batches(rng, counts[1], (48, 48, 3))) == pytest.approx(1.05, rel=0.03)
    still = Batches()
    for _ in range(2):
        still.add(np.ones((4, 4, 3)))
    assert noise_ratio(still, still) == 1.0


def test_metrics() -> None:
    b = np.full((2, 2, 3), 2.0)
    a = b + np.array([0.5, -0.5, 0.3])
    assert rmse(a, b) == pytest.approx(math.sqrt((0.25 + 0.25 + 0.09) / 3))
    assert relative_rmse(a, b) == pytest.approx(math.sqrt((0.25 + 0.25 + 0.09) / 3 / 4.01))
    assert mean_bias(a, b) == pytest.approx(0.1)
    assert relative_bias(a, b) == pytest.approx(0.05)
    zero = np.zeros((1, 1, 1))
    assert relative_bias(zero, zero) == 0.0
    assert relative_bias(zero + 1, zero) == math.inf


def test_same_seed_agreement() -> None:
    rng = np.random.default_rng(9)
    b = rng.exponential(1.0, (100, 100, 3))
    a = b * (1 + rng.uniform(-1e-6, 1e-6, b.shape))
    a[3, 5, 1] *= 1.5  # one path that rounding sent elsewhere
    found = agreement(a, b)
    assert found.share == pytest.approx(0.9999)
    assert found.worst == pytest.approx(1 / 3)
    assert found.median < 1e-6
    assert abs(found.bias) < 1e-4
    assert agreement(b, b).share == 1.0
    assert agreement(b * 1.002, b).share == 0.0, "a factor shows in every pixel"
    black = np.zeros((4, 4, 3))
    assert agreement(black, black).share == 1.0
    assert agreement(black + 1e-12, black + 1).share == 0.0
    assert "99.99" in str(found)


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        (np.zeros((2, 2, 3)), np.zeros((2, 3, 3)), "one shape"),
        (np.zeros((2, 2)), np.zeros((2, 2)), "one shape"),
        (np.full((2, 2, 1), np.nan), np.zeros((2, 2, 1)), "4 values that are NaN"),
    ],
)
def test_images_that_cannot_be_compared(a: np.ndarray, b: np.ndarray, message: str) -> None:
    for function in (rmse, relative_rmse, mean_bias, agreement):
        with pytest.raises(ComparisonError, match=message):
            function(a, b)


def test_batches_that_cannot_be_compared() -> None:
    one, other = Batches(), Batches()
    one.add(np.zeros((4, 4, 3)))
    with pytest.raises(ComparisonError, match="at least 2 batches"):
        pixel_test(one, one)
    with pytest.raises(ComparisonError, match="different shapes"):
        one.add(np.zeros((4, 5, 3)))
    with pytest.raises(ComparisonError, match="NaN"):
        one.add(np.full((4, 4, 3), np.inf))
    with pytest.raises(ComparisonError, match=r"\(H, W, C\)"):
        one.add(np.zeros((4, 4)))
    for target, shape in ((one, (4, 4, 3)), (other, (4, 5, 3)), (other, (4, 5, 3))):
        target.add(np.zeros(shape))
    with pytest.raises(ComparisonError, match="images of different shapes"):
        pixel_test(one, other)
    with pytest.raises(ComparisonError, match="significance"):
        pixel_test(one, one, significance=0)

"""Choosing emitters: probabilities and the choice belong together, and images don't depend on the choice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import pytest
from scipy.stats import kstest

import djpt
from djpt.emitters.base import LightBounds
from djpt.emitters.light_samplers import LIGHT_SAMPLERS, make_light_sampler
from djpt.emitters.light_samplers.tree import TreeLightSampler
from tests.kit.chi_squared import probability_of_counts


@dataclass
class Light:
    """What a choice asks an emitter."""

    bound: LightBounds | None
    weight: float = 1.0
    watts: float = 1.0

    def sampling_weight(self) -> float:
        return self.weight

    def power(self) -> float:
        return self.watts if self.bound is None else self.bound.power

    def bounds_in_time(self) -> LightBounds | None:
        return self.bound


def lights(count: int, seed: int, infinite: int = 0) -> list[Any]:
    """Lights of all sorts in the unit cube, some in one place, some from infinity, some without weight."""
    rng = np.random.default_rng(seed)
    result = []
    for k in range(count):
        low = rng.random(3) if k % 5 else np.full(3, 0.3)
        size = rng.choice([0.0, 0.05, 0.5]) * rng.random(3)
        axis = rng.normal(size=3)
        theta_o, theta_e = rng.choice([0, 0, 0.7, np.pi]), rng.choice([0.3, np.pi / 2])
        power = rng.exponential() * (k % 7 != 3)
        bound = LightBounds(low, low + size, axis / np.linalg.norm(axis), theta_o, theta_e, power)
        result.append(Light(bound, 0.0 if k % 11 == 10 else 1.0 + k % 2))
    for k in range(infinite):
        result.insert(k * 2, Light(None, 1.0 + k))
    return result


def point(rng: np.random.Generator) -> tuple[Any, Any]:
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    return djpt.Point3f(*(1.6 * rng.random(3) - 0.3).tolist()), djpt.Vector3f(*n.tolist())


def chances(choice: Any, p: Any, n: Any) -> np.ndarray:
    return np.broadcast_to(
        np.array(choice.probability(p, n, dr.arange(djpt.UInt32, choice.count)), np.float64), choice.count
    )


@pytest.mark.sparse(10)
@pytest.mark.parametrize("name", LIGHT_SAMPLERS)
@pytest.mark.parametrize(("count", "infinite"), [(1, 0), (2, 0), (1, 1), (0, 2), (9, 0), (40, 0), (40, 3), (300, 1)])
def test_choices_follow_their_probabilities(name: str, count: int, infinite: int) -> None:
    rng = np.random.default_rng(count + infinite)
    choice = make_light_sampler(name, lights(count, count, infinite))
    samples = 40_000
    u = djpt.Float((np.arange(samples, dtype=np.float32) + 0.5) / samples)
    for with_normal in (True, True, False):
        p, n = point(rng)
        n = n if with_normal else None
        expected = chances(choice, p, n)
        index, inverse, fresh = (np.broadcast_to(np.array(x), samples) for x in choice.choose(p, n, u))
        found = inverse > 0
        np.testing.assert_allclose(inverse[found] * expected[index[found]], 1, rtol=2e-4)
        assert expected.sum() <= 1 + 1e-5
        assert abs(expected.sum() - found.mean()) < 2 * len(expected) / samples + 1e-4
        counts = np.bincount(index[found], minlength=choice.count)
        # Stratified numbers: counts are exact but for the ends of intervals.
        assert np.abs(counts - samples * expected).max() < 4 + 1e-4 * samples
        assert fresh.min() >= 0
        assert fresh.max() < 1


def test_independent_numbers_are_chosen_and_left_uniform() -> None:
    choice = TreeLightSampler(lights(60, 3, 1))
    rng = np.random.default_rng(1)
    for _ in range(3):
        p, n = point(rng)
        u = djpt.Float(rng.random(200_000, dtype=np.float32))
        index, inverse, fresh = (np.array(x) for x in choice.choose(p, n, u))
        expected = chances(choice, p, n)
        found = inverse > 0
        counts = np.bincount(index[found], minlength=choice.count)
        # All the rest, where nothing was chosen included, is one cell.
        cells = np.append(counts, len(u) - counts.sum()), np.append(expected, 1 - expected.sum())
        assert probability_of_counts(*cells, error=0, slack=1) > 1e-4
        for i in np.nonzero(counts > 1000)[0]:
            assert kstest(fresh[index == i], "uniform").pvalue > 1e-5


def test_numbers_stay_fine_among_many_lights() -> None:
    """The choice among 20000 uses up 14 of 23 bits."""
    rng = np.random.default_rng(4)
    many = [
        Light(LightBounds(low, low, np.array([0.0, 0, 1]), np.pi, np.pi / 2, 1.0)) for low in rng.random((20_000, 3))
    ]
    choice = TreeLightSampler(many)
    u = djpt.Float((rng.integers(0, 2**23, 100_000) / 2**23).astype(np.float32))
    _, inverse, fresh = choice.choose(djpt.Point3f(0.5, 0.5, 30), None, u)
    assert np.median(np.array(inverse)) > 5000
    assert len(np.unique(np.array(fresh))) > 90_000
    assert kstest(np.array(fresh), "uniform").pvalue > 1e-5


def test_what_could_shine_can_be_chosen() -> None:
    """Points of each light's box, with normals from its cone, send light within theta_e of these."""
    rng = np.random.default_rng(8)
    some = lights(70, 5)
    choice = TreeLightSampler(some)
    size, tested = 4000, 0
    for i, light in enumerate(some):
        b = light.bound
        if b.power * light.sampling_weight() == 0:
            continue
        source = b.low + rng.random((size, 3)) * (b.high - b.low)
        normal = cone(rng, np.broadcast_to(b.axis, (size, 3)), b.theta_o)
        d = cone(rng, normal, b.theta_e)
        p = djpt.Point3f(*(source + d * rng.exponential(0.5, (size, 1))).T.astype(np.float32))
        n = djpt.Vector3f(*rng.permuted(d, axis=1).T.astype(np.float32))
        found = np.broadcast_to(np.array(choice.probability(p, n, djpt.UInt32(i))), size)
        assert found.min() > 0
        tested += 1
    assert tested > 40


def cone(rng: np.random.Generator, axis: np.ndarray, angle: float) -> np.ndarray:
    """Directions within an angle of axes, the largest angle included."""
    other = np.cross(axis, rng.normal(size=axis.shape))
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    t = angle * np.minimum(rng.random((len(axis), 1)) * 1.2, 1)
    return axis * np.cos(t) + other * np.sin(t)


def test_no_light_is_an_error() -> None:
    for name in ("power", "tree"):
        with pytest.raises(djpt.SceneError, match="all sampling weights times powers are 0"):
            make_light_sampler(name, [Light(None, 0.0), Light(lights(1, 0)[0].bound, 0.0)])  # type: ignore[list-item]


def test_misspelt_choice() -> None:
    with pytest.raises(djpt.SceneError, match=r"emitter_choice.*'tee'.*'tree'"):
        djpt.load_dict({"type": "path", "emitter_choice": "tee"})

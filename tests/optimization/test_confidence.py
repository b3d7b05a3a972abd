"""Standard errors hold: repeated searches scatter as stated, and intervals contain the truth as often as they say."""

from __future__ import annotations

import sys
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.apps.optimization import Confidence, confidence, optimize
from djpt.apps.optimization.confidence import Linearized
from djpt.apps.optimization.losses import smoothness
from djpt.errors import ParameterError, RenderError
from tests.optimization.test_optimize import KEY, TRUTH, floor, grey, pictures, texture

TEXELS = "paint.reflectance.data"


def covered(errors: np.ndarray, truth: np.ndarray, half_widths: np.ndarray) -> float:
    """The percentage of intervals that hold the truth; rows of `errors` are results."""
    return 100 * float(np.mean(np.abs(errors - truth) <= half_widths))


# ---------------------------------------------------------------- few numbers


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_searches() -> None:
    scene = floor(size=8)
    targets = pictures(scene, 1024)
    stated = confidence(scene, [KEY], targets, spp=16, gradients=32)
    # One Newton step from the truth, repeated with other seeds, scatters as stated.
    inverse = np.linalg.inv((stated.combinations.T * stated.curvatures) @ stated.combinations)
    views = {view: np.array(target, np.float64) for view, target in enumerate(targets)}
    problem = Linearized(scene, djpt.traverse(scene), [KEY], views, 16, {})
    ends = [inverse @ problem.gradient(1000 + seed) for seed in range(24)]
    assert np.allclose(np.std(ends, axis=0), stated.errors, rtol=0.5)
    assert stated.condition < 100 and not stated.undetermined
    assert np.allclose(stated.half_widths(0.9), 1.6449 * stated.errors, rtol=1e-4)


def test_albedo_times_light_is_undetermined() -> None:
    """Under a lamp of unknown brightness, with one bounce, only the product of paint and light is seen."""
    scene = djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "perspective",
                "to_world": djpt.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 6, "height": 6, "rfilter": {"type": "box"}},
            },
            "floor": {
                "type": "rectangle",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5] * 3}},
            },
            "lamp": {"type": "point", "position": [0, 0, 2], "intensity": {"type": "rgb", "value": [4.0] * 3}},
        }
    )
    keys = ["floor.bsdf.reflectance.value", "lamp.intensity.value"]
    found = confidence(scene, keys, [djpt.render(scene, spp=4)], spp=4, gradients=4)
    assert len(found.undetermined) == 3
    assert np.isinf(found.errors).all()
    assert "undetermined" in str(found)
    # More of the one is less of the other: a change in proportion.
    for combination in found.undetermined:
        paint, light = (np.array([combination[f"{key}[{i}]"] for i in range(3)]) for key in keys)
        assert np.allclose(paint / 0.5, -light / 4.0, atol=1e-3)


@pytest.mark.slow
def test_intervals_of_searches_in_noisy_pictures_hold() -> None:
    """Ninety per cent of the intervals of a paint contain it, over 100 searches in pictures with noise of their own."""
    scene = floor(size=8)
    exact = np.array(pictures(scene, 2048)[0])
    rng, noise, steps = np.random.default_rng(0), 0.1, 8
    ends, widths = [], []
    for run in range(100):
        targets = [djpt.TensorXf((exact + rng.normal(0, noise, exact.shape)).astype(np.float32))]
        found = optimize(
            grey(scene), KEY, targets, optimizer="gauss_newton", iterations=steps, spp=32, rate=1.0, seed=run
        )
        ends.append(found.average[KEY].ravel())
        if run % 20 == 0:
            djpt.traverse(scene).update({KEY: djpt.Color3f(*ends[-1].tolist())})
            stated = confidence(
                scene, [KEY], targets, spp=32, gradients=8, averaged=steps // 4, noise="residual" if run else noise
            )
        widths.append(stated.half_widths(0.9))
    share = covered(np.array(ends), TRUTH, np.array(widths))
    print(f"{share:.1f} of 100 intervals hold")
    assert 85 <= share <= 95


# ---------------------------------------------------------------- many numbers, and priors


def jacobian(problem: Linearized) -> np.ndarray:
    """The derivatives of all pixels, over the root of their number."""
    columns = [
        np.concatenate([problem.forward(view, unit, 0).ravel() for view in problem.pictures])
        for unit in np.eye(problem.count)
    ]
    return np.stack(columns, axis=1) / np.sqrt(len(columns[0]))


@pytest.mark.slow
@pytest.mark.parametrize("texels", [4, 8])
def test_intervals_with_a_prior_hold(texels: int) -> None:
    """Textures drawn from what the prior stands for, found in noisy pictures: 48 numbers in full, 192 by samples."""
    flat = np.full((texels, texels, 3), 0.5)
    scene = floor(texture(flat))
    noise, weight = 0.05, 0.02
    targets = [np.array(pictures(scene, 64)[0])]
    stated = confidence(
        scene,
        [TEXELS],
        targets,
        spp=32,
        gradients=16,
        averaged=1000,
        noise=noise,
        priors={TEXELS: ("smooth", weight)},
    )
    views = {view: np.array(target, np.float64) for view, target in enumerate(targets)}
    problem = Linearized(scene, djpt.traverse(scene), [TEXELS], views, 64, {TEXELS: ("smooth", weight)})
    slopes, pixels = jacobian(problem), sum(target.size for target in targets)
    bend = np.stack([problem.prior_product(unit) for unit in np.eye(problem.count)], axis=1)
    values, vectors = np.linalg.eigh((bend + bend.T) / 2)
    # The mean of a texture has no prior: it is known.
    wide = np.where(values > 1e-3 * values[-1], values, np.inf)
    rng, curvature = np.random.default_rng(1), 2 * slopes.T @ slopes + bend
    errors = []
    for _ in range(100):
        change = vectors @ (rng.normal(size=len(wide)) * np.sqrt(2 * noise**2 / pixels / wide))
        shaken = slopes.T @ rng.normal(0, noise, len(slopes)) / np.sqrt(pixels)
        seen = np.isfinite(stated.errors)
        found = np.linalg.solve(curvature + 1e-12 * np.eye(len(bend)), 2 * slopes.T @ (slopes @ change) + 2 * shaken)
        errors.append((found - change)[seen])
    share = covered(np.array(errors), np.zeros(seen.sum()), stated.half_widths(0.9)[seen])
    print(f"{share:.1f} of 100 intervals hold, of {len(bend)} numbers")
    assert 85 <= share <= 95


@pytest.mark.slow
def test_both_ways_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = floor(texture(np.full((3, 3, 3), 0.5)), size=8)
    targets, options = pictures(scene, 4), {"spp": 4, "gradients": 24, "noise": 0.1, "averaged": 100}
    whole = confidence(scene, [TEXELS], targets, **options)  # type: ignore[arg-type]
    monkeypatch.setattr(sys.modules[confidence.__module__], "MOST", 8)
    sampled = confidence(scene, [TEXELS], targets, **options)  # type: ignore[arg-type]
    assert 0.75 < np.median(sampled.errors / whole.errors) < 1.25
    assert not sampled.curvatures.size and np.isnan(sampled.condition) and "27 numbers" in str(sampled)


def test_products_with_priors_are_their_second_derivatives() -> None:
    scene = floor(texture(np.random.default_rng(0).uniform(0.2, 0.8, (3, 3, 1))), size=4)
    problem = Linearized(scene, djpt.traverse(scene), [TEXELS], {}, 1, {TEXELS: ("smooth", 2.0)})
    v = np.random.default_rng(1).normal(size=9)
    tensor = djpt.TensorXf(v.reshape(3, 3, 1).astype(np.float32))
    value = float(smoothness(tensor).numpy().item())
    assert np.isclose(v @ problem.prior_product(v), 2 * 2.0 * value, rtol=1e-3)
    root = problem.prior_root(v)
    assert np.isclose(root @ root, 2 * 2.0 * value, rtol=1e-3)


def test_what_confidence_refuses() -> None:
    scene = floor()
    targets: list[Any] = pictures(scene, 1)
    with pytest.raises(ParameterError, match="at least one parameter"):
        confidence(scene, [], targets)
    with pytest.raises(ParameterError, match="'priors' is given for 'x', not one of the keys"):
        confidence(scene, [KEY], targets, priors={"x": ("smooth", 1.0)})
    with pytest.raises(RenderError, match="2 gradients or more, found 1"):
        confidence(scene, [KEY], targets, gradients=1)
    with pytest.raises(RenderError, match="'residual', found 'much'"):
        confidence(scene, [KEY], targets, noise="much")
    with pytest.raises(RenderError, match="1 arrays for 2 views"):
        confidence(scene, [KEY], targets, noise=[0.1])
    with pytest.raises(RenderError, match="must be finite"):
        confidence(scene, [KEY], targets, noise=float("nan"))
    empty = np.empty(0)
    with pytest.raises(RenderError, match="between 0 and 1, found 1"):
        Confidence((), empty, empty, np.empty((0, 0))).half_widths(1)
    dr.sync_thread()

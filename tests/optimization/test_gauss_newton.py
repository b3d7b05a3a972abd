"""Gauss-Newton steps: curvatures and minima of linear problems in closed form, and searches that need few renders."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.apps.optimization import GaussNewton, optimize
from djpt.apps.optimization.gauss_newton import Curvatures, majorant
from djpt.apps.optimization.losses import LOSSES, PRIORS, RESIDUALS, curvature_of
from djpt.errors import FileError, ParameterError, RenderError
from tests.optimization.test_optimize import KEY, TRUTH, floor, grey, pictures, texture

RNG = np.random.default_rng(1)
MATRIX = RNG.uniform(0.1, 1, (12, 4)) + 2 * np.eye(12, 4)
RIGHT = RNG.uniform(0, 2, 12)


def product(matrix: np.ndarray, x: Any) -> Any:
    """A matrix times a variable, attached to it."""
    columns = [djpt.Float(column.astype(np.float32)) for column in matrix.T]
    return sum(column * dr.gather(djpt.Float, x, i) for i, column in enumerate(columns))


def linear(x: Mapping[str, Any]) -> Any:
    return product(MATRIX, x["x"]) - djpt.Float(RIGHT.astype(np.float32))


def start(rate: float = 1.6, momentum: float = 0.3) -> GaussNewton:
    optimizer = GaussNewton(rate, {"x": djpt.Float([0.0] * 4)}, momentum=momentum)
    optimizer.measure(linear)
    return optimizer


def descend(optimizer: GaussNewton) -> float:
    loss = dr.mean(dr.square(linear(optimizer)))
    dr.backward(loss)
    optimizer.step()
    return float(loss[0])


# ---------------------------------------------------------------- linear problems


def test_the_minimum_of_a_linear_problem_is_found() -> None:
    optimizer = start()
    for _ in range(40):
        descend(optimizer)
    assert np.allclose(optimizer["x"].numpy(), np.linalg.lstsq(MATRIX, RIGHT, rcond=None)[0], atol=1e-4)


def test_one_number_needs_one_step() -> None:
    optimizer = GaussNewton(1.0, {"x": djpt.Float(0.0)}, momentum=0.0)

    def residual(x: Mapping[str, Any]) -> Any:
        return x["x"] * djpt.Float([1, -2, 3]) - djpt.Float([0.5, -1, 1.5])

    optimizer.measure(residual)
    dr.backward(dr.mean(dr.square(residual(optimizer))))
    optimizer.step()
    # A hundredth is damping.
    assert np.isclose(optimizer["x"].numpy().item(), 0.5 / 1.01, rtol=1e-5)


def test_steps_of_rate_one_never_raise_the_loss() -> None:
    optimizer = start(1.0, 0.0)
    losses = [descend(optimizer) for _ in range(12)]
    assert np.all(np.diff(losses) < 0)


def test_the_bound_is_that_of_absolute_values() -> None:
    found = majorant({"x": djpt.Float([0.0] * 4)}, linear, {})["x"]
    exact = 2 * MATRIX.T @ MATRIX / len(MATRIX)
    assert np.allclose(found, 2 * MATRIX.T @ MATRIX.sum(axis=1) / len(MATRIX), rtol=1e-5)
    assert np.linalg.eigvalsh(np.diag(found) - exact)[0] > -1e-5


def test_the_bound_knows_of_opposite_signs_and_of_units() -> None:
    """What raises and what lowers a residual together: |J| and not J is summed up, weighted by the scales."""
    up, down = RNG.uniform(0.1, 1, (12, 1)), RNG.uniform(0.1, 1, (12, 1))

    def residual(x: Mapping[str, Any]) -> Any:
        return product(up, x["up"]) - product(down, x["down"])

    found = majorant({"up": djpt.Float(0.0), "down": djpt.Float(0.0)}, residual, {"down": 10.0})
    reach = up + 10 * down
    assert np.allclose(found["up"], 2 * np.mean(up * reach), rtol=1e-5)
    assert np.allclose(found["down"], 2 * np.mean(down * reach) / 10, rtol=1e-5)


def test_growing_curvature_is_noticed() -> None:
    optimizer = start()
    assert optimizer.growth() == 0
    descend(optimizer)
    dr.backward(dr.mean(dr.square(linear(optimizer))))
    assert 0 < optimizer.growth() <= 1
    dr.backward(3 * dr.mean(dr.square(linear(optimizer))))
    assert optimizer.growth() > 1.5


@pytest.mark.parametrize("entries", [12, 40])
@pytest.mark.parametrize("bent", [False, True])
def test_derivatives_of_different_signs_never_diverge(entries: int, bent: bool) -> None:
    matrix = np.random.default_rng(entries).normal(0, 1, (60, entries))
    truth = np.random.default_rng(5).normal(0, 1, entries)
    rows, column = djpt.Float(matrix.ravel().astype(np.float32)), dr.arange(djpt.UInt32, matrix.size) % entries

    def values(x: Any) -> Any:
        linear = dr.block_sum(rows * dr.gather(djpt.Float, x, column), entries)
        return 2 * dr.sin(linear / 2) if bent else linear

    wanted = dr.detach(values(djpt.Float(truth.astype(np.float32))))
    # A search that jumps back and forth enlarges differences of rounding, which are those of sums by several threads.
    for start in 3e-7 * np.random.default_rng(4).normal(size=(8, entries)):
        optimizer = GaussNewton(params={"x": djpt.Float(start.astype(np.float32))})
        optimizer.measure(lambda x: values(x["x"]) - wanted)
        losses = []
        for _ in range(60):
            loss = dr.mean(dr.square(values(optimizer["x"]) - wanted))
            dr.backward(loss)
            optimizer.step(loss)
            losses.append(float(loss[0]))
        lowest = np.minimum.accumulate(losses)
        assert np.all(np.isfinite(losses)) and lowest[-1] < 0.4 * losses[0] and losses[-1] < 4 * lowest[-1]


def test_a_step_that_raised_the_loss_is_taken_back() -> None:
    optimizer = GaussNewton(1.0, {"x": djpt.Float(1.0)}, momentum=0.0)
    optimizer.measure(lambda x: x["x"])

    def step(loss: Any) -> float:
        dr.backward(loss)
        optimizer.step(loss)
        return float(optimizer["x"].numpy().item())

    # Steps are made for a curvature of 2, and it is 20.
    away = step(10 * dr.square(optimizer["x"]))
    assert away < -5
    back = step(10 * dr.square(optimizer["x"]))
    assert abs(back) < 1 and optimizer.damping >= 4
    assert abs(step(10 * dr.square(optimizer["x"]))) < abs(back)
    before = optimizer.damping
    assert np.isfinite(step(optimizer["x"] * np.nan)) and optimizer.damping > before


def test_messages_of_the_optimizer() -> None:
    with pytest.raises(RenderError, match="'momentum' must be in"):
        GaussNewton(momentum=1.0)
    optimizer = GaussNewton(params={"x": djpt.Float([0.0] * 4)})
    with pytest.raises(RenderError, match="call 'measure'"):
        optimizer.step()


# ---------------------------------------------------------------- searches


@pytest.mark.parametrize("loss", RESIDUALS)
@pytest.mark.sparse(4)
def test_an_albedo_is_found_in_eight_steps(loss: str) -> None:
    scene = floor()
    targets = pictures(scene)
    found = optimize(grey(scene), KEY, targets, loss=loss, optimizer="gauss_newton", iterations=8, spp=32, rate=1.0)
    assert np.allclose(found.average[KEY].ravel(), TRUTH, atol=0.03)


def test_losses_are_the_squares_of_their_residuals() -> None:
    image, target = (djpt.TensorXf(RNG.uniform(0.1, 2, (2, 3, 3)).astype(np.float32)) for _ in range(2))
    for name, residual in RESIDUALS.items():
        squares = np.square(residual(image, target).numpy()).mean()
        assert np.isclose(LOSSES[name](image, target).numpy().item(), squares, rtol=1e-5)


@pytest.mark.slow
def test_a_texture_is_found_as_adam_finds_it() -> None:
    truth = np.random.default_rng(0).uniform(0.2, 0.8, (4, 4, 3))
    scene, key = floor(texture(truth)), "paint.reflectance.data"
    targets = pictures(scene)
    ends = []
    for options in ({"optimizer": "gauss_newton", "iterations": 10}, {"iterations": 60, "rate": 0.05}):
        djpt.traverse(scene).update({key: djpt.TensorXf(np.full((4, 4, 3), 0.5, np.float32))})
        ends.append(optimize(scene, key, targets, spp=16, **options).average[key])
    assert np.abs(ends[0] - truth).mean() < 0.03
    assert np.abs(ends[0] - ends[1]).mean() < 0.03


@pytest.mark.parametrize("keeping", ["projection", pytest.param("sigmoid", marks=pytest.mark.slow)])
def test_bounds_priors_minibatches_and_coarse_textures(keeping: str) -> None:
    truth = np.random.default_rng(0).uniform(0.2, 0.8, (2, 2, 3)).repeat(2, 0).repeat(2, 1)
    scene, key = floor(texture(truth)), "paint.reflectance.data"
    targets = pictures(scene)
    ball = "ball.bsdf.reflectance.value"
    djpt.traverse(scene).update({key: djpt.TensorXf(np.full((4, 4, 3), 0.5, np.float32)), ball: djpt.Color3f(0.3)})
    found = optimize(
        scene,
        [key, ball],
        targets,
        optimizer="gauss_newton",
        iterations=24,
        batch=1,
        bounds={key: (0.0, 0.6)},
        keeping=keeping,
        priors={key: ("tv", 1e-4)},
        coarse={key: 1},
        spp=lambda i: 8 if i < 12 else 16,
    )
    assert np.max(np.array(found.values[key])) <= 0.6
    assert np.abs(found.average[key] - np.minimum(truth, 0.6)).mean() < 0.05
    assert np.allclose(found.average[ball], 0.5, atol=0.1)


@pytest.mark.slow
def test_the_paints_of_the_cornell_box_are_found() -> None:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=16, height=16)
    scene = djpt.load_dict(description)
    params, keys = djpt.traverse(scene), [f"{name}.reflectance.value" for name in ("red", "green", "white")]
    truth = {key: np.array(params[key]).ravel() for key in keys}
    target = djpt.render(scene, spp=1024, seed=1000)
    params.update({key: djpt.Color3f(0.5) for key in keys})
    found = optimize(scene, keys, [target], optimizer="gauss_newton", iterations=24, spp=32, rate=1.0, seed=1)
    for key in keys:
        assert np.allclose(found.average[key].ravel(), truth[key], atol=0.08)


def test_a_search_goes_on_from_its_checkpoint(tmp_path: Path) -> None:
    targets, file = pictures(floor(), 64), tmp_path / "search.npz"
    options: dict[str, Any] = {"optimizer": "gauss_newton", "iterations": 14, "spp": 4, "seed": 3, "batch": 1}
    whole = optimize(grey(floor()), KEY, targets, **options)

    class Ended(Exception):
        pass

    def end(done: Any) -> None:
        if done.iteration == 11:
            raise Ended

    with pytest.raises(Ended):
        optimize(grey(floor()), KEY, targets, checkpoint=file, callback=end, **options)
    with pytest.raises(FileError, match="another optimisation"):
        optimize(grey(floor()), KEY, targets, checkpoint=file, **{**options, "optimizer": "adam"})
    resumed = optimize(grey(floor()), KEY, targets, checkpoint=file, **options)
    assert np.array_equal(np.array(resumed.values[KEY]), np.array(whole.values[KEY]))
    assert resumed.losses == whole.losses


def test_what_does_not_fit_is_refused() -> None:
    scene = floor()
    targets = pictures(scene, 1)
    newton: dict[str, Any] = {"optimizer": "gauss_newton"}
    with pytest.raises(
        RenderError, match=r"needs a sum of squares as its loss \(l2, relative, log\), found 'l1'; 'adam' takes"
    ):
        optimize(scene, KEY, targets, loss="l1", **newton)
    with pytest.raises(RenderError, match="found a function"):
        optimize(scene, KEY, targets, loss=lambda a, b: dr.mean(a - b, axis=None), **newton)
    with pytest.raises(ParameterError, match="supports only the priors 'smooth' and 'tv', found a function"):
        optimize(scene, KEY, targets, priors={KEY: (lambda p: dr.sum(p), 1.0)}, **newton)
    with pytest.raises(RenderError, match="did you mean 'gauss_newton'"):
        optimize(scene, KEY, targets, optimizer="gauss_neuton")


# ---------------------------------------------------------------- parts


@pytest.mark.parametrize("name", PRIORS)
def test_curvatures_of_priors_are_bounds(name: str) -> None:
    """Around any texture, the parabola of the bound lies above the prior."""
    texels = RNG.uniform(0, 1, (3, 4, 2))
    tensor = djpt.TensorXf(texels.astype(np.float32))
    dr.enable_grad(tensor)
    value = PRIORS[name](tensor)
    dr.backward(value)
    slope, bend = tensor.grad.numpy(), curvature_of(name)(texels)
    for size in (1e-2, 0.1, 1):
        step = RNG.normal(0, size, texels.shape)
        moved = PRIORS[name](djpt.TensorXf((texels + step).astype(np.float32))).numpy().item()
        assert moved <= value.numpy().item() + np.sum(slope * step) + 0.5 * np.sum(bend * step**2) + 1e-6


def test_curvatures_of_views() -> None:
    bounds = {3: np.array([1.0, 4.0]), 5: np.array([3.0, 0.0]), 7: np.array([2.0, 0.0])}
    asked: list[tuple[int, int]] = []

    def measured(view: int, number: int) -> dict[str, np.ndarray]:
        asked.append((view, number))
        return {"x": bounds[view]}

    curvatures = Curvatures([3, 5, 7], measured)
    found, fresh = curvatures.of([3, 5, 7])
    assert fresh and np.allclose(found["x"], [2, 4 / 3])
    found, fresh = curvatures.of([3])
    assert not fresh and np.allclose(found["x"], [3, 4]) and asked == [(3, 0), (5, 1), (7, 2)]
    again = Curvatures([3, 5, 7], measured)
    again.restore(curvatures.arrays())
    for _ in range(7):
        last = again.of([3])
    assert last[1] and asked[-1] == (3, 3)
    again.forget()
    assert again.of([5, 7])[1] and asked[-2:] == [(5, 4), (7, 5)]

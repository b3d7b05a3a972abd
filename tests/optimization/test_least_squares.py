"""Damped Gauss-Newton steps: minima in closed form, with mixed signs, noise and bounds."""

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.apps.optimization import least_squares
from djpt.apps.optimization.least_squares import Dense, Problem
from djpt.apps.optimization.passes import Passes, halved
from djpt.errors import RenderError


def linear(matrix: np.ndarray, right: np.ndarray, noise: float = 0.0) -> Callable[[Any, int], Any]:
    """The residuals of a linear problem, with noise of their own in images and derivatives."""
    rows = djpt.Float(matrix.ravel().astype(np.float32))
    column = dr.arange(djpt.UInt32, matrix.size) % matrix.shape[1]

    def residual(x: Any, seed: int) -> Any:
        shaken = djpt.Float(np.random.default_rng([seed, 1]).normal(0, noise, len(right)).astype(np.float32))
        return dr.block_sum(rows * dr.gather(djpt.Float, x["x"], column), matrix.shape[1]) - djpt.Float(right) + shaken

    return residual


@pytest.mark.parametrize("entries", [5, 40])
def test_the_minimum_of_a_linear_problem(entries: int) -> None:
    rng = np.random.default_rng(entries)
    matrix, right = rng.normal(0, 1, (120, entries)), rng.normal(0, 1, 120).astype(np.float32)
    found = least_squares(linear(matrix, right), {"x": dr.zeros(djpt.Float, entries)}, iterations=12, damping=1e-4)
    assert np.allclose(found.values["x"].numpy(), np.linalg.lstsq(matrix, right, rcond=None)[0], atol=2e-3)
    assert found.losses[-1] <= found.losses[0]


def test_noise_doesnt_move_the_minimum() -> None:
    rng = np.random.default_rng(3)
    matrix, truth = rng.normal(0, 1, (200, 4)), np.array([0.5, -1.0, 2.0, 0.0])
    residual = linear(matrix, (matrix @ truth).astype(np.float32), 0.5)
    found = least_squares(residual, {"x": dr.zeros(djpt.Float, 4)}, iterations=40)
    assert np.allclose(found.average["x"], truth, atol=0.06)


def test_bounds_and_the_end_by_the_callback() -> None:
    seen: list[float] = []

    def seeing(i: int, loss: float, x: Any) -> bool:
        seen.append(loss)
        return i == 2

    def residual(x: Any, seed: int) -> Any:
        return x["x"] - djpt.Float([3.0, -3.0])

    found = least_squares(residual, {"x": djpt.Float([0, 0])}, bounds={"x": (-1, 1)}, callback=seeing)
    assert np.allclose(found.values["x"].numpy(), [1, -1]) and len(seen) == 3


def test_coarse_images_come_first() -> None:
    def residual(x: Any, seed: int) -> Any:
        return djpt.TensorXf(dr.repeat(x["x"], 60), (4, 5, 3)) - 1

    image = residual({"x": djpt.Float(3.0)}, 0)
    assert halved(image).shape == (2, 2, 3) and np.allclose(halved(image).numpy(), 2)
    found = least_squares(residual, {"x": djpt.Float(3.0)}, iterations=6, coarse=2, damping=1e-4)
    assert np.isclose(found.values["x"].numpy().item(), 1, atol=1e-3)


def test_what_is_refused() -> None:
    with pytest.raises(RenderError, match="don't depend on the variables"):
        least_squares(lambda x, seed: djpt.Float([1.0, 2.0]), {"x": djpt.Float([0, 0])})
    with pytest.raises(RenderError, match="aren't finite at the start"):
        least_squares(lambda x, seed: x["x"] / 0, {"x": djpt.Float([0, 0])})


def test_differences_know_of_edges() -> None:
    """The end of a bar of whole pixels jumps and has no derivative; images on both sides of it tell where it goes."""
    place = (np.arange(64, dtype=np.float32) + 0.5) / 64

    def residual(x: Any, seed: int) -> Any:
        noise = np.random.default_rng(seed).uniform(-0.5, 0.5, (16, 64)).astype(np.float32) / 64
        ends = djpt.TensorXf((place + noise).reshape(16, 64, 1))
        end = djpt.TensorXf(dr.repeat(x["end"], 1024), (16, 64, 1))
        wanted = djpt.TensorXf(np.broadcast_to((place < 0.3).astype(np.float32)[None, :, None], (16, 64, 1)))
        return dr.select(ends < end, djpt.TensorXf(np.ones((16, 64, 1), np.float32)), 0) - wanted

    found = least_squares(residual, {"end": djpt.Float(0.75)}, differences={"end": 0.2}, coarse=2, iterations=12)
    assert abs(found.average["end"].item() - 0.3) < 0.02
    with pytest.raises(RenderError, match="'differences' is given for 'start', not one of the variables"):
        least_squares(residual, {"end": djpt.Float(0.75)}, differences={"start": 0.2})


TEXELS = np.random.default_rng(1).uniform(0.2, 0.8, (3, 3, 1)).astype(np.float32)


def painted() -> tuple[djpt.Scene, Callable[[Any, Any], Any]]:
    """A rectangle with a texture of 3 x 3 texels, and its image in 8 x 8 pixels by the texels and a seed."""
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    paint = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": TEXELS, "raw": True}}
    place = djpt.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    scene = djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "prb", "max_depth": 2},
            "sensor": {"type": "perspective", "fov": 40, "to_world": place, "film": film},
            "floor": {"type": "rectangle", "bsdf": paint},
            "light": {"type": "constant"},
        }
    )

    def image(variables: Any, seed: Any) -> Any:
        params = djpt.traverse(scene)
        params["floor.bsdf.reflectance.data"] = variables["x"]
        params.update()
        return djpt.render(scene, params, spp=2, seed=seed)

    return scene, image


def test_frozen_functions_give_the_same_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A texture of 3 x 3 texels of a rectangle, with 4 images averaged in the end."""
    _, image = painted()
    target, recorded, freeze = image({"x": djpt.TensorXf(TEXELS)}, 99), list[Any](), dr.freeze

    def residual(variables: Any, seed: Any) -> Any:
        return image(variables, seed) - target

    def frozen_ones(*arguments: Any, **options: Any) -> Any:
        recorded.append(freeze(*arguments, **options))
        return recorded[-1]

    monkeypatch.setattr(dr, "freeze", frozen_ones)
    start = {"x": djpt.TensorXf(np.full_like(TEXELS, 0.5))}
    plain, frozen = (
        least_squares(residual, start, iterations=4, bounds={"x": (0, 1)}, frozen=frozen) for frozen in (False, True)
    )
    assert np.allclose(plain.losses, frozen.losses, rtol=1e-4) and plain.taken_back == frozen.taken_back
    assert np.allclose(plain.average["x"], frozen.average["x"], atol=1e-4)
    assert np.abs(frozen.average["x"] - TEXELS).mean() < 0.6 * np.abs(0.5 - TEXELS).mean()
    # The scene is met as it was loaded and as it was left; neither other memory nor attached values are news.
    assert len(recorded) == 5 and max(one.n_recordings for one in recorded) <= 2


def test_images_with_unfiltered_channels_are_known() -> None:
    """Such channels are computed each time, beside those that are known."""
    scene, _ = painted()
    aovs = {"type": "aov", "aovs": "z:depth", "unfiltered": True, "light": {"type": "prb", "max_depth": 2}}
    integrator = djpt.load_dict(aovs)

    def image(variables: Any, seed: Any) -> Any:
        params = djpt.traverse(scene)
        params["floor.bsdf.reflectance.data"] = variables["x"]
        params.update()
        return djpt.render(scene, params, integrator=integrator, spp=2, seed=seed)

    passes, x = Passes(image, False), {"x": djpt.TensorXf(TEXELS)}
    found, images = passes.residuals(x, 1, 0)
    assert found.shape == (8, 8, 4) and [one.shape for one in images.values()] == [(8, 8, 3)]
    known, other = (passes.linear(x, these, 2, 0).forward(x).numpy() for these in (images, {}))
    np.testing.assert_array_equal(known, other)
    assert known.any()


@pytest.mark.parametrize("frozen", [False, True])
def test_derivatives_take_images_that_are_known(frozen: bool) -> None:
    """By the chain rule, the derivative of squares is twice the known image times its own derivative."""
    _, image = painted()
    passes = Passes(lambda variables, seed: dr.square(image(variables, seed)), frozen)
    plain = Passes(image, frozen)
    at, way = np.full_like(TEXELS, 0.5), np.linspace(-1, 1, 9, dtype=np.float32).reshape(3, 3, 1)

    def x(array: np.ndarray) -> dict[str, Any]:
        return {"x": djpt.TensorXf(array)}

    squares, images = passes.residuals(x(at), 1, 0)
    (known,) = images.values()
    assert np.allclose(squares.numpy(), known.numpy() ** 2)
    slope = plain.linear(x(at), {}, 2, 0).forward(x(way)).numpy()
    assert np.allclose(passes.linear(x(at), images, 2, 0).forward(x(way)).numpy(), 2 * known.numpy() * slope, rtol=1e-4)
    unknown = passes.linear(x(at), {}, 2, 0).forward(x(way)).numpy()
    assert not np.allclose(unknown, 2 * known.numpy() * slope, rtol=1e-4), "an image of seed 2"

    weights = djpt.TensorXf(np.random.default_rng(5).normal(0, 1, (8, 8, 3)).astype(np.float32))
    found = passes.linear(x(at), images, 2, 0).reverse(weights)["x"].numpy()
    expected = plain.linear(x(at), {}, 2, 0).reverse(weights * 2 * known)["x"].numpy()
    assert np.allclose(found, expected, rtol=1e-3, atol=1e-5)


def test_products_of_earlier_steps_serve_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """J^T J of a linear problem is the same everywhere: with products of earlier steps fewer new ones get further."""
    rng = np.random.default_rng(8)
    left, _, turned = np.linalg.svd(rng.normal(0, 1, (120, 30)), full_matrices=False)
    matrix, right = left @ np.diag(np.logspace(1, 0, 30)) @ turned, rng.normal(0, 1, 120).astype(np.float32)
    best, errors, counts = matrix @ np.linalg.lstsq(matrix, right, rcond=None)[0], list[float](), list[int]()
    for forgetful in (False, True):
        problem = Problem(Passes(linear(matrix, right), False), {"x": dr.zeros(djpt.Float, 30)}, {}, {})
        products = list[Any]()
        monkeypatch.setattr(problem, "normal", lambda *a, f=problem.normal, p=products: p.append(a) or f(*a))
        x = problem.start
        for i in range(7):
            if forgetful:
                problem.products.clear()
            x = x + problem.system(x, problem.residuals(x, i), i, 1e-6).step(1e-6)
        errors.append(float(np.linalg.norm(matrix @ x - best) / np.linalg.norm(best)))
        counts.append(len(products))
    assert errors[0] < min(1e-4, 0.1 * errors[1]) and counts[0] < 0.8 * counts[1]


def test_columns_of_the_step_before_are_the_second_estimate() -> None:
    """The product of a noisy estimate with itself is too large by its variance; that of two of them isn't."""
    rng, count, noise = np.random.default_rng(2), 200, 0.7
    matrix = rng.normal(0, 1, (count, 3))
    column = dr.arange(djpt.UInt32, matrix.size) % 3

    def residual(x: Any, seed: int) -> Any:
        shaken = matrix + np.random.default_rng(seed).normal(0, noise, matrix.shape)
        rows = djpt.Float(shaken.ravel().astype(np.float32))
        return dr.block_sum(rows * dr.gather(djpt.Float, x["x"], column), 3) - 1

    problem = Problem(Passes(residual, False), {"x": dr.zeros(djpt.Float, 3)}, {}, {})
    found = []
    for i in range(41):
        system = problem.system(problem.start, problem.residuals(problem.start, i), i, 1e-2)
        assert isinstance(system, Dense)
        found.append(np.trace(system.normal) / np.sum(np.square(matrix)))
    # One estimate is too large by 0.49, the mean of products of two by nothing.
    assert abs(found[0] - 1.49) < 0.25 and abs(np.mean(found[1:]) - 1) < 0.06


def test_differences_serve_again_after_steps_that_went_well() -> None:
    """The first step takes two images for each of four numbers and two more, the next ones only the latter."""
    rng = np.random.default_rng(4)
    matrix, truth = rng.normal(0, 1, (40, 4)).astype(np.float32), rng.normal(0, 1, 4).astype(np.float32)
    rows, column, calls = djpt.Float(matrix.ravel()), dr.arange(djpt.UInt32, matrix.size) % 4, list[int]()

    def bent(x: Any) -> Any:
        product = dr.block_sum(rows * dr.gather(djpt.Float, x, column), 4)
        return product + 0.05 * dr.square(product)

    wanted, counts, losses = bent(djpt.Float(truth)), list[int](), list[float]()

    def residual(x: Any, seed: int) -> Any:
        calls.append(seed)
        return bent(x["x"]) - wanted

    def seen(i: int, loss: float, x: Any) -> None:
        counts.append(len(calls))
        losses.append(loss)
        calls.clear()

    start = {"x": dr.zeros(djpt.Float, 4)}
    found = least_squares(residual, start, differences={"x": 0.01}, iterations=4, images=1, callback=seen)
    assert counts[:3] == [10, 2, 2] and losses[3] < 1e-3 * losses[0]
    assert np.allclose(np.array(found.values["x"]), truth, atol=0.02)


@pytest.mark.parametrize("frozen", [False, True])
def test_means_over_steps_have_less_noise(frozen: bool) -> None:
    """Of a place that is approached, the gradient is that of many samples, with less noise than that of one step."""
    _, image = painted()
    target = image({"x": djpt.TensorXf(TEXELS)}, 99)
    problem = Problem(Passes(lambda x, seed: image(x, seed) - target, frozen), {"x": djpt.TensorXf(TEXELS)}, {}, {})
    x, slopes = problem.start * 0.9, list[tuple[Any, Any]]()
    for row in range(8):
        problem.means_before, problem.noise = None, 0.0
        for k in range(6):
            place, number = x - (5 - k) * 0.004, 10 * row + k
            before = problem.residuals(place, 1000 + number)
            now = problem.residuals(place, number)
            if k:
                problem.noise = float(np.mean(np.square(now - before))) / 2
            mean = problem.slope(place, now, number)
        problem.means_before = None
        slopes.append((mean, problem.slope(x, now, number)))
    means, singles = (np.array(part) for part in zip(*slopes, strict=True))
    reference = np.concatenate([means, singles]).mean(axis=0)
    errors = [float(np.mean(np.square(several - reference))) for several in (means, singles)]
    assert errors[0] < 0.6 * errors[1]
    assert np.linalg.norm(means.mean(axis=0) - singles.mean(axis=0)) < 0.2 * np.linalg.norm(reference)

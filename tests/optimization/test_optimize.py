"""Searches for parameters: albedos and textures from pictures, with bounds, priors, minibatches, checkpoints."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.optimization import optimize
from djpt.apps.optimization.loop import order, refined_at
from djpt.apps.optimization.losses import LOSSES, smoothness, total_variation
from djpt.apps.optimization.variables import Variable, coarse, magnified
from djpt.errors import FileError, ParameterError, RenderError

KEY = "paint.reflectance.value"
TRUTH = np.array([0.7, 0.3, 0.1])


def floor(paint: Any = None, size: int = 12) -> djpt.Scene:
    """A painted floor under a sky, seen from two sides."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    T = djpt.ScalarTransform4f

    def camera(x: float) -> dict[str, Any]:
        to_world = T().look_at([x, -1, 2], [0, 0, 0], [0, 0, 1])
        return {"type": "perspective", "fov": 40, "to_world": to_world, "film": film}

    reflectance = paint or {"type": "rgb", "value": TRUTH.tolist()}
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "left": camera(-1),
            "right": camera(1),
            "sky": {"type": "constant", "radiance": 1.0},
            "paint": {"type": "diffuse", "reflectance": reflectance},
            "floor": {"type": "rectangle", "bsdf": {"type": "ref", "id": "paint"}},
            "ball": {
                "type": "sphere",
                "center": [0, 0.3, 0.3],
                "radius": 0.3,
                "bsdf": {"type": "diffuse", "reflectance": 0.5},
            },
        }
    )


def grey(scene: djpt.Scene) -> djpt.Scene:
    """The scene with a grey paint, where searches start."""
    params = djpt.traverse(scene)
    params.update({KEY: djpt.Color3f(0.4)})
    return scene


def pictures(scene: djpt.Scene, spp: int = 256) -> list[Any]:
    return [djpt.render(scene, sensor=view, spp=spp, seed=100 + view) for view in (0, 1)]


@pytest.mark.sparse(4)
@pytest.mark.parametrize("loss", LOSSES)
def test_an_albedo_is_found(loss: str) -> None:
    scene = floor()
    targets = pictures(scene)
    found = optimize(grey(scene), KEY, targets, loss=loss, iterations=40, spp=16, rate=0.08)
    assert np.allclose(found.average[KEY].ravel(), TRUTH, atol=0.03)
    assert found.iterations == 40
    # The scene has the result.
    assert np.allclose(np.array(djpt.traverse(scene)[KEY]), np.array(found.values[KEY]))


@pytest.mark.slow
def test_a_sigmoid_keeps_bounds() -> None:
    scene = floor()
    targets = pictures(scene)
    options = {"bounds": {KEY: (0.2, 0.6)}, "keeping": "sigmoid", "iterations": 40, "rate": 0.3}
    found = optimize(grey(scene), KEY, targets, **options)  # type: ignore[arg-type]
    red, green, blue = found.average[KEY].ravel()
    assert 0.55 < red < 0.6 and abs(green - 0.3) < 0.03 and 0.2 < blue < 0.25


def test_minibatches_see_every_view() -> None:
    assert sorted(order([3, 5, 7], 0, 3, seed=1)) == [3, 5, 7]
    turns = [order([3, 5, 7], i, 2, seed=1) for i in range(3)]
    assert sorted(itertools.chain(*turns)) == [3, 3, 5, 5, 7, 7]
    scene = floor()
    targets = pictures(scene)
    found = optimize(grey(scene), KEY, targets, batch=1, iterations=60, rate=0.04)
    assert np.allclose(found.average[KEY].ravel(), TRUTH, atol=0.03)


def texture(values: np.ndarray) -> dict[str, Any]:
    return {"type": "bitmap", "data": values.astype(np.float32), "raw": True, "filter_type": "nearest"}


@pytest.mark.slow
def test_a_texture_is_found_from_coarse_to_fine() -> None:
    truth = np.random.default_rng(0).uniform(0.2, 0.8, (2, 2, 3)).repeat(2, 0).repeat(2, 1)
    scene = floor(texture(truth))
    targets = pictures(scene)
    key = "paint.reflectance.data"
    params = djpt.traverse(scene)
    params.update({key: djpt.TensorXf(np.full((4, 4, 3), 0.5, np.float32))})
    shapes = []
    found = optimize(
        scene,
        key,
        targets,
        iterations=60,
        rate=0.05,
        coarse={key: 1},
        priors={key: ("tv", 1e-4)},
        demodulate=True,
        callback=lambda done: shapes.append(np.shape(done.values[key])) or None,
    )
    assert set(shapes) == {(4, 4, 3)}
    assert np.abs(found.average[key] - truth).mean() < 0.06


@pytest.mark.slow
def test_a_search_goes_on_from_its_checkpoint(tmp_path: Path) -> None:
    targets = pictures(floor(), 64)
    options: dict[str, Any] = {"iterations": 20, "spp": 4, "seed": 3}
    whole = optimize(grey(floor()), KEY, targets, **options)
    file = tmp_path / "search.npz"

    class Ended(Exception):
        pass

    def end(done: Any) -> None:
        if done.iteration == 13:
            raise Ended

    with pytest.raises(Ended):
        optimize(grey(floor()), KEY, targets, checkpoint=file, callback=end, **options)
    resumed = optimize(grey(floor()), KEY, targets, checkpoint=file, **options)
    assert np.array_equal(np.array(resumed.values[KEY]), np.array(whole.values[KEY]))
    assert resumed.losses == whole.losses
    assert np.array_equal(resumed.average[KEY], whole.average[KEY])
    with pytest.raises(FileError, match="another optimisation"):
        optimize(grey(floor()), "ball.bsdf.reflectance.value", targets, checkpoint=file, **options)
    file.write_bytes(b"PK")
    with pytest.raises(FileError, match="can't continue from"):
        optimize(grey(floor()), KEY, targets, checkpoint=file, **options)


def test_a_callback_ends_a_search() -> None:
    scene = floor()
    found = optimize(grey(scene), KEY, pictures(scene, 16), spp=1, callback=lambda done: done.iteration == 4)
    assert found.iterations == 5


def test_errors_name_the_cause() -> None:
    scene = floor()
    targets = pictures(scene, 1)
    with pytest.raises(ParameterError, match="unknown parameter"):
        optimize(scene, "paint.colour", targets)
    with pytest.raises(ParameterError, match="has no derivatives"):
        optimize(scene, "left.near_clip", targets)
    with pytest.raises(ParameterError, match="lower bound"):
        optimize(scene, KEY, targets, bounds=(1, 0))
    with pytest.raises(ParameterError, match="sigmoid"):
        optimize(scene, KEY, targets, keeping="sigmoyd")
    with pytest.raises(ParameterError, match="start coarse"):
        optimize(scene, KEY, targets, coarse={KEY: 1})
    with pytest.raises(RenderError, match="unknown loss 'l3'"):
        optimize(scene, KEY, targets, loss="l3")
    with pytest.raises(RenderError, match="unknown optimizer"):
        optimize(scene, KEY, targets, optimizer="adagrad")
    with pytest.raises(RenderError, match="each view needs a target"):
        optimize(scene, KEY, targets, views=[0])
    with pytest.raises(RenderError, match="has shape"):
        optimize(scene, KEY, [np.zeros((3, 3, 3))] * 2)


# ---------------------------------------------------------------- parts


def test_variables_are_inverses_of_parameters() -> None:
    for kind in ("sigmoid", "projection", "free"):
        variable = Variable("x", djpt.Float([0.2, 0.5, 0.9]), (0.0, 1.0), kind)
        assert np.allclose(variable.parameter(variable.start).numpy(), [0.2, 0.5, 0.9], atol=1e-6)


def test_textures_become_coarse_and_fine() -> None:
    texels = np.arange(24.0).reshape(4, 2, 3)
    assert np.array_equal(coarse(texels, 1), texels.reshape(2, 2, 1, 2, 3).mean(axis=(1, 3)))
    constant = djpt.TensorXf(np.full((3, 2, 1), 0.7, np.float32))
    assert np.allclose(magnified(constant, (7, 5, 1)).numpy(), 0.7)
    ramp = djpt.TensorXf(np.linspace(0, 1, 8, dtype=np.float32).reshape(1, 8, 1))
    middle = magnified(ramp, (1, 16, 1)).numpy().ravel()[1:-1]
    assert np.allclose(np.diff(middle), np.diff(middle)[0], atol=1e-6)
    assert refined_at(10, {"t": 1}) == {5}


def test_priors() -> None:
    flat, step = np.zeros((4, 4, 1), np.float32), np.zeros((4, 4, 1), np.float32)
    step[2:] = 1
    for prior in (smoothness, total_variation):
        assert prior(djpt.TensorXf(flat)).numpy().item() < 3e-3
        assert np.isclose(prior(djpt.TensorXf(step)).numpy().item(), 1 / 3, rtol=0.01)
    with pytest.raises(ParameterError, match="textures"):
        smoothness(djpt.Float(1))

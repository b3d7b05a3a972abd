"""Jacobians of images: their products are the derivatives by replay, whatever the parameters."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.rendering.gradients import jacobian
from djpt.rendering.gradients.derivatives import ReplayDerivative
from djpt.rendering.gradients.filter_sampling import Distances, own_samples
from djpt.rendering.gradients.jacobian import KnownDerivative, jacobian_of
from djpt.rendering.known_images import images_linearised, jacobians_collected, jacobians_known
from djpt.rendering.schedules.flat import Flat

TEXELS = np.random.default_rng(1).uniform(0.2, 0.8, (3, 4, 3)).astype(np.float32)


def bitmap(data: np.ndarray) -> dict[str, Any]:
    """A texture."""
    return {"type": "bitmap", "data": data, "raw": True}


METAL = {"type": "principled", "metallic": 0.9, "base_color": {"type": "rgb", "value": [0.8, 0.5, 0.3]}}
BUMPS = {"type": "normalmap", "normalmap": bitmap(TEXELS * 0.2 + np.array([0.4, 0.4, 0.8], np.float32))}
CLOUD = {"type": "heterogeneous", "albedo": 0.5, "sigma_t": {"type": "gridvolume", "data": TEXELS[:, :, :1, None]}}
DATA = "body.bsdf.reflectance.data"
CASES: dict[str, tuple[dict[str, Any], dict[str, Any], list[str]]] = {
    "texture": ({"bsdf": {"type": "diffuse", "reflectance": bitmap(TEXELS)}}, {}, [DATA]),
    "black texture": ({"bsdf": {"type": "diffuse", "reflectance": bitmap(TEXELS * [1, 0, 1])}}, {}, [DATA]),
    "numbers": (
        {"bsdf": METAL},
        {},
        ["body.bsdf.roughness.value", "body.bsdf.base_color.value", "lamp.intensity.value"],
    ),
    "table and number": (
        {"bsdf": {**METAL, "roughness": bitmap(TEXELS[:, :, :1])}},
        {},
        ["body.bsdf.roughness.data", "body.bsdf.metallic.value"],
    ),
    "normal map": ({"bsdf": {**BUMPS, "bsdf": METAL}}, {}, ["body.bsdf.normalmap.data"]),
    "cloud": (
        {"type": "cube", "bsdf": {"type": "null"}, "interior": CLOUD},
        {"type": "prbvolpath", "max_depth": 4},
        ["body.interior_medium.sigma_t.data"],
    ),
}


def scene_of(body: dict[str, Any], integrator: dict[str, Any], **film: Any) -> djpt.Scene:
    """A body over a floor, under a sky and a lamp."""
    place = djpt.ScalarTransform4f().look_at([0, -2, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 6, "height": 5, "rfilter": {"type": "box"}, **film}
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": integrator or {"type": "prb", "max_depth": 3},
            "sensor": {"type": "perspective", "fov": 45, "to_world": place, "film": film},
            "body": {"type": "rectangle", **body},
            "floor": {"type": "rectangle", "to_world": djpt.ScalarTransform4f().translate([0, 0, -1]).scale(3)},
            "sky": {"type": "constant", "radiance": 0.3},
            "lamp": {"type": "point", "position": [1, 1, 3], "intensity": 8.0},
        }
    )


def products(image: Any, leaves: list[Any], rng: np.random.Generator) -> tuple[np.ndarray, list[np.ndarray]]:
    """J v and J^T w, for random v and w."""
    for leaf in leaves:
        dr.set_grad(leaf, type(leaf)(rng.normal(size=leaf.shape).astype(np.float32)))
    dr.enqueue(dr.ADMode.Forward, leaves)
    dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearInterior)
    forward = dr.grad(image).numpy()
    dr.clear_grad([image, leaves])
    dr.set_grad(image, djpt.TensorXf(rng.normal(size=image.shape).astype(np.float32)))
    dr.enqueue(dr.ADMode.Backward, image)
    dr.traverse(dr.ADMode.Backward)
    return forward, [dr.grad(leaf).numpy() for leaf in leaves]


def same_products(scene: djpt.Scene, keys: list[str], spp: int = 4) -> None:
    """Check J v and J^T w of a Jacobian against those by replay."""
    params = djpt.traverse(scene)

    def attached() -> tuple[Any, list[Any]]:
        for key in keys:
            params[key] = type(params[key])(dr.detach(params[key]))
            dr.enable_grad(params[key])
        params.update()
        return djpt.render(scene, params, spp=spp, spp_grad=spp, seed=3), [params[key] for key in keys]

    expected = products(*attached(), np.random.default_rng(7))
    with jacobians_collected() as jacobians:
        attached()
    assert len(jacobians) == 1
    with jacobians_known(jacobians):
        found = products(*attached(), np.random.default_rng(7))
    with images_linearised() as derivatives:
        at_once = products(*attached(), np.random.default_rng(7))
    assert len(derivatives) == 1 and np.abs(expected[0]).max() > 1e-3
    for forward, reverse in (found, at_once):
        np.testing.assert_allclose(forward, expected[0], rtol=1e-3, atol=1e-4 * np.abs(expected[0]).max())
        for one, other in zip(reverse, expected[1], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-4 * np.abs(other).max())


@pytest.mark.parametrize("name", CASES)
def test_products_are_those_of_replay(name: str) -> None:
    body, integrator, keys = CASES[name]
    same_products(scene_of(body, integrator), keys)


def test_channels_of_the_film_are_rows() -> None:
    body, integrator, keys = CASES["texture"]
    same_products(scene_of(body, integrator, pixel_format="rgba"), keys)
    same_products(scene_of(body, integrator, pixel_format="luminance"), keys)


def test_colours_have_a_table_for_each_channel_alone() -> None:
    for name, count in (("texture", 3), ("normal map", 9)):
        body, integrator, (key,) = CASES[name]
        scene = scene_of(body, integrator)
        params = djpt.traverse(scene)
        dr.enable_grad(params[key])
        params.update()
        with jacobians_collected() as jacobians:
            djpt.render(scene, params, spp=1)
        (found,) = jacobians.values()
        assert sum(len(pack.keys) for pack in found.packs) == count


def test_without_a_jacobian_paths_are_replayed(monkeypatch: pytest.MonkeyPatch) -> None:
    """There is none where it would be large."""
    body, integrator, (key,) = CASES["texture"]
    monkeypatch.setattr(jacobian, "LARGEST", 100)
    scene = scene_of(body, integrator)
    params = djpt.traverse(scene)
    dr.enable_grad(params[key])
    params.update()
    with jacobians_collected() as jacobians:
        image = djpt.render(scene, params, spp=2)
    assert not jacobians
    with jacobians_known(jacobians):
        dr.backward(dr.sum(image, axis=None))
    assert dr.grad(params[key]).numpy().any()


# ---- films that filter -----------------------------------------------------------------------

FILTERS: dict[str, dict[str, Any]] = {
    "gaussian": {"rfilter": {"type": "gaussian"}},
    "narrow gaussian": {"rfilter": {"type": "gaussian", "stddev": 0.3}},
    "tent": {"rfilter": {"type": "tent"}},
    "mitchell": {"rfilter": {"type": "mitchell"}},
    "lanczos": {"rfilter": {"type": "lanczos"}},
    "border": {"rfilter": {"type": "gaussian"}, "sample_border": True},
    "crop": {"crop_width": 3, "crop_height": 4, "crop_offset_x": 2, "rfilter": {"type": "catmullrom"}},
}


def linearised(scene: djpt.Scene, key: str, seed: int, spp: int) -> tuple[ReplayDerivative, KnownDerivative]:
    """An image's derivative by replay and by a table."""
    found: list[ReplayDerivative] = []

    def kept(derivative: ReplayDerivative) -> Any:
        found.append(derivative)
        return jacobian_of(derivative)

    params = djpt.traverse(scene)
    dr.enable_grad(params[key])
    params.update()
    with pytest.MonkeyPatch.context() as patch, images_linearised() as derivatives:
        patch.setattr(jacobian, "jacobian_of", kept)
        djpt.render(scene, params, spp=spp, spp_grad=spp, seed=seed)
    return found[0], next(iter(derivatives.values()))


@pytest.mark.parametrize("name", ["gaussian", "narrow gaussian", "tent", "border"])
def test_columns_are_forward_derivatives_of_the_same_samples(name: str) -> None:
    body, integrator, (key,) = CASES["texture"]
    replayed, known = linearised(scene_of(body, integrator, **FILTERS[name]), key, 1, 8)
    job = own_samples(replayed.job)
    assert job is not None
    alone = ReplayDerivative(job, Flat(), replayed.parameters)
    for entry in range(0, TEXELS.size, 5):
        unit = np.zeros(TEXELS.size, np.float32)
        unit[entry] = 1
        tangents = [djpt.TensorXf(unit.reshape(TEXELS.shape))]
        expected, found = (np.array(one.forward(tangents)) for one in (alone, known))
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("name", FILTERS)
def test_the_mean_is_the_derivative_of_the_filtered_image(name: str) -> None:
    """At the edges of the film and without them."""
    body, integrator, (key,) = CASES["texture"]
    scene = scene_of(body, integrator, **FILTERS[name])
    change = [djpt.TensorXf(np.random.default_rng(3).normal(size=TEXELS.shape).astype(np.float32))]
    pairs = [[np.array(d.forward(change)) for d in linearised(scene, key, seed, 512)] for seed in range(16)]
    expected, found = np.moveaxis(np.array(pairs), 1, 0)
    difference = found - expected
    error = difference.std(axis=0) / (len(pairs) - 1) ** 0.5
    assert np.abs(difference.mean(axis=0)).max() < 0.02 * np.abs(expected).max()
    z = difference.mean(axis=0) / (error + 1e-4 * np.abs(expected).max())
    assert np.mean(z**2) < 1.6 and np.abs(z).max() < 6


@pytest.mark.parametrize("rfilter", ["gaussian", "tent", "mitchell", "catmullrom", "lanczos"])
@pytest.mark.parametrize("low, high", [(-3.0, 3.0), (-0.5, 3.0), (-1.5, 0.5)])
def test_distances_are_those_of_the_filter(rfilter: str, low: float, high: float) -> None:
    """Moments of what is drawn between two ends, against sums over the filter."""
    plugin: Any = djpt.load_dict({"type": rfilter})
    low, high = max(low, -plugin.radius()), min(high, plugin.radius())
    distances, ends = Distances(plugin), (djpt.Float(low), djpt.Float(high))
    u = djpt.Float((np.arange(2**16) + 0.5) / 2**16)
    drawn = distances.between(*ends, u)
    weight = np.array(distances.weight(*ends, drawn), np.float64) * np.ones(len(u))
    place = low + (high - low) * (np.arange(2**16) + 0.5) / 2**16
    value = np.array(plugin.eval(djpt.Float(place)), np.float64)
    for power in range(5):
        expected = np.sum(value * place**power) / np.sum(value)
        assert np.mean(weight * np.array(drawn, np.float64) ** power) == pytest.approx(expected, abs=2e-3)


def test_means_of_jacobians() -> None:
    packs = (jacobian.Pack(0, [(0, 0)], djpt.Float(values)) for values in ([1.0, 2.0], [3.0, 6.0]))
    first, second = (jacobian.Jacobian([pack]) for pack in packs)
    assert np.allclose(first.mixed(second, 0.25).packs[0].memory.numpy(), [1.5, 3.0])

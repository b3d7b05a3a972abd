"""Derivatives of images by the extinction of media that vary in space."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt

T = djpt.ScalarTransform4f
KEY = "cube.interior_medium.sigma_t.data"
SKY = (0.5, 0.7, 1.0)


def cloud(data: np.ndarray, **changes: Any) -> dict[str, Any]:
    """A cube of smoke under a sky, with a lamp beside it; 4 x 4 pixels."""
    grid = {"type": "gridvolume", "data": data.astype(np.float32), "to_world": T().translate([-1, -1, -1]).scale(2)}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "prbvolpath"},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": T().look_at([0.3, 0.4, -4], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": list(SKY)}},
        "lamp": {"type": "point", "position": [0, 3, -1], "intensity": 20.0},
        "cube": {
            "type": "cube",
            "bsdf": {"type": "null"},
            "interior": {
                "type": "heterogeneous",
                "sigma_t": grid,
                "albedo": 0.7,
                "phase": {"type": "hg", "g": 0.3},
            },
        },
    }
    scene["cube"]["interior"].update(changes.pop("medium", {}))
    scene.update(changes)
    return {name: value for name, value in scene.items() if value is not None}


def with_holes(channels: int = 1) -> np.ndarray:
    """3 x 3 x 3 numbers, a third of them 0."""
    data = np.random.default_rng(1).uniform(0.3, 2, (3, 3, 3, channels)).astype(np.float32)
    data[1] = 0
    return data


def gradients(scene: Any, key: str, value: Any, spp: int, count: int = 6) -> np.ndarray:
    """Gradients of the mean of the image, one for each of `count` seeds."""
    params, found = djpt.traverse(scene), []
    for seed in range(count):
        attached = type(value)(value)
        dr.enable_grad(attached)
        params[key] = attached
        params.update()
        dr.backward(dr.mean(djpt.render(scene, params, spp=1, spp_grad=spp, seed=seed), axis=None))
        found.append(np.array(dr.grad(attached), np.float64))
    return np.array(found)


def agree(a: np.ndarray, b: np.ndarray | float, within: float = 0.02) -> bool:
    """Whether the means are equal within 4 standard errors or a share of them."""
    of_b = np.atleast_1d(b)
    error = np.sqrt(sum(x.var(ddof=1) / len(x) for x in (a, of_b) if len(x) > 1))
    return bool(abs(a.mean() - of_b.mean()) < max(4 * error, within * abs(of_b.mean())))


def means(scene: Any, key: str, value: np.ndarray, first_seed: int, spp: int = 4096) -> np.ndarray:
    """The mean of the image with a grid, for each of six seeds."""
    params = djpt.traverse(scene)
    params[key] = djpt.TensorXf(value.astype(np.float32))
    params.update()
    return np.array([np.array(djpt.render(scene, spp=spp, seed=first_seed + k), np.float64).mean() for k in range(6)])


@pytest.mark.sparse(8)
@pytest.mark.parametrize("density", [0, 1e-30, 1e-10, 1e-6, 1e-4])
def test_without_matter(density: float) -> None:
    """Hardly any density: more takes light away in proportion to 1 - albedo, since the sky is equal everywhere."""
    scene = djpt.load_dict(cloud(np.full((4, 4, 4), density), lamp=None, medium={"albedo": 0.6}))
    found = gradients(scene, KEY, djpt.TensorXf(np.full((4, 4, 4, 1), density, np.float32)), 512)
    x, y = np.meshgrid(*[((np.arange(400) + 0.5) / 200 - 1) * np.tan(np.radians(20))] * 2)
    origin = np.array([0.3, 0.4, -4])
    forward = -origin / np.linalg.norm(origin)
    right = np.cross([0, 1, 0], forward) / np.linalg.norm(np.cross([0, 1, 0], forward))
    d = forward + x[..., None] * right + y[..., None] * np.cross(forward, right)
    a, b = (-1 - origin) / d, (1 - origin) / d
    lengths = np.clip(np.maximum(a, b).min(-1) - np.minimum(a, b).max(-1), 0, None) * np.linalg.norm(d, axis=-1)
    found = found.sum(axis=(1, 2, 3, 4))
    assert agree(found, -(1 - 0.6) * lengths.mean() * np.mean(SKY))
    assert found.std() < 0.2 * abs(found.mean())


@pytest.mark.parametrize(
    "case", ["grey", *(pytest.param(name, marks=pytest.mark.slow) for name in ("coloured", "channels", "nearest"))]
)
def test_against_differences(case: str) -> None:
    """Where there is matter, by all texels at once."""
    medium: dict[str, Any] = {"albedo": {"type": "rgb", "value": [0.9, 0.6, 0.3]}} if case == "coloured" else {}
    data = with_holes(3 if case == "channels" else 1)
    description = cloud(data, medium=medium)
    if case == "nearest":
        description["cube"]["interior"]["sigma_t"]["filter_type"] = "nearest"
    scene = djpt.load_dict(description)
    change = np.where(data > 0, 0.1, 0)
    found = gradients(scene, KEY, djpt.TensorXf(data), 512)
    difference = means(scene, KEY, data + change, 100) - means(scene, KEY, data - change, 200)
    assert agree((found * change * 2).sum(axis=(1, 2, 3, 4)), difference)


@pytest.mark.slow
def test_against_differences_in_holes() -> None:
    data = with_holes()
    scene = djpt.load_dict(cloud(data))
    change = np.where(data > 0, 0, 0.06)
    found = gradients(scene, KEY, djpt.TensorXf(data), 512)
    steps = [means(scene, KEY, data + k * change, 100 * k, 16384) for k in range(3)]
    assert agree((found * change).sum(axis=(1, 2, 3, 4)), (-3 * steps[0] + 4 * steps[1] - steps[2]) / 2)


def test_modes_agree() -> None:
    """Forward and reverse mode see the same samples."""
    data = with_holes()
    scene = djpt.load_dict(cloud(data))
    reverse = gradients(scene, KEY, djpt.TensorXf(data), 64, 2)
    params = djpt.traverse(scene)
    for seed in range(2):
        attached = djpt.TensorXf(data)
        dr.enable_grad(attached)
        params[KEY] = attached
        params.update()
        image = djpt.render(scene, params, spp=1, spp_grad=64, seed=seed)
        dr.set_grad(attached, djpt.TensorXf(np.ones_like(data)))
        change = np.array(dr.forward_to(image), np.float64).mean()
        assert change == pytest.approx(reverse[seed].sum(), rel=1e-3)


def test_scale() -> None:
    data = with_holes()
    scene = djpt.load_dict(cloud(data, medium={"scale": 2.0}))
    by_scale = gradients(scene, "cube.interior_medium.scale", djpt.Float(2.0), 64, 2)[:, 0]
    by_texels = (gradients(scene, KEY, djpt.TensorXf(data), 64, 2) * data / 2).sum(axis=(1, 2, 3, 4))
    np.testing.assert_allclose(by_scale, by_texels, rtol=1e-3)


@pytest.mark.slow
def test_albedo_grid() -> None:
    """By the texels of an albedo, together with the extinction."""
    albedo = np.random.default_rng(2).uniform(0.2, 0.8, (2, 2, 2, 1)).astype(np.float32)
    volume = {"type": "gridvolume", "data": albedo, "to_world": T().translate([-1, -1, -1]).scale(2)}
    scene = djpt.load_dict(cloud(np.ones((3, 3, 3)), medium={"albedo": volume}))
    key = "cube.interior_medium.albedo.data"
    found = gradients(scene, key, djpt.TensorXf(albedo), 512)
    difference = means(scene, key, albedo + 0.1, 100) - means(scene, key, albedo - 0.1, 200)
    assert agree(found.sum(axis=(1, 2, 3, 4)) * 0.2, difference)


@pytest.mark.slow
def test_black_smoke() -> None:
    """By the albedo where it is 0, and by all texels with matter: factors vanish, and detours begin behind them."""
    data, albedo = with_holes(), np.array([0, 0.9], np.float32).reshape(1, 1, 2, 1)
    tint = {"type": "gridvolume", "data": albedo, "to_world": T().translate([-1, -1, -1]).scale(2)}
    scene = djpt.load_dict(cloud(data, medium={"albedo": tint, "scale": 2.0}))
    params, key = djpt.traverse(scene), "cube.interior_medium.albedo.data"
    by_albedo, by_texels = [], []
    for seed in range(6):
        leaves = djpt.TensorXf(data), djpt.TensorXf(albedo)
        dr.enable_grad(*leaves)
        params[KEY], params[key] = leaves
        params.update()
        dr.backward(dr.mean(djpt.render(scene, params, spp=1, spp_grad=2048, seed=seed), axis=None))
        by_texels.append((np.array(dr.grad(leaves[0]), np.float64) * (data > 0)).sum())
        by_albedo.append(np.array(dr.grad(leaves[1]), np.float64).ravel()[0])
    steps = [means(scene, key, albedo + np.array([0.1 * k, 0]).reshape(1, 1, 2, 1), 100) for k in range(3)]
    assert agree(np.array(by_albedo), (-3 * steps[0] + 4 * steps[1] - steps[2]) / 0.2)
    params[key] = djpt.TensorXf(albedo)
    change = np.where(data > 0, 0.1, 0)
    difference = means(scene, KEY, data + change, 300, 8192) - means(scene, KEY, data - change, 400, 8192)
    assert agree(np.array(by_texels), difference / 0.2)


def test_smoke_that_only_a_black_wall_would_show() -> None:
    """The image depends on the wall and not on the smoke, though its paths go on to the smoke."""
    wall = {"type": "rectangle", "to_world": T().translate([0, 0, -6]).scale(10)}
    wall["bsdf"] = {"type": "diffuse", "reflectance": 0.0}
    description = cloud(with_holes(), wall=wall)
    description["sensor"]["to_world"] = T().look_at([0, 0, -4], [0, 0, -6], [0, 1, 0])
    scene = djpt.load_dict(description)
    params, leaves = djpt.traverse(scene), (djpt.TensorXf(with_holes()), djpt.Float(0))
    dr.enable_grad(*leaves)
    params[KEY], params["wall.bsdf.reflectance.value"] = leaves
    params.update()
    dr.backward(dr.mean(djpt.render(scene, params, spp=1, spp_grad=256), axis=None))
    by_texels, by_wall = (np.array(dr.grad(leaf)) for leaf in leaves)
    assert not by_texels.any() and by_wall[0] > 0.1


def test_an_edit_compiles_no_kernel() -> None:
    """Neither image nor gradients, and the majorant follows: the new matter is denser by far."""
    data = with_holes()
    scene = djpt.load_dict(cloud(data))
    thin = gradients(scene, KEY, djpt.TensorXf(data), 16, 1)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dense = gradients(scene, KEY, djpt.TensorXf(data[::-1].copy() * 9), 16, 1)
        compiled = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and not k["cache_hit"]]
    assert not compiled and np.abs(thin - dense).max() > 0
    medium: Any = scene.shapes()[0].interior_medium()
    assert np.array(medium.get_majorant(djpt.MediumInteraction3f()))[0] == pytest.approx(data.max() * 9, rel=1e-4)


@pytest.mark.slow
def test_integrators_of_scripts() -> None:
    """One path per lane, with the paths and so the noise of its own: the same derivatives, in both modes."""
    data = with_holes()
    scene = djpt.load_dict(cloud(data))
    expected = gradients(scene, KEY, djpt.TensorXf(data), 1024)
    integrator = djpt.ad.integrators.prbvolpath.PRBVolpathIntegrator(djpt.Properties("prbvolpath"))
    params, found, changes = djpt.traverse(scene), [], []
    for seed in range(6):
        attached = djpt.TensorXf(data)
        dr.enable_grad(attached)
        params[KEY] = attached
        params.update()
        weights = djpt.TensorXf(np.full((4, 4, 3), 1 / 48, np.float32))
        integrator.render_backward(scene, params, weights, seed=seed, spp=1024)
        found.append(np.array(dr.grad(attached), np.float64).ravel())
        dr.set_grad(attached, djpt.TensorXf(np.ones_like(data)))
        changes.append(np.array(integrator.render_forward(scene, params, seed=seed, spp=1024), np.float64).mean())
    holes = (data == 0).ravel()
    mine, theirs = expected.reshape(6, -1), np.array(found)
    assert agree(theirs[:, holes].sum(axis=1), mine[:, holes].sum(axis=1))
    assert agree(theirs[:, ~holes].sum(axis=1), mine[:, ~holes].sum(axis=1))
    np.testing.assert_allclose(changes, theirs.sum(axis=1), rtol=1e-3)

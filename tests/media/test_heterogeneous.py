"""Media that vary in space, and those of scripts: tracked collision by collision."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.media_scenes import NULL, colour, fog, lit_ball
from tests.kit.renders import ours

PLACE = T().translate([-1, -1, -1]).scale(2)


def grid(channels: int = 1) -> np.ndarray:
    """Wisps, (16, 20, 24) or with channels: mostly thin, partly empty."""
    numbers = np.random.default_rng(0).random((16, 20, 24, channels)).astype(np.float32) ** 4
    numbers[:, :8] = 0
    return numbers if channels > 1 else numbers[..., 0]


def smoke(data: Any, albedo: Any, place: Any = PLACE, **more: Any) -> dict[str, Any]:
    volume = {"type": "gridvolume", "data": data, "to_world": place}
    return {"type": "heterogeneous", "sigma_t": volume, "albedo": albedo, "scale": 8.0, **more}


def in_cube(medium: dict[str, Any], max_depth: int = -1, place: Any = None) -> dict[str, Any]:
    """A cube of a medium, a little larger than the grid, under a white sky."""
    scene = lit_ball(None, max_depth=max_depth)
    del scene["ball"]
    scene["cube"] = {"type": "cube", "to_world": (place or T()).scale(1.01), "bsdf": NULL, "interior": medium}
    return scene


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.sparse(2)
def test_furnace(channels: int) -> None:
    """What only scatters is invisible."""
    means = np.array([ours(in_cube(smoke(grid(channels), 1.0)), spp=128, seed=s).mean() for s in range(8)])
    error = means.std(ddof=1) / np.sqrt(8)
    assert abs(means.mean() - 1) < 4 * error and error < 5e-3


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.sparse(2)
def test_absorption(turned: bool) -> None:
    """exp(-integral of sigma_t) along a line through the grid, by local majorants and one number per collision.

    A turned grid goes on in the corners of the box around it, as in Mitsuba.
    """
    turn = T().rotate([0, 1, 0], 30) if turned else T()
    scene = in_cube(smoke(grid(), 0.0, turn @ PLACE), place=T().scale(3))
    origin, target = np.array([0.9, 0.3, 4.0]), np.array([0.1, 0.2, 0.0])
    scene["sensor"].update(fov=0.01, to_world=T().look_at(origin=list(origin), target=list(target), up=[0, 1, 0]))
    loaded = djpt.load_dict(scene)
    medium = loaded.shapes()[0].interior_medium()
    t = (np.arange(20000) + 0.5) / 20000 * 8
    direction = (target - origin) / np.linalg.norm(target - origin)
    points = djpt.MediumInteraction3f()
    points.p = djpt.Point3f(
        *(djpt.Float((o + d * t).astype(np.float32)) for o, d in zip(origin, direction, strict=True))
    )
    box = medium.sigma_t.bbox()
    p = np.array(points.p)
    inside = (p >= np.array(box.min)[:, None]).all(axis=0) & (p <= np.array(box.max)[:, None]).all(axis=0)
    depth = (np.array(medium.get_scattering_coefficients(points)[2])[0] * inside).mean() * 8
    values = np.array([np.array(djpt.render(loaded, spp=256, seed=seed)).mean() for seed in range(8)])
    assert abs(values.mean() - np.exp(-depth)) < 4 * values.std(ddof=1) / np.sqrt(8)


def test_as_homogeneous() -> None:
    """A grid of equal numbers, with light sampling through its boundary."""
    lamp = {"type": "point", "position": [0, 2, 0], "intensity": 10.0}
    means = []
    for medium in (smoke(np.full((4, 4, 4), 0.1, np.float32), 0.7), fog(0.8, 0.7)):
        scene = in_cube(medium, max_depth=6)
        scene["lamp"], scene["cube"]["to_world"] = lamp, T()
        means.append([ours(scene, spp=256, seed=seed).mean() for seed in range(8)])
    error = np.sqrt(np.var(means, axis=1, ddof=1).sum() / 8)
    assert abs(np.mean(means[0]) - np.mean(means[1])) < 4 * error


def test_interface() -> None:
    """What scripts ask, as in Mitsuba."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    answers = []
    for m in (djpt, mi):
        volume = {"type": "gridvolume", "to_world": m.ScalarTransform4f(PLACE.matrix)}
        volume["grid"] = m.VolumeGrid(grid()[..., None])
        medium = m.load_dict({"type": "heterogeneous", "sigma_t": volume, "albedo": 0.4, "scale": 3.0})
        ray = m.Ray3f([[0.0, 0.2], [0.0, 0.5], [-3.0, -4.0]], [0.0, 0.0, 1.0])
        mei = medium.sample_interaction(ray, m.Float([0.3, 0.6]), m.UInt32([0, 1]), m.Bool(True))
        parts = [mei.t, mei.p, mei.mint, mei.sigma_s, mei.sigma_n, mei.sigma_t, mei.combined_extinction]
        parts += [*medium.intersect_aabb(ray), medium.get_majorant(mei)]
        answers.append([np.broadcast_to(np.array(part), (3, 2)) for part in parts])
    np.testing.assert_allclose(*answers, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_statistics() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    mine = np.array([ours(in_cube(smoke(grid(), 0.8), 8), spp=256, seed=seed).mean() for seed in range(8)])
    theirs = in_cube(smoke(grid(), 0.8), 8)
    volume = {"type": "gridvolume", "grid": mi.VolumeGrid(grid()[..., None])}
    theirs["cube"]["interior"]["sigma_t"] = {**volume, "to_world": mi.ScalarTransform4f(PLACE.matrix)}
    theirs["cube"]["to_world"] = mi.ScalarTransform4f(theirs["cube"]["to_world"].matrix)
    theirs["sensor"]["to_world"] = mi.ScalarTransform4f(theirs["sensor"]["to_world"].matrix)
    scene = mi.load_dict(theirs, optimize=False)
    reference = np.array([np.array(mi.render(scene, spp=256, seed=100 + seed)).mean() for seed in range(8)])
    error = np.sqrt((mine.var(ddof=1) + reference.var(ddof=1)) / 8)
    assert abs(mine.mean() - reference.mean()) < 4 * error


def test_an_edit_compiles_no_kernel() -> None:
    scene = djpt.load_dict(in_cube(smoke(grid(), 0.5), 4))
    params = djpt.traverse(scene)
    before = np.array(djpt.render(scene, spp=4))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        params["cube.interior_medium.sigma_t.data"] = grid()[::-1].copy() * 2
        params.update()
        after = np.array(djpt.render(scene, spp=4))
        compiled = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and not k["cache_hit"]]
    assert not compiled and np.abs(before - after).max() > 0.01


def test_gradients() -> None:
    """By the albedo; see also `test_extinction_gradients`."""
    scene = djpt.load_dict(in_cube(smoke(grid(), 0.6), 6))
    params = djpt.traverse(scene)
    key = "cube.interior_medium.albedo.value.value"

    def mean(value: float) -> float:
        params[key] = value
        params.update()
        return float(np.array(djpt.render(scene, spp=512, seed=7)).mean())

    difference = (mean(0.65) - mean(0.55)) / 0.1
    attached = djpt.Float(0.6)
    dr.enable_grad(attached)
    params[key] = attached
    params.update()
    dr.backward(dr.mean(djpt.render(scene, params, spp=512, seed=7, seed_grad=7), axis=None))
    assert dr.grad(attached)[0] == pytest.approx(difference, rel=0.03)


# ---------------------------------------------------------------- of scripts


class Layers(djpt.Medium):
    """Horizontal layers, written as for Mitsuba."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.density = djpt.Float(props.get("density", 2.0))

    def get_majorant(self, mi: Any, active: Any = True) -> Any:
        return djpt.Color3f(self.density)

    def get_scattering_coefficients(self, mi: Any, active: Any = True) -> Any:
        sigma_t = self.density * dr.select(dr.abs(mi.p.y) < 0.5, 1.0, 0.0)
        return 0.5 * sigma_t, self.density - sigma_t, sigma_t

    def intersect_aabb(self, ray: Any) -> Any:
        return True, 0.0, dr.inf

    def traverse(self, callback: Any) -> None:
        callback.put("density", self.density, djpt.ParamFlags.Differentiable)


def test_a_medium_of_a_script() -> None:
    """Without scattering, and as a furnace in its empty layers."""
    djpt.register_medium("layers", Layers)
    scene = in_cube({"type": "layers", "density": 1.5}, max_depth=1)
    scene["sensor"]["fov"] = 0.1
    assert ours(scene, spp=2048).mean() == pytest.approx(np.exp(-1.5 * 2.02), rel=0.1)
    scene["sensor"]["to_world"] = T().look_at(origin=[0, 0.8, 4], target=[0, 0.8, 0], up=[0, 1, 0])
    assert ours(scene, spp=16).mean() == pytest.approx(1, abs=1e-4)


def test_gradients_by_a_medium_of_a_script() -> None:
    """Matter that only absorbs, on the way of the rays: exp(-2.02 density)."""
    djpt.register_medium("layers", Layers)
    description = in_cube({"type": "layers", "density": 0.5}, max_depth=1)
    description["sensor"]["fov"] = 0.1
    scene = djpt.load_dict(description)
    params = djpt.traverse(scene)
    key = "cube.interior_medium.density"
    dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.mean(djpt.render(scene, params, spp=1, spp_grad=2048), axis=None))
    assert dr.grad(params[key])[0] == pytest.approx(-2.02 * np.exp(-0.5 * 2.02), rel=0.1)


@pytest.mark.slow
def test_colours_of_extinction() -> None:
    """A coloured grid: absorbed light keeps its colour."""
    data = np.ones((2, 2, 2, 3), np.float32) * np.array([0.5, 1, 2], np.float32)
    scene = in_cube({**smoke(data, 0.0), "scale": 0.4}, max_depth=1)
    scene["sensor"]["fov"] = 0.1
    values = np.array([ours(scene, spp=512, seed=seed).mean(axis=(0, 1)) for seed in range(8)])
    error = values.std(axis=0, ddof=1) / np.sqrt(8)
    assert (np.abs(values.mean(axis=0) - np.exp(-0.8 * np.array([0.5, 1, 2]))) < 4 * error + 1e-4).all()
    assert djpt.load_dict(fog(colour(1, 2, 3))).has_spectral_extinction()

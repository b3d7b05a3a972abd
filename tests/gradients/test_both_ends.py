"""Derivatives of images that light paths add to, by `bdpt` and `ptracer`: against differences of the same samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.rendering.schedules import passes
from tests.integrators.test_bdpt import MATERIALS
from tests.kit.derivatives import ALBEDO, RADIANCE, Experiment, Slopes, differentiable, numbers
from tests.kit.emitters import entry
from tests.kit.kernels import kernels
from tests.kit.lit_floor import floor_scene
from tests.kit.mesh_scenes import ball_file
from tests.kit.renders import box

WHITE = "white.reflectance.value"
slow = pytest.mark.slow


def of(kind: str, **keys: Any) -> dict[str, Any]:
    """An integrator without roulette, whose decisions depend on albedos: differences would jump."""
    return {"type": kind, "max_depth": 4, "rr_depth": 1000, **keys}


def check(kind: str, experiment: Experiment) -> None:
    """Compare with differences: those of `bdpt` jump, as its choice of connections depends on albedos."""
    if kind == "bdpt":
        experiment.check_on_average()
    else:
        experiment.check()


def wide(scene: dict[str, Any]) -> None:
    scene["sensor"]["film"]["rfilter"] = {"type": "gaussian", "stddev": 5.0}


# ---------------------------------------------------------------- reverse, forward, differences


@pytest.mark.parametrize("kind", ["bdpt", "ptracer"])
@pytest.mark.parametrize("rfilter", ["box", pytest.param("gaussian", marks=slow)])
@pytest.mark.sparse(2)
@pytest.mark.slow
def test_albedo_and_radiance(kind: str, rfilter: str) -> None:
    check(kind, Experiment(box(12, rfilter, of(kind)), [ALBEDO, WHITE, RADIANCE], spp=8))


@slow
@pytest.mark.parametrize("kind", ["bdpt", "ptracer"])
def test_films(kind: str) -> None:
    """A crop with and without samples beyond its border, filters of all sizes, alpha."""
    crop = {"crop_width": 9, "crop_height": 7, "crop_offset_x": 2, "crop_offset_y": 5}
    for rfilter, film in (("gaussian", {**crop, "sample_border": True}), ("box", {**crop, "pixel_format": "rgba"})):
        check(kind, Experiment(box(16, rfilter, of(kind), **film), [ALBEDO]))
    check(kind, Experiment(box(12, "gaussian", of(kind), wide), [ALBEDO]))


@slow
@pytest.mark.parametrize("kind", ["bdpt", "ptracer"])
def test_roulette_does_not_matter_to_reverse_and_forward(kind: str) -> None:
    experiment = Experiment(box(12, "box", of(kind, max_depth=8, rr_depth=2)), [ALBEDO])
    experiment.assert_modes_agree()


@slow
def test_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Passes over samples and bands leave the gradient as it is."""
    from djpt.rendering.gradients import splatted

    for kind in ("bdpt", "ptracer"):
        whole = Experiment(box(16, "gaussian", of(kind)), [ALBEDO]).gradients()[ALBEDO]
        with monkeypatch.context() as patch:
            patch.setattr(passes, "STORED_SAMPLES", 3 * 256)
            patch.setattr(splatted, "PASS_PAIRS", 3 * 256)
            patch.setattr(passes, "STORED_PIXELS", (7 * 16, 7 * 16))
            patch.setattr(splatted, "PASS_PATHS", 1000)
            split = Experiment(box(16, "gaussian", of(kind)), [ALBEDO])
            np.testing.assert_allclose(split.gradients()[ALBEDO], whole, rtol=1e-4)
            check(kind, split)


# ---------------------------------------------------------------- scenes


class SceneSlopes(Slopes):
    """By all parameters that don't move anything."""

    spp, seeds = 64, (4, 24)

    def __init__(self, description: dict[str, Any]) -> None:
        scene = djpt.load_dict(description)
        params, rng, at, along = djpt.traverse(scene), np.random.default_rng(3), {}, {}
        for key in differentiable(params):
            if key.split(".")[0] in ("sensor", "integrator") or "vertex" in key:
                continue
            value = numbers(params[key])
            if not np.issubdtype(value.dtype, np.floating) or value.size == 0 or "weight" in key:
                continue
            largest = max(1.0, np.abs(value).max())
            at[key] = 0.9 * value + 0.03 * (largest == 1)
            along[key] = largest * rng.uniform(0.5, 1, value.shape)
        super().__init__(scene, at, along)


def lit(name: str, kind: str) -> dict[str, Any]:
    return floor_scene({"light": entry(name)}, size=16, integrator=of(kind))


def built_in(name: str, kind: str) -> dict[str, Any]:
    scene = djpt.scenes.SCENES[name]()
    scene["integrator"] = of(kind, max_depth=6)
    scene["sensor"]["film"].update(width=16, height=16, rfilter={"type": "box"})
    return scene


def painted(name: str, kind: str) -> dict[str, Any]:
    scene = floor_scene(size=16, integrator=of(kind))
    if name == "texture":
        texels = np.random.default_rng(2).uniform(0.1, 0.9, (4, 4, 3)).astype(np.float32)
        scene["floor"]["bsdf"]["reflectance"] = {"type": "bitmap", "data": texels, "raw": True}
    else:
        scene["ball"]["bsdf"], scene["small"]["bsdf"] = MATERIALS[name]
    return scene


SCENES = {
    "texture": lambda: painted("texture", "bdpt"),
    "glass ball": lambda: built_in("glass_ball", "bdpt"),
    "fixture": lambda: built_in("fixture", "bdpt"),
    "coats": lambda: painted("coats", "bdpt"),
    "coats, traced": lambda: painted("coats", "ptracer"),
    "coloured glass": lambda: painted("coloured glass", "bdpt"),
    "coloured glass, traced": lambda: painted("coloured glass", "ptracer"),
    "openings": lambda: painted("openings", "bdpt"),
    "point": lambda: lit("point-position", "bdpt"),
    "sky": lambda: lit("constant-colour", "bdpt"),
}


@slow
@pytest.mark.parametrize("name", SCENES)
def test_every_parameter(name: str) -> None:
    slopes, exact = SceneSlopes(SCENES[name]()), {}
    assert slopes.keys
    verdicts = [slopes.check(key, exact) for key in slopes.keys]
    print(name, *(text for _, text in verdicts), sep="\n  ")
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)


@slow
def test_meshes(tmp_path: Path) -> None:
    """In trees of triangles images leave out some of the rays between vertices, and derivatives none."""
    scene = floor_scene(size=16, integrator=of("bdpt"))
    scene["ball"] = {"type": "ply", "filename": ball_file(tmp_path), "bsdf": {"type": "diffuse", "reflectance": 0.7}}
    slopes, exact = SceneSlopes(scene), {}
    slopes.seeds = (16, 64)
    verdicts = [slopes.check(key, exact) for key in ("floor.bsdf.reflectance.value", "ball.bsdf.reflectance.value")]
    assert all(good for good, _ in verdicts), verdicts


@slow
def test_wrong_derivatives_fail() -> None:
    """The test's power."""
    slopes = SceneSlopes(painted("texture", "ptracer"))
    assert not slopes.check("floor.bsdf.reflectance.data", {}, 1.05)[0]


# ---------------------------------------------------------------- values that vanish


def mean_gradient(kind: str, key: str, value: Any, spp: int, forward: bool = False) -> np.ndarray:
    """The gradient (3,) of the Cornell box's mean, or its derivative by all channels together."""
    scene = djpt.load_dict(box(16, "box", {"type": kind, "max_depth": 5}))
    params = djpt.traverse(scene)
    params[key] = djpt.Color3f(value)
    dr.enable_grad(params[key])
    if forward:
        dr.set_grad(params[key], djpt.Color3f(1))
    params.update()
    mean = dr.mean(djpt.render(scene, params, spp=1, spp_grad=spp), axis=None)
    if forward:
        return np.array(dr.forward_to(mean), np.float64)
    dr.backward(mean)
    return np.array(dr.grad(params[key]), np.float64).ravel()


@slow
@pytest.mark.parametrize("kind", ["bdpt", "ptracer"])
@pytest.mark.parametrize("value", [0.0, (0.5, 0.0, 1e-20)])
@pytest.mark.parametrize("key", [ALBEDO, RADIANCE])
def test_black(kind: str, key: str, value: Any) -> None:
    """Black walls and lamps, in all channels or in some: paths go on behind them, and begin there."""
    found = mean_gradient(kind, key, value, 2048)
    np.testing.assert_allclose(found, mean_gradient("path", key, value, 8192), rtol=0.03)
    change = mean_gradient(kind, key, value, 2048, forward=True)
    np.testing.assert_allclose(found.sum(), change, rtol=1e-4)


# ---------------------------------------------------------------- contracts


def test_more_samples_compile_nothing() -> None:
    """Neither do other values."""
    scene = djpt.load_dict(box(8, "box", of("ptracer")))
    params = djpt.traverse(scene)

    def descend(spp: int, red: float) -> None:
        params[ALBEDO] = djpt.Color3f(red, 0.1, 0.1)
        dr.enable_grad(params[ALBEDO])
        params.update()
        dr.backward(dr.sum(djpt.render(scene, params, spp=spp).array))
        dr.eval(dr.grad(params[ALBEDO]))

    known = kernels(lambda: descend(4, 0.5)) | kernels(lambda: descend(5, 0.6))
    assert not kernels(lambda: descend(7, 0.7)) - known


def test_strategies_have_no_derivatives() -> None:
    scene = djpt.load_dict(box(8))
    params = djpt.traverse(scene)
    dr.enable_grad(params[ALBEDO])
    params.update()
    with pytest.raises(djpt.RenderError, match="can't be differentiated"):
        djpt.render(scene, integrator=djpt.load_dict(of("bdpt", strategies=True)), spp=1)

"""Derivatives by one walk are those by two."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.rendering.gradients import replay, single_walk

T = djpt.ScalarTransform4f
TEXELS = np.random.default_rng(1).uniform(0.2, 0.8, (3, 4, 3)).astype(np.float32)
METAL = {"type": "principled", "metallic": 0.7, "base_color": {"type": "rgb", "value": [0.8, 0.5, 0.3]}}
FLOOR = {"type": "rectangle", "to_world": T().translate([0, 0, -1]).scale(3)}
FLAKES = {"type": "sggx", "S": {"type": "gridvolume", "data": np.float32([1, 0.2, 0.4, 0.1, 0, 0]).reshape(1, 1, 1, 6)}}
MEDIUM = {"type": "homogeneous", "sigma_t": 0.3, "albedo": 0.6}


def body(bsdf: dict[str, Any], **options: Any) -> dict[str, Any]:
    """A ball over a floor, under a sky and a lamp."""
    place = T().look_at([0, -3, 3], [0, 0, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 8, "height": 6, "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 5},
        "sensor": {"type": "perspective", "fov": 45, "to_world": place, "film": film},
        "body": {"type": "sphere", "bsdf": bsdf},
        "floor": FLOOR,
        "sky": {"type": "constant", "radiance": 0.3},
        "lamp": {"type": "point", "position": [1, -2, 3], "intensity": 8.0},
        **options,
    }


BITMAP = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": TEXELS, "raw": True}}
BOX: dict[str, Any] = djpt.cornell_box()
BOX["sensor"]["film"] = {"type": "hdrfilm", "width": 8, "height": 8}
FOG = {"type": "cube", "to_world": T().scale(4), "bsdf": {"type": "null"}, "interior": MEDIUM}
CASES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "paints": (BOX | {"integrator": {"type": "prb"}}, [f"{n}.reflectance.value" for n in ("white", "red", "green")]),
    "lamp": (BOX | {"integrator": {"type": "prb"}}, ["light.emitter.radiance.value", "white.reflectance.value"]),
    "metal": (body(METAL), ["body.bsdf.roughness.value", "body.bsdf.base_color.value", "lamp.intensity.value"]),
    "glass": (
        body({"type": "dielectric", "specular_transmittance": 0.7}),
        ["body.bsdf.specular_transmittance.value", "sky.radiance.value"],
    ),
    "black": (body({"type": "diffuse", "reflectance": 0.0}), ["body.bsdf.reflectance.value", "sky.radiance.value"]),
    "clear fog": (
        body(METAL, air=FOG, integrator={"type": "volpath", "max_depth": 5}),
        ["air.interior_medium.albedo.value.value", "body.bsdf.base_color.value"],
    ),
    "flakes": (
        body(METAL, air=FOG | {"interior": MEDIUM | {"phase": FLAKES}}, integrator={"type": "volpath", "max_depth": 5}),
        ["air.interior_medium.scale"],
    ),
    "fog": (body(METAL, air=FOG, integrator={"type": "volpath", "max_depth": 5}), ["body.bsdf.base_color.value"]),
}


def derivatives(description: dict[str, Any], keys: list[str]) -> tuple[list[np.ndarray], np.ndarray]:
    """The gradients of a weighted image, and its change in one direction."""
    scene = djpt.load_dict(description)
    params = djpt.traverse(scene)
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    image = djpt.render(scene, params, spp=16, seed=3, schedule="flat")
    rng = np.random.default_rng(2)
    weights = djpt.TensorXf(rng.uniform(0.5, 1.5, image.shape).astype(np.float32))
    dr.backward(dr.sum(image * weights, axis=None))
    found = [np.array(dr.grad(params[key])) for key in keys]
    dr.clear_grad([params[key] for key in keys])
    image = djpt.render(scene, params, spp=16, seed=3, schedule="flat")
    for i, key in enumerate(keys):
        dr.set_grad(params[key], 1 + i)
    return found, np.array(dr.forward_to(image))


@pytest.fixture
def walks(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of what follows paths."""
    found = list[str]()

    def noticed(module: Any, name: str) -> Any:
        run = module.run

        def told(*arguments: Any) -> Any:
            found.append(name)
            return run(*arguments)

        return told

    for module, name in ((single_walk, "once"), (replay, "twice")):
        monkeypatch.setattr(module, "run", noticed(module, name))
    return found


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_two_walks(name: str, walks: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    found, change = derivatives(*CASES[name])
    monkeypatch.setattr(single_walk, "possible", lambda *arguments: False)
    expected, change_expected = derivatives(*CASES[name])
    assert walks == ["once", "once", "twice", "twice"]
    for one, other in zip([*found, change], [*expected, change_expected], strict=True):
        assert np.abs(other).max() > 0
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5 * np.abs(other).max())


def test_texels_take_two(walks: list[str]) -> None:
    """In reverse mode lanes hold few sums."""
    derivatives(body(BITMAP), ["body.bsdf.reflectance.data"])
    assert walks == ["twice", "once"]

"""Derivatives by the machine schedule: the flat schedule's, finite differences, and Mitsuba's prb."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.rendering.gradients import machine_replay
from djpt.rendering.schedules import passes
from tests.kit.derivatives import SEED, Experiment
from tests.kit.mesh_scenes import gallery, uv_texture
from tests.kit.threads import threads

SPP = 8
PRB = {"type": "prb", "max_depth": 5, "rr_depth": 1000}
NAMES = [
    "floor.bsdf.reflectance.value",
    "flat.bsdf.reflectance.value",
    "flipped.bsdf.brdf_0.reflectance.value",
    "mirrored.bsdf.brdf_1.reflectance.value",
    "lamp.emitter.radiance.value",
    "point.intensity.value",
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("meshes")


def loss(scene: Any, names: list[str], schedule: str, spp: int = SPP, **options: Any) -> Experiment:
    return Experiment(scene, names, spp, schedule=schedule, **options)


def same(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray], tolerance: float) -> None:
    for name, gradient in wanted.items():
        assert np.abs(gradient).max() > 0, name
        np.testing.assert_allclose(found[name], gradient, rtol=tolerance, atol=tolerance * np.abs(gradient).max())


SCENES: dict[str, dict[str, Any]] = {
    "box": {},
    "gaussian": {"rfilter": "gaussian"},
    "crop": {"size": (40, 30), "crop_width": 21, "crop_height": 17, "crop_offset_x": 9, "crop_offset_y": 11},
    "crop, gaussian, border": {
        "size": (40, 30), "crop_width": 21, "crop_height": 17, "crop_offset_x": 9, "crop_offset_y": 11,
        "rfilter": "gaussian", "sample_border": True,
    },
    "hidden, rgba": {"integrator": {**PRB, "hide_emitters": True}, "pixel_format": "rgba"},
}  # fmt: skip


SLOW = ("gaussian", "crop")


@pytest.mark.parametrize("kind", [pytest.param(k, marks=pytest.mark.slow if k in SLOW else ()) for k in SCENES])
@pytest.mark.sparse(6)
def test_reverse_forward_and_differences(folder: Path, kind: str) -> None:
    scene = djpt.load_dict(gallery(folder, **{"size": (24, 19), "integrator": PRB, **SCENES[kind]}))
    machine, flat = loss(scene, NAMES, "machine"), loss(scene, NAMES, "flat")
    reverse = machine.gradients()
    # One path in thousands may take another turn.
    same(reverse, flat.gradients(), 2e-3)
    for name in NAMES[::2]:
        scale = np.abs(reverse[name]).max()
        forward, by_difference = machine.changes(name, 1)
        slope = machine.value(by_difference)
        assert reverse[name][1] == pytest.approx(slope, rel=3e-3, abs=3e-3 * scale)
        assert machine.value(forward) == pytest.approx(reverse[name][1], rel=1e-4, abs=1e-4 * scale)
        # A flipped decision spreads over 25 pixels under the gaussian.
        for other in (by_difference, flat.forward(flat.component(name, 1), SEED)):
            assert np.mean(np.abs(forward - other) > 0.01 * np.abs(other).max()) < 0.05


def test_uv_textures_beside_parameters(folder: Path) -> None:
    description = uv_texture(gallery(folder, (24, 19), integrator=PRB), "smooth", "flipped", "ball")
    scene, names = djpt.load_dict(description), [NAMES[0], NAMES[1], NAMES[4]]
    same(loss(scene, names, "machine").gradients(), loss(scene, names, "flat").gradients(), 2e-3)


@pytest.mark.sparse(10)
@pytest.mark.parametrize("size", [(1, 1), (3, 2), (37, 5)])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_small_images_and_sample_counts(folder: Path, size: tuple[int, int], rfilter: str) -> None:
    scene = djpt.load_dict(gallery(folder, size, rfilter, {**PRB, "max_depth": 3}))
    for spp in (1, 3, 33):
        machine, flat = (loss(scene, NAMES[:1] + NAMES[4:5], s, spp).gradients() for s in ("machine", "flat"))
        for name, gradient in flat.items():
            np.testing.assert_allclose(machine[name], gradient, rtol=1e-4, atol=1e-4 * np.abs(gradient).max() + 1e-9)


def bright_room(folder: Path, **keys: Any) -> dict[str, Any]:
    """A closed room of nearly white walls with a mesh in it: paths go on for hundreds of vertices."""
    scene = djpt.cornell_box()
    scene["sensor"]["film"].update(width=12, height=12, rfilter={"type": "box"})
    scene["integrator"] = {"type": "prb", "max_depth": -1, "rr_depth": 1000, **keys}
    for color in ("white", "red", "green"):
        scene[color] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.99, 0.99, 0.98]}}
    scene["front"] = {
        "type": "rectangle",
        "to_world": T().translate([0, 0, 1]).rotate([0, 1, 0], 180),
        "bsdf": {"type": "ref", "id": "white"},
    }
    scene["sensor"]["to_world"] = T().look_at([0, 0, 0.9], [0, 0, 0], [0, 1, 0])
    smooth = gallery(folder)["smooth"]
    bsdf = {"type": "ref", "id": "red"}
    del scene["large-box"]
    scene["mesh"] = {**smooth, "to_world": T().translate([-0.3, -0.4, -0.3]).scale(0.4), "bsdf": bsdf}
    return scene


@pytest.mark.parametrize("depth", [-1, 65, *(pytest.param(n, marks=pytest.mark.slow) for n in (64, 90))])
@pytest.mark.sparse(2)
def test_paths_longer_than_what_is_noted(folder: Path, depth: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond `NOTED` vertices the second walk asks for the visibility of lights again."""
    white, light = "white.reflectance.value", "light.emitter.radiance.value"
    names = ["red.reflectance.value", white, light]
    limit = {"rr_depth": 150} if depth < 0 else {}
    scene = djpt.load_dict(bright_room(folder, max_depth=depth, **limit))
    machine = loss(scene, names, "machine", 4)
    reverse = machine.gradients()
    # The image is linear in the light.
    total, along = machine.value(machine.image(SEED)), machine.component(white, 0)
    assert reverse[light] @ machine.values[machine.parts[light]] == pytest.approx(total, rel=1e-4)
    assert machine.value(machine.forward(along, SEED)) == pytest.approx(reverse[white][0], rel=1e-3)
    if depth > 0:
        slope = machine.value(machine.difference(along, 5e-4, SEED))
        assert reverse[white][0] == pytest.approx(slope, rel=5e-3)
    monkeypatch.setattr(machine_replay, "NOTED", 16)
    same(loss(scene, names, "machine", 4).gradients(), reverse, 1e-3)
    if depth > 0:
        # Rounding grows from bounce to bounce: so long paths of two schedules go apart.
        same(loss(scene, names, "flat", 4).gradients(), reverse, 0.03)


def test_much_comes_from_long_paths(folder: Path) -> None:
    """Otherwise the test above would test nothing."""
    name = "white.reflectance.value"
    short, long = (djpt.load_dict(bright_room(folder, max_depth=n)) for n in (machine_replay.NOTED, 150))
    one, other = (loss(scene, [name], "machine", 4).gradients()[name] for scene in (short, long))
    assert (one < 0.8 * other).all()


def test_passes_do_not_matter(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = djpt.load_dict(gallery(folder, (24, 19), "gaussian", PRB))
    machine = loss(scene, NAMES, "machine")
    whole, along = machine.gradients(), machine.component(NAMES[0], 0)
    forward = machine.forward(along, SEED)
    for key, value in (("STORED_SAMPLES", 3 * 24 * 19), ("STORED_PIXELS", (7 * 28, 7 * 28))):
        monkeypatch.setattr(passes, key, value)
        same(machine.gradients(), whole, 2e-5)
        np.testing.assert_allclose(machine.forward(along, SEED), forward, rtol=1e-4, atol=1e-5)


def test_gradients_repeat(folder: Path) -> None:
    scene = djpt.load_dict(gallery(folder, (24, 19), integrator=PRB))
    machine = loss(scene, NAMES, "machine")
    first = machine.gradients()
    for count in (1, 2):
        with threads(count):
            again = machine.gradients()
        for name, gradient in first.items():
            np.testing.assert_array_equal(again[name], gradient, err_msg=name)


@pytest.mark.parametrize("rfilter", [pytest.param("box", marks=pytest.mark.slow), "gaussian"])
def test_gradients_of_mitsuba(folder: Path, rfilter: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    description = gallery(folder, (24, 19), rfilter, {"type": "prb", "max_depth": 5, "rr_depth": 3})
    # Mitsuba refuses equal seeds for image and gradient.
    ours = loss(djpt.load_dict(description, optimize=False), NAMES, "machine", seed_grad=SEED + 1)
    reverse = ours.gradients()
    forward = ours.forward(ours.component(NAMES[1], 0), SEED)

    scene = mi.load_dict(djpt.validation.to_mitsuba(description), optimize=False)
    params = mi.traverse(scene)
    # Nested materials have other names there.
    keys = {name: name if name in params else name.replace("brdf_0", "bsdf") for name in NAMES}
    keys = {name: key for name, key in keys.items() if key in params}
    assert len(keys) >= 4
    for key in keys.values():
        dr.enable_grad(params[key])
    params.update()
    weights = mi.TensorXf(ours.weights)
    options = {"spp": SPP, "seed": SEED, "seed_grad": SEED + 1}
    dr.backward(dr.mean((mi.render(scene, params, **options) * weights).array))
    for name, key in keys.items():
        theirs = np.array(dr.grad(params[key]), np.float64).ravel()
        np.testing.assert_allclose(reverse[name], theirs, rtol=2e-3, atol=2e-3 * np.abs(theirs).max(), err_msg=name)

    for key in keys.values():
        dr.disable_grad(params[key])
    dr.enable_grad(params[keys[NAMES[1]]])
    dr.set_grad(params[keys[NAMES[1]]], mi.Color3f(1, 0, 0))
    params.update()
    theirs = np.array(dr.forward_to(mi.render(scene, params, **options)))
    assert np.mean(np.abs(forward - theirs) > 1e-3 * np.abs(theirs).max()) < 0.01

"""What emitters refuse, in which words; and what edits do."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Float, Point2f, Point3f
from tests.kit.emitters import SPOT, entry
from tests.kit.kernels import kernels
from tests.kit.lit_floor import floor_scene
from tests.kit.one_light import lit
from tests.kit.renders import pixels

SHEARED = T([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
CHECKERBOARD = {"type": "checkerboard"}

REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"type": "constant", "radiance": -1.0}, "scene.light: 'radiance' must be at least 0, found -1"),
    ({"type": "constant", "radiance": CHECKERBOARD}, "'radiance' can't vary: this light has no surface"),
    ({"type": "point", "intensity": {"type": "rgb", "value": [1, -2, 0]}}, "'intensity' must be at least 0, found -2"),
    ({"type": "point", "intensity": CHECKERBOARD}, "'intensity' can't vary"),
    ({"type": "point", "position": [0, 0, 0], "to_world": T()}, "give 'position' or 'to_world', not both"),
    ({"type": "point", "sampling_weight": -1.0}, "'sampling_weight' must be at least 0"),
    ({"type": "directional", "direction": [0, 0, 0]}, "scene.light: 'direction' must not be zero"),
    ({"type": "directional", "direction": [0, 1, 0], "to_world": T()}, "give 'direction' or 'to_world', not both"),
    ({"type": "directional", "direction": [0, 1]}, "'direction' must be three numbers"),
    ({"type": "directional", "irradiance": -1.0}, "'irradiance' must be at least 0, found -1"),
    ({"type": "directional", "irradiance": CHECKERBOARD}, "'irradiance' can't vary"),
    ({"type": "directional", "to_world": T().scale([1, 2, 1])}, "'to_world' must not shear, nor scale differently"),
    (
        {"type": "directional", "radiance": 1.0},
        "unknown key 'radiance' of emitter 'directional'; did you mean 'irradiance'",
    ),
    ({"type": "spot", "cutoff_angle": 0.0}, r"'cutoff_angle' must lie in \(0, 90\], found 0"),
    ({"type": "spot", "cutoff_angle": 95.0}, r"'cutoff_angle' must lie in \(0, 90\], found 95"),
    ({"type": "spot", "cutoff_angle": 20.0, "beam_width": 30.0}, r"'beam_width' must lie in \[0, 20\], found 30"),
    ({"type": "spot", "beam_width": -1.0}, r"'beam_width' must lie in \[0, 20\], found -1"),
    ({"type": "spot", "intensity": CHECKERBOARD}, "'intensity' can't vary: what varies over the cone is the 'texture'"),
    ({"type": "spot", "texture": -1.0}, "'texture' must be at least 0"),
    ({"type": "spot", "to_world": SHEARED}, "'to_world' must not shear"),
    ({"type": "spot", "cutof_angle": 30.0}, "unknown key 'cutof_angle' of emitter 'spot'; did you mean 'cutoff_angle'"),
    ({"type": "projector", "irradiance": -1.0}, "'irradiance' must be at least 0, found -1"),
    ({"type": "projector", "scale": -1.0}, "'scale' must be at least 0, found -1"),
    ({"type": "projector", "fov": 180.0}, r"'fov' must lie in \(0, 180\), found 180"),
    ({"type": "projector", "fov": 40.0, "focal_length": "30mm"}, "'focal_length' can't be given together with 'fov'"),
    ({"type": "projector", "focal_length": "wide"}, "'focal_length' must be a positive length"),
    ({"type": "projector", "to_world": SHEARED}, "'to_world' must not shear"),
    ({"type": "sunsky", "turbidity": 11.0}, r"'turbidity' must lie in \[1, 10\], found 11"),
    ({"type": "sunsky", "sun_scale": -1.0}, "'sun_scale' must be at least 0, found -1"),
    ({"type": "sunsky", "albedo": 1.5}, "'albedo' must"),
    ({"type": "sunsky", "albedo": CHECKERBOARD}, "'albedo' can't vary: it applies to all of the ground"),
    ({"type": "sunsky", "sun_direction": [0, 0, 0]}, "'sun_direction' must not be zero"),
    ({"type": "sunsky", "sun_direction": [0, 0, 1], "hour": 9.0}, "can't be given together with 'hour'"),
    ({"type": "sunsky", "sun_aperture": 0.0}, r"'sun_aperture' must lie in \(0, 180\), found 0"),
    ({"type": "sunsky", "day": 1.5}, "'day' must be an integer"),
]


@pytest.mark.parametrize(("light", "message"), REFUSED, ids=[f"{d['type']}-{k}" for k, (d, _) in enumerate(REFUSED)])
def test_descriptions(light: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict({"type": "scene", "light": light})


NESTED: list[tuple[dict[str, Any], str]] = [
    ({"type": "area", "to_world": T()}, "an area light has no 'to_world'; move the shape"),
    ({"type": "area", "radiance": -1.0}, "'radiance' must be at least 0, found -1"),
    ({"type": "directionalarea", "to_world": T()}, "an area light has no 'to_world'; move the shape"),
    ({"type": "directionalarea", "radiance": -1.0}, "'radiance' must be at least 0, found -1"),
    ({"type": "spot"}, "can't be nested in a shape; possible: .*area.*directionalarea"),
]


@pytest.mark.parametrize(("light", "message"), NESTED, ids=[d["type"] + str(k) for k, (d, _) in enumerate(NESTED)])
def test_nested_descriptions(light: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict({"type": "scene", "lamp": {"type": "rectangle", "emitter": light}})


def test_one_environment() -> None:
    sky = {"type": "constant"}
    with pytest.raises(SceneError, match="only one environment emitter is possible, found 2"):
        djpt.load_dict({"type": "scene", "a": sky, "b": sky})
    # Parallel light isn't one.
    djpt.load_dict({"type": "scene", "a": sky, "b": {"type": "directional"}, "c": {"type": "directional"}})


# ---------------------------------------------------------------- edits


@pytest.mark.parametrize(
    ("name", "key", "value", "message"),
    [
        ("spot-default", "cutoff_angle", 91.0, r"light.cutoff_angle: must lie in \(0, 90\], found 91"),
        ("spot-default", "cutoff_angle", 0.0, r"light.cutoff_angle: must lie in \(0, 90\], found 0"),
        ("spot-default", "beam_width", -1.0, r"light.beam_width: must lie in \[0, 90\], found -1"),
        ("spot-default", "beam_width", 30.0, "light: beam_width 30 must be at most cutoff_angle, 20"),
        ("spot-default", "intensity.value", -1.0, "light.intensity.value: must be at least 0, found -1"),
        ("spot-default", "to_world", SHEARED, "light.to_world: must not shear"),
        ("spot-default", "cutoff_angle", "wide", "light.cutoff_angle: must be numbers"),
        ("projector-default", "scale", -1.0, "light.scale: must be at least 0, found -1"),
        ("directional-default", "irradiance.value", [1, -1, 1], "light.irradiance.value: must be at least 0"),
        ("directional-default", "sampling_weight", -1.0, "light.sampling_weight: must be at least 0"),
    ],
)
def test_edits(name: str, key: str, value: Any, message: str) -> None:
    """Refused, and the light is as before."""
    scene = lit(light=entry(name))
    params = djpt.traverse(scene)
    before = str(params[f"light.{key}"])
    with pytest.raises(ParameterError, match=message):
        params[f"light.{key}"] = value
        params.update()
    assert str(djpt.traverse(scene)[f"light.{key}"]) == before


PARAMETERS = {
    "spot-default": ["sampling_weight", "cutoff_angle", "beam_width", "intensity.value", "texture.value", "to_world"],
    "directional-direction": ["sampling_weight", "irradiance.value", "to_world"],
    "projector-default": ["sampling_weight", "scale", "irradiance.value", "to_world"],
    "point-turned": ["sampling_weight", "position", "intensity.value"],
    "constant-colour": ["sampling_weight", "radiance.value"],
}


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.sparse(3)
def test_parameters_have_mitsubas_names(name: str) -> None:
    mi = pytest.importorskip("mitsuba")
    ours = djpt.traverse(lit(light=entry(name)))
    assert {k for k in ours if k.startswith("light.")} == {f"light.{k}" for k in PARAMETERS[name]}
    described = djpt.validation.to_mitsuba({"type": "scene", "light": entry(name)})
    with djpt.validation.bridge._variant():
        theirs = mi.traverse(mi.load_dict(described))
        for key in PARAMETERS[name]:
            assert f"light.{key}" in theirs
            differentiable = bool(theirs.flags(f"light.{key}") & mi.ParamFlags.NonDifferentiable) is False
            if key not in ("position", "to_world"):  # there, most lights have no derivatives by it
                flags = ours.flags(f"light.{key}")
                assert bool(flags.differentiable) == differentiable, key


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("spot-default", {"cutoff_angle": 40.0, "beam_width": 10.0, "to_world": SPOT @ T().rotate([1, 0, 0], 5)}),
        ("spot-bitmap", {"to_world": T().translate([0.5, 0.2, 0]) @ SPOT}),
        ("projector-default", {"scale": 3.0, "irradiance.value": 2.0, "to_world": SPOT @ T().rotate([1, 0, 0], 5)}),
        ("directional-default", {"irradiance.value": [1, 2, 3], "to_world": T().rotate([1, 0, 0], 60)}),
        ("constant-colour", {"radiance.value": [1, 2, 3]}),
    ],
)
def test_an_edit_is_what_loading_would_give(name: str, changes: dict[str, Any]) -> None:
    """And compiles no kernel."""
    edited = djpt.load_dict(floor_scene({"light": entry(name)}, size=16))
    images = []

    def render() -> None:
        images.append(pixels(djpt.render(edited, spp=2)))

    used = kernels(render)
    djpt.traverse(edited).update({f"light.{key}": value for key, value in changes.items()})
    assert kernels(render) == used
    first, image = images
    description = dict(entry(name))
    for key, value in changes.items():
        description[key.removesuffix(".value")] = (
            value if np.ndim(value) != 1 or isinstance(value, T) else {"type": "rgb", "value": value}
        )
    expected = pixels(djpt.render(djpt.load_dict(floor_scene({"light": description}, size=16)), spp=2))
    np.testing.assert_allclose(image, expected, rtol=1e-5, atol=1e-6)
    assert np.abs(image - first).max() > 1e-3


def test_a_picture_of_another_shape() -> None:
    """The field of view along x stays, as in Mitsuba."""
    wide, tall = (np.ones((*shape, 3), np.float32) for shape in ((4, 8), (8, 4)))
    light = {
        "type": "projector",
        "fov": 40.0,
        "irradiance": {"type": "bitmap", "data": djpt.TensorXf(wide), "raw": True},
    }
    scene = lit(light=light)
    emitter = scene.emitters()[0]
    before = emitter.power()
    params = djpt.traverse(scene)
    params["light.irradiance.data"] = djpt.TensorXf(tall)
    params.update()
    assert emitter.power() == pytest.approx(4 * before)
    assert before == pytest.approx(math.pi * (2 * math.tan(math.radians(20))) ** 2 / 2, rel=1e-5)


def test_lights_at_infinity_follow_the_scene() -> None:
    """Their power grows with the scene: what enters the sphere about it."""
    ball = {"type": "sphere", "radius": 1.0}
    scene = djpt.load_dict({"type": "scene", "ball": ball, "sun": {"type": "directional"}, "sky": {"type": "constant"}})
    before = [emitter.power() for emitter in scene.emitters()]
    params = djpt.traverse(scene)
    params["ball.to_world"] = T().scale(2)
    params.update()
    for emitter, power in zip(scene.emitters(), before, strict=True):
        assert emitter.power() == pytest.approx(4 * power, rel=1e-3)


def test_every_choice_knows_all_lights() -> None:
    """The image has the same mean."""
    lights = {name: entry(name) for name in ("spot-default", "directional-turned", "projector-colour", "area-mesh")}
    images = []
    for choice in ("uniform", "power", "tree"):
        integrator = {"type": "path", "max_depth": 3, "emitter_choice": choice}
        scene = djpt.load_dict(floor_scene(lights, size=16, integrator=integrator))
        images.append([pixels(djpt.render(scene, spp=256, seed=seed)).mean() for seed in range(8)])
    means, sigmas = np.mean(images, axis=1), np.std(images, axis=1, ddof=1) / np.sqrt(8)
    assert sigmas.max() < 0.01 * means.min()
    assert (np.abs(means[1:] - means[0]) <= 4 * np.hypot(sigmas[1:], sigmas[0])).all(), means


def test_gradients_of_angles_stay_attached() -> None:
    scene = lit(light=entry("spot-turned"))
    params = djpt.traverse(scene)
    params["light.cutoff_angle"] = Float(35.0)
    dr.enable_grad(params["light.cutoff_angle"])
    params.update()
    emitter = scene.emitters()[0]
    p = Point3f(*(emitter.to_world @ np.array([0.3, 0, 1.0])).tolist())
    _, weight = emitter.sample_direction(djpt.Interaction3f(p=p), Point2f(0.5))
    dr.backward(weight.x)
    theta, falloff = math.degrees(math.atan(0.3)), 30.0
    slope = (theta - 5) / falloff**2 * 9 / 1.09
    assert float(dr.grad(params["light.cutoff_angle"])[0]) == pytest.approx(slope, rel=1e-4)

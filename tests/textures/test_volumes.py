"""Surfaces painted by volumes: the same pixels as in Mitsuba, and gradients of the numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.errors import SceneError
from tests.kit.derivatives import Slopes

NUMBERS = np.random.default_rng(6).random((3, 4, 5, 3), dtype=np.float32)


def ball(module: Any = djpt, numbers: np.ndarray = NUMBERS, **keys: Any) -> dict[str, Any]:
    """A painted ball under the sky."""
    volume = {
        "type": "gridvolume",
        "data": module.TensorXf(numbers),
        "raw": True,
        "to_world": module.ScalarTransform4f().translate([-1, -1, -1]).scale(2),
        **keys,
    }
    camera = module.ScalarTransform4f().look_at([0, -4, 1], [0, 0, 0], [0, 0, 1])
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "fov": 35,
            "to_world": camera,
            "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
        },
        "sky": {"type": "constant"},
        "ball": {
            "type": "sphere",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "volume", "volume": volume}},
        },
    }


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("filter_type", ["trilinear", "nearest"])
@pytest.mark.sparse(2)
def test_pixels_are_mitsubas(mi: Any, channels: int, filter_type: str) -> None:
    keys = {"numbers": NUMBERS[..., :channels].copy(), "filter_type": filter_type}
    a = np.array(djpt.render(djpt.load_dict(ball(**keys)), spp=8, seed=3))
    b = np.array(mi.render(mi.load_dict(ball(mi, **keys)), spp=8, seed=3))
    np.testing.assert_allclose(a, b, rtol=2e-3, atol=1e-3)


def test_lamps_and_coats_can_have_it() -> None:
    """They ask for the mean: to choose among lights, and between coat and paint."""
    scene = ball()
    paint = scene["ball"]["bsdf"]["reflectance"]
    scene["ball"]["bsdf"] = {"type": "plastic", "diffuse_reflectance": paint}
    lamp = {"type": "rectangle", "to_world": djpt.ScalarTransform4f().translate([0, 0, 3]).rotate([1, 0, 0], 180)}
    scene["lamp"] = {**lamp, "emitter": {"type": "area", "radiance": paint}}
    assert np.array(djpt.render(djpt.load_dict(scene), spp=4)).mean() > 0.1


def test_an_edit_changes_the_choice_of_lamps() -> None:
    """After it, the image is that of a scene that was so from the start."""

    def lamps(brightness: float) -> Any:
        scene = ball()
        del scene["sky"]
        for name, x in (("left", -2), ("right", 2)):
            to_world = djpt.ScalarTransform4f().translate([x, 0, 3]).rotate([1, 0, 0], 180)
            volume = {"type": "gridvolume", "data": np.full((2, 2, 2, 3), brightness if x < 0 else 1.0)}
            glow = {"type": "area", "radiance": {"type": "volume", "volume": volume}}
            scene[name] = {"type": "rectangle", "to_world": to_world, "emitter": glow}
        scene["integrator"]["emitter_choice"] = "tree"
        return djpt.load_dict(scene)

    edited, wanted = lamps(0.01), lamps(5.0)
    before = np.array(djpt.render(edited, spp=8))
    params = djpt.traverse(edited)
    params["left.emitter.radiance.volume.data"] = np.full((2, 2, 2, 3), 5.0)
    params.update()
    after, fresh = (np.array(djpt.render(scene, spp=8)) for scene in (edited, wanted))
    assert before.mean() < 0.5 * after.mean()
    np.testing.assert_array_equal(after, fresh)


def paint(channels: int, schedule: str) -> Slopes:
    """The slope by the numbers of the ball's paint, of one channel or of three."""
    key, numbers = "ball.bsdf.reflectance.volume.data", NUMBERS[..., :channels].copy()
    along = np.random.default_rng(1).random(numbers.shape) / 2
    return Slopes(djpt.load_dict(ball(numbers=numbers)), {key: 0.2 + 0.5 * numbers}, {key: along}, schedule)


@pytest.mark.sparse(6)
@pytest.mark.parametrize("schedule", ["flat", "wave"])
@pytest.mark.parametrize("channels", [1, 3])
def test_gradients_of_numbers(channels: int, schedule: str) -> None:
    slopes = paint(channels, schedule)
    good, text = slopes.check(slopes.keys[0], {})
    assert good, text
    wrong, _ = slopes.check(slopes.keys[0], {}, factor=1.1)
    assert not wrong


def test_numbers_and_colours_are_volumes_too() -> None:
    texture = djpt.load_dict({"type": "volume", "volume": {"type": "rgb", "value": [0.1, 0.2, 0.3]}})
    assert list(djpt.traverse(texture)) == ["volume.value.value"] and texture.is_spatially_varying()
    bright = {"type": "volume", "volume": {"type": "constvolume", "value": 2}}
    with pytest.raises(SceneError, match=r"'reflectance' must lie in \[0, 1\], found 2"):
        djpt.load_dict({"type": "diffuse", "reflectance": bright})

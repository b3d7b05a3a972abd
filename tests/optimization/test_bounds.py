"""Bounds that the meaning of a parameter sets, and steps of parameters of different sizes."""

from math import inf
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.optimization import optimize
from djpt.apps.optimization.variables import usual_bounds
from djpt.errors import ParameterError
from tests.kit.renders import box

ALBEDO, LIGHT = "floor.bsdf.reflectance.value", "sky.radiance.value"


def room(light: float = 1.0, albedo: float = 0.4) -> djpt.Scene:
    """A floor under a sky, both of which the camera sees."""
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "camera": {
                "type": "perspective",
                "fov": 60,
                "to_world": djpt.ScalarTransform4f().look_at([0, -3, 1], [0, 0, 0.6], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}},
            },
            "sky": {"type": "constant", "radiance": light},
            "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": albedo}},
        }
    )


MANY: dict[str, Any] = {
    "type": "scene",
    "metal": {"type": "roughconductor", "material": "Cu", "alpha": 0.2},
    "painted": {
        "type": "rectangle",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": np.full((2, 2, 3), 0.5), "raw": True}},
        "emitter": {"type": "area", "radiance": {"type": "bitmap", "data": np.full((2, 2, 3), 3.0), "raw": True}},
    },
    "ball": {"type": "sphere", "bsdf": {"type": "ref", "id": "metal"}},
    "fog": {
        "type": "cube",
        "bsdf": {"type": "null"},
        "interior": {"type": "homogeneous", "albedo": 0.8, "sigma_t": 2.0, "phase": {"type": "hg", "g": 0.3}},
    },
}


@pytest.mark.parametrize(
    ("ending", "bounds"),
    [
        ("bsdf.reflectance.data", (0, 1)),
        ("emitter.radiance.data", (0, inf)),
        ("alpha.value", (0, 1)),
        ("eta.value", (0, inf)),
        ("k.value", (0, inf)),
        ("albedo.value.value", (0, 1)),
        ("sigma_t.value.value", (0, inf)),
        ("g", (-0.999, 0.999)),
        ("fog.vertex_positions", (-inf, inf)),
    ],
)
def test_bounds_follow_from_what_a_parameter_means(ending: str, bounds: tuple[float, float]) -> None:
    params = djpt.traverse(djpt.load_dict(MANY))
    keys = [key for key in params if key == ending or key.endswith("." + ending)]
    assert keys, list(params)
    assert {usual_bounds(params, key) for key in keys} == {bounds}


def test_light_and_paint_are_found_together_with_rates_of_their_own() -> None:
    target = djpt.render(room(light=5, albedo=0.7), spp=256)
    scene = room(light=3, albedo=0.4)
    found = djpt.optimize(scene, [ALBEDO, LIGHT], [target], iterations=60, rate={ALBEDO: 0.03, LIGHT: 0.15})
    assert np.allclose(found.average[LIGHT], 5, rtol=0.03)
    assert np.allclose(found.average[ALBEDO], 0.7, atol=0.03)
    steps = [abs(float(np.array(found.values[key]).ravel()[0]) - start) for key, start in ((ALBEDO, 0.4), (LIGHT, 3))]
    assert steps[1] > 3 * steps[0]


def test_averages_can_be_put_into_the_scene() -> None:
    scene = djpt.load_dict(box(8))
    params, key = djpt.traverse(scene), "red.reflectance.value"
    target = djpt.render(scene, spp=1)
    found = optimize(scene, key, [target], iterations=2, spp=1)
    params.update(found.average)
    np.testing.assert_allclose(np.array(params[key]).ravel(), found.average[key], rtol=1e-6)


def test_a_start_out_of_bounds_is_refused() -> None:
    scene = room(light=3)
    target = djpt.render(scene, spp=1)
    with pytest.raises(ParameterError, match=r"sky\.radiance\.value: starts at 3 \.\. 3, outside its bounds \(0"):
        optimize(scene, LIGHT, [target], bounds=(0, 1))
    with pytest.raises(ParameterError, match=r"a sigmoid needs finite bounds, found \(0\.0, inf\)"):
        optimize(scene, LIGHT, [target], keeping="sigmoid")


@pytest.mark.parametrize("option", ["rate", "bounds", "priors", "coarse"])
def test_options_for_what_is_no_key_are_refused(option: str) -> None:
    wrong: dict[str, Any] = {option: {"sky.radiance.valu": 1}}
    with pytest.raises(ParameterError, match=rf"'{option}' is given for 'sky.radiance.valu'.*'sky.radiance.value'"):
        optimize(room(), LIGHT, [np.zeros((12, 12, 3))], **wrong)

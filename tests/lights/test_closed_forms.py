"""Brightness of lit floors, and of lights through textures, in closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.jit.types import Point2f, Point3f
from tests.kit.chi_squared import uniform
from tests.kit.one_light import lit, reference

ALBEDO = 0.5


def brightness(light: dict[str, Any], x: float, z: float) -> np.ndarray:
    """The radiance of a diffuse floor at (x, 0, z), seen from above."""
    sensor = {
        "type": "perspective",
        "fov": 0.01,
        "to_world": djpt.ScalarTransform4f().look_at(origin=[x, 5, z], target=[x, 0, z], up=[0, 0, 1]),
        "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
    }
    floor = {
        "type": "rectangle",
        "to_world": djpt.ScalarTransform4f().rotate([1, 0, 0], -90).scale(20),
        "bsdf": {"type": "diffuse", "reflectance": ALBEDO},
    }
    scene = djpt.load_dict(
        {"type": "scene", "integrator": {"type": "path", "max_depth": 2}, "sensor": sensor, "floor": floor, "l": light}
    )
    return np.array(djpt.render(scene, spp=16)).ravel()


def down(height: float = 2.0) -> Any:
    return djpt.ScalarTransform4f().look_at(origin=[0, height, 0], target=[0, 0, 0], up=[0, 0, 1])


@pytest.mark.parametrize("x", [0.0, 0.3, 0.7])
class TestClosedForms:
    """Irradiance E gives a radiance of E albedo / pi."""

    def test_point(self, x: float) -> None:
        cos = 2 / math.hypot(2, x)
        expected = 3 / (4 + x * x) * cos * ALBEDO / math.pi
        found = brightness({"type": "point", "position": [0, 2, 0], "intensity": 3.0}, x, 0)
        np.testing.assert_allclose(found, expected, rtol=1e-4)

    def test_spot(self, x: float) -> None:
        theta = math.degrees(math.atan2(x, 2))
        falloff = min(1.0, max(0.0, (18 - theta) / (18 - 5)))
        light = {"type": "spot", "to_world": down(), "cutoff_angle": 18.0, "beam_width": 5.0, "intensity": 3.0}
        expected = 3 * falloff / (4 + x * x) * (2 / math.hypot(2, x)) * ALBEDO / math.pi
        np.testing.assert_allclose(brightness(light, x, 0), expected, rtol=1e-3)

    def test_directional(self, x: float) -> None:
        light = {"type": "directional", "direction": [1, -2, 2], "irradiance": 3.0}
        np.testing.assert_allclose(brightness(light, x, 0), 3 * (2 / 3) * ALBEDO / math.pi, rtol=1e-4)

    def test_projector(self, x: float) -> None:
        """A screen across the axis is lit evenly: E = pi irradiance / height^2, out to height tan(fov / 2)."""
        light = {"type": "projector", "to_world": down(), "fov": 36.0, "irradiance": 3.0}
        expected = 3 * ALBEDO / 4 if x < 2 * math.tan(math.radians(18)) else 0
        np.testing.assert_allclose(brightness(light, x, 0), expected, rtol=1e-4)

    def test_constant(self, x: float) -> None:
        """Every sample brings pi f L."""
        scene = lit(light={"type": "constant", "radiance": 3.0})
        _, weight = scene.sample_emitter_direction(reference(), Point2f(*uniform(1024)), False)
        np.testing.assert_allclose(np.array(weight), 3 * 4 * math.pi, rtol=1e-6)


def test_spot_shows_its_picture_the_right_way() -> None:
    """Left and right of the four quadrants of a texture, as a viewer along the light's axis sees them."""
    picture = np.array([[1, 2], [3, 4]], np.float32)[..., None]
    texture = {"type": "bitmap", "data": djpt.TensorXf(picture), "raw": True, "filter_type": "nearest"}
    scene = lit(light={"type": "spot", "cutoff_angle": 40.0, "beam_width": 40.0, "texture": texture})
    for x, y, value in ((-0.2, -0.2, 1), (0.2, -0.2, 2), (-0.2, 0.2, 3), (0.2, 0.2, 4)):
        _, weight = scene.emitters()[0].sample_direction(djpt.Interaction3f(p=Point3f(x, y, 1)), Point2f(0.5))
        assert float(weight.x[0]) * (1 + 2 * 0.04) == pytest.approx(value, rel=1e-5)


def test_a_constant_texture_dims_a_spot() -> None:
    """Mitsuba 3.9.1 refuses one in a description, and has one without effect by default."""
    spots = [{"type": "spot", "texture": texture} for texture in (1.0, {"type": "rgb", "value": [0.5, 0.25, 0]})]
    bright, dim = (lit(light=spot).emitters()[0] for spot in spots)
    it, sample = djpt.Interaction3f(p=Point3f(0.1, 0, 1)), Point2f(0.3, 0.6)
    for method in (lambda e: e.sample_direction(it, sample), lambda e: e.sample_ray(0, 0, sample, sample)):
        ratio = np.array(method(dim)[1]) / np.array(method(bright)[1])
        np.testing.assert_allclose(ratio.ravel(), [0.5, 0.25, 0], rtol=1e-6)
    assert dim.power() == pytest.approx(0.25 * bright.power())

"""The brightest lights: pixels of what is accepted are finite."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import DjptError, SceneError
from djpt.jit.types import TensorXf

TEXELS = np.full((4, 8, 3), 0.5, np.float32)
LIGHTS: dict[str, Any] = {
    "constant": lambda x: {"type": "constant", "radiance": x},
    "area": lambda x: {"type": "sphere", "center": [0, 0, 9], "emitter": {"type": "area", "radiance": x}},
    "directional": lambda x: {"type": "directional", "direction": [0, 0, -1], "irradiance": x},
    "point": lambda x: {"type": "point", "position": [0, 0, 2], "intensity": x},
    "spot": lambda x: {"type": "spot", "to_world": T().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]), "intensity": x},
    "envmap": lambda x: {"type": "envmap", "data": TensorXf(2 * x * TEXELS)},
}


def scene(name: str, value: float) -> Any:
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    place = T().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    sensor = {"type": "perspective", "to_world": place, "film": film}
    return djpt.load_dict(
        {"type": "scene", "sensor": sensor, "floor": {"type": "rectangle"}, "light": LIGHTS[name](value)}
    )


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.sparse(2)
def test_the_brightest_light_has_finite_pixels(name: str) -> None:
    image = np.array(djpt.render(scene(name, 1e30), spp=64))
    assert np.isfinite(image).all() and image.max() > 1e27


@pytest.mark.parametrize("name", LIGHTS)
def test_brighter_lights_are_refused(name: str) -> None:
    with pytest.raises(SceneError, match=r"must be at most 1e\+30, found 1e\+38"):
        scene(name, 1e38)


def test_edits_are_checked_as_well() -> None:
    params = djpt.traverse(scene("constant", 1.0))
    params["light.radiance.value"] = djpt.Color3f(1e30)
    params.update()
    with pytest.raises(DjptError, match=r"must be at most 1e\+30"):
        params["light.radiance.value"] = djpt.Color3f(1e31)

"""A camera that moves before what moves, in the light of a lamp that moves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt import AnimatedTransform4f as A
from djpt.core.transforms import ScalarTransform4f as T

pytestmark = pytest.mark.slow

DEPTH = {"max_depth": 3}
INTEGRATORS: dict[str, dict[str, Any]] = {"path": DEPTH, "guided": DEPTH, "direct": {}, "depth": {}}


def scene() -> Any:
    """A room's corner through a camera that pans; everything of note moves, the camera, too."""
    here, there = T().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]), T().look_at([1, 0.5, 5], [0.3, 0, 0], [0.1, 1, 0])
    above = T().translate([-1, 1.5, 0]).rotate([1, 0, 0], 90).scale(0.5)
    box = A(
        {0: T().translate([-0.8, 0, 0]).scale(0.4), 1: T().translate([0.4, 0, 0.5]).rotate([0, 0, 1], 70).scale(0.4)}
    )
    film = {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": 40, "to_world": A({0: here, 1: there}), "shutter_close": 1.0, "film": film}
    lamp = {"type": "rectangle", "to_world": A({0: above, 1: T().translate([2, 0, 0]) @ above})}
    return djpt.load_dict(
        {
            "type": "scene",
            "sensor": sensor,
            "floor": {"type": "rectangle", "to_world": T().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4)},
            "wall": {"type": "rectangle", "to_world": T().translate([0, 0, -2]).scale(8)},
            "box": {"type": "cube", "to_world": box},
            "ball": {"type": "sphere", "radius": 0.3, "to_world": A({0: T(), 1: T().translate([1, 0.5, 0])})},
            "lamp": {**lamp, "emitter": {"type": "area", "radiance": 6.0}},
        }
    )


def z_score(name: str, rounds: int = 4, moments: int = 4) -> float:
    """The distance of blurred images' mean from that of still ones by the same integrator, in standard errors."""
    moving, random = scene(), np.random.default_rng(3)
    spp = 16

    def integrator() -> Any:
        return djpt.load_dict({"type": name, **INTEGRATORS[name]})

    # Left and right count differently: blur along the film is seen, too.
    weight = np.linspace(0.5, 1.5, 12)[None, :, None]
    blurred, still = [], []
    for k in range(rounds):
        image = djpt.render(moving, spp=spp, seed=100 + k, integrator=integrator())
        blurred.append((np.array(image, np.float64) * weight).mean((0, 1)))
        images = [
            djpt.render(moving.at_time(t), spp=spp // moments, seed=1000 * k + i, integrator=integrator())
            for i, t in enumerate((np.arange(moments) + random.random(moments)) / moments, 1)
        ]
        still.append((np.mean([np.array(image, np.float64) for image in images], axis=0) * weight).mean((0, 1)))
    a, b = np.array(blurred)[:, 0], np.array(still)[:, 0]
    return float(abs(a.mean() - b.mean()) / np.sqrt((a.var(ddof=1) + b.var(ddof=1)) / rounds))


@pytest.mark.parametrize("name", INTEGRATORS)
def test_an_image_is_the_mean_of_stills(name: str) -> None:
    assert z_score(name) < 4

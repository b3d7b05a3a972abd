"""The examples of CONTRIBUTING.md do what it says."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f
from tests.kit.processes import ROOT

ALBEDO = 0.4
DISTANCE = 2.0


@pytest.fixture(scope="module")
def examples() -> dict[str, Any]:
    if not (ROOT / "CONTRIBUTING.md").exists():
        pytest.skip("not a working copy of the repository")
    names: dict[str, Any] = {"__name__": "examples"}
    for block in re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.DOTALL):
        exec(block, names)
    return names


def scene(integrator: str) -> Any:
    """A wall, seen and lit from the same point at `DISTANCE` in front of it."""
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": integrator},
            "sensor": {
                "type": "perspective",
                "fov": 0.1,
                "to_world": ScalarTransform4f().look_at([0, 0, DISTANCE], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 2, "height": 2, "rfilter": {"type": "box"}},
            },
            "wall": {"type": "rectangle", "bsdf": {"type": "lommel_seeliger", "albedo": ALBEDO}},
            "lamp": {"type": "point", "position": [0, 0, DISTANCE], "intensity": 1.0},
        }
    )


def test_the_material(examples: dict[str, Any]) -> None:
    """L = f cos I / d^2 with f = albedo / (8 pi) at normal incidence and exitance."""
    image = np.array(djpt.render(scene("path"), spp=4))
    np.testing.assert_allclose(image, ALBEDO / (8 * math.pi) / DISTANCE**2, rtol=1e-4)


def test_the_material_is_editable(examples: dict[str, Any]) -> None:
    lit = scene("path")
    params = djpt.traverse(lit)
    (key,) = (k for k in params.keys() if "albedo" in k)  # noqa: SIM118
    params[key] = 2 * ALBEDO
    params.update()
    image = np.array(djpt.render(lit, spp=4))
    np.testing.assert_allclose(image, 2 * ALBEDO / (8 * math.pi) / DISTANCE**2, rtol=1e-4)


def test_the_integrator(examples: dict[str, Any]) -> None:
    image = np.array(djpt.render(scene("facing_ratio"), spp=1))
    np.testing.assert_allclose(image, 1, rtol=1e-5)

"""A ball of one material over a floor, and the materials that Mitsuba renders alike."""

from __future__ import annotations

from typing import Any

from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.materials import NAMES, UNKNOWN_TO_MITSUBA, plugin_of

__all__ = ["SHARED", "ball"]


MISTAKEN = {
    # A smooth and a delta lobe: energy is lost, see `BlendBSDF`.
    "blendbsdf-mirror",
    # Facets are drawn from a rougher surface, and the weights don't know: see `RoughDielectric`.
    "roughdielectric-all facets",
}
"""Materials that Mitsuba 3.9.1 renders wrongly."""


SHARED = [name for name in NAMES if plugin_of(name) not in UNKNOWN_TO_MITSUBA and name not in MISTAKEN]
"""Materials that both renderers render alike."""


def ball(material: dict[str, Any], size: int = 64, integrator: str = "path") -> dict[str, Any]:
    """A ball over a floor under a lamp and a faint sky, seen from above and from its side."""
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 8},
        "sensor": {
            "type": "perspective",
            "fov": 32,
            "to_world": T().look_at(origin=[1, 1.5, 4.5], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.4, 0.5, 0.6]}},
        "lamp": {
            "type": "rectangle",
            "to_world": T().look_at(origin=[-2, 3, 2.5], target=[0, 0, 0], up=[0, 1, 0]),
            "emitter": {"type": "area", "radiance": 4.0},
        },
        "floor": {
            "type": "rectangle",
            "to_world": T().translate([0, -1.05, 0]).rotate([1, 0, 0], -90).scale(4),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.3, 0.2]}},
        },
        "ball": {"type": "sphere", "bsdf": material},
    }

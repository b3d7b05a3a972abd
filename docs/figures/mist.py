"""Media."""

from __future__ import annotations

from typing import Any

import djpt
from djpt import ScalarTransform4f as T
from djpt.images.sheets import Tile, captioned_sheet, shown
from places import IMAGES

__all__ = ["media"]

NULL = {"type": "null"}
FORWARD = {"type": "hg", "g": 0.6}


def media() -> None:
    """The Cornell box in fog, with a ball of coloured fog, and with a ball of wax."""
    panels = [
        ("fog", "sigma_t 0.5, albedo 0.9", fog()),
        ("coloured fog", "scattering forward", ball({"type": "rgb", "value": [2.0, 5.0, 12.0]}, 0.97)),
        ("wax", "sigma_t 40, bright", ball(40.0, {"type": "rgb", "value": [0.999, 0.995, 0.97]})),
    ]
    tiles = [
        Tile(title, subtitle, shown(djpt.render(djpt.load_dict(scene), spp=512))) for title, subtitle, scene in panels
    ]
    djpt.write(str(IMAGES / "media.png"), captioned_sheet(tiles))


def room(size: int = 200) -> dict[str, Any]:
    """The Cornell box, to be rendered by `volpathmis`."""
    scene = djpt.cornell_box()
    scene["integrator"] = {"type": "volpathmis", "max_depth": 128, "rr_depth": 128}
    scene["sensor"]["film"].update(width=size, height=size)
    return scene


def fog() -> dict[str, Any]:
    """Fog between the walls."""
    scene = room()
    medium = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.9}
    scene["fog"] = {"type": "cube", "to_world": T().scale(0.985), "bsdf": NULL, "interior": medium}
    return scene


def ball(sigma_t: Any, albedo: Any) -> dict[str, Any]:
    """A ball in place of the boxes."""
    scene = room()
    del scene["small-box"], scene["large-box"]
    medium = {"type": "homogeneous", "sigma_t": sigma_t, "albedo": albedo, "phase": FORWARD}
    scene["ball"] = {"type": "sphere", "center": [0, -0.45, 0.1], "radius": 0.5, "bsdf": NULL, "interior": medium}
    return scene

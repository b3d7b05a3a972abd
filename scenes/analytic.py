"""A scene whose image is known in closed form."""

from __future__ import annotations

from typing import Any

from djpt.core.transforms import ScalarTransform4f as T
from djpt.scenes.cornell import cornell_box

__all__ = ["furnace"]


def furnace(reflectance: float = 0.5, radiance: float = 1.0) -> dict[str, Any]:
    """The closed Cornell box whose surfaces all reflect and emit equally: its radiance is known.

    From any point the same radiance arrives from all directions, so with `max_depth` n each pixel is::

        radiance (1 + reflectance + ... + reflectance^(n - 1)) = radiance (1 - reflectance^n) / (1 - reflectance)

    or radiance / (1 - reflectance) without a limit (-1). The camera stands inside; 64x64 pixels, box
    filter, `path` with 8 bounces.

    Args:
        reflectance: albedo of all surfaces, in [0, 1).
        radiance: emitted by all surfaces (W m^-2 sr^-1).
    """
    scene = cornell_box()
    sensor = scene["sensor"]
    sensor.update(to_world=T().look_at(origin=[0, 0, 0.98], target=[0, 0, 0], up=[0, 1, 0]), fov=80.0)
    sensor["film"].update(width=64, height=64, rfilter={"type": "box"})
    scene["front"] = {"type": "rectangle", "to_world": T().translate([0, 0, 1]).rotate([0, 1, 0], 180)}
    for key in ("light", "white", "green", "red"):
        del scene[key]
    scene = {"type": "scene", "grey": {"type": "diffuse", "reflectance": reflectance}, **scene}
    for node in scene.values():
        if isinstance(node, dict) and node["type"] in ("rectangle", "cube"):
            node["bsdf"] = {"type": "ref", "id": "grey"}
            node["emitter"] = {"type": "area", "radiance": radiance}
    return scene

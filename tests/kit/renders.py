"""Small scenes for the engine's tests, rendered by djpt and by Mitsuba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T

__all__ = ["Edit", "box", "grey_room", "lights", "ours", "pixels", "spheres", "theirs", "two_sided"]

Edit = Callable[[dict[str, Any]], None]


def box(
    size: int | tuple[int, int] = 32,
    rfilter: str | dict[str, Any] = "box",
    integrator: dict[str, Any] | None = None,
    edit: Edit | None = None,
    **film: Any,
) -> dict[str, Any]:
    """The Cornell box, small; further keywords are the film's."""
    scene = djpt.cornell_box()
    width, height = (size, size) if isinstance(size, int) else size
    rfilter = {"type": rfilter} if isinstance(rfilter, str) else rfilter
    scene["sensor"]["film"].update(width=width, height=height, rfilter=rfilter, **film)
    if integrator is not None:
        scene["integrator"] = integrator
    if edit is not None:
        edit(scene)
    return scene


def ours(scene: dict[str, Any], spp: int = 4, seed: int = 0, **options: Any) -> np.ndarray:
    """The image by djpt, (H, W, C), with lights numbered in the order of the description, as by `theirs`."""
    return pixels(djpt.render(djpt.load_dict(scene, optimize=False), spp=spp, seed=seed, **options))


def theirs(scene: dict[str, Any], spp: int = 4, seed: int = 0) -> np.ndarray:
    """The image by Mitsuba with nothing merged: equal seeds then choose equal emitters."""
    return djpt.validation.mitsuba_renderer(scene, optimize=False)(spp, seed)


def pixels(image: Any) -> np.ndarray:
    return np.array(image)


# ---------------------------------------------------------------- edits of the Cornell box


def lights(*names: str) -> Edit:
    """Add lights: a point, a sphere, a turned cube, the sky."""
    available: dict[str, Any] = {
        "point": {"type": "point", "position": [0, 0.5, 0.5], "intensity": {"type": "rgb", "value": [0.5, 1, 0.2]}},
        "ball": {
            "type": "sphere",
            "center": [0.4, -0.2, 0.6],
            "radius": 0.2,
            "emitter": {"type": "area", "radiance": 2.0},
        },
        "block": {
            "type": "cube",
            "to_world": T().translate([-0.4, 0.2, 0.5]).rotate([0, 0.6, 0.8], 40).scale(0.15),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1, 0, 3]}},
        },
        "sky": {"type": "constant", "radiance": 0.3},
    }

    def edit(scene: dict[str, Any]) -> None:
        scene.update({name: available[name] for name in names or available})

    return edit


def spheres(scene: dict[str, Any]) -> None:
    """Put two spheres in place of the boxes, one turned and two-sided."""
    del scene["small-box"], scene["large-box"]
    red, white = {"type": "ref", "id": "red"}, {"type": "ref", "id": "white"}
    turned = T().translate([-0.4, -0.5, -0.2]).rotate([0.6, 0.8, 0], 30).scale(0.5)
    scene["small-sphere"] = {"type": "sphere", "center": [0.4, -0.6, 0.2], "radius": 0.4, "bsdf": red}
    scene["large-sphere"] = {"type": "sphere", "to_world": turned, "bsdf": {"type": "twosided", "inner": white}}


def two_sided(scene: dict[str, Any]) -> None:
    """Put different materials on the two sides of a sphere and of a flipped wall."""
    spheres(scene)
    front, back = ({"type": "diffuse", "reflectance": albedo} for albedo in (0.2, 0.7))
    scene["small-sphere"]["bsdf"] = {"type": "twosided", "front": front, "back": back}
    scene["back"].update(flip_normals=True, bsdf=scene["small-sphere"]["bsdf"])


def grey_room(scene: dict[str, Any]) -> None:
    """Make every surface the same grey on both sides, so that no camera ray meets black."""
    for node in scene.values():
        if isinstance(node, dict) and node["type"] in ("rectangle", "cube"):
            node["bsdf"] = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": 0.5}}

"""Rectangles of many materials side by side, which show their albedos."""

from __future__ import annotations

from typing import Any

import numpy as np

import djpt
from tests.kit.renders import pixels

__all__ = ["albedos", "swatches"]


def swatches(**bsdfs: dict[str, Any]) -> Any:
    """Rectangles side by side, seen from above: pixels show their albedos."""
    film = {"type": "hdrfilm", "width": 8 * len(bsdfs), "height": 8, "rfilter": {"type": "box"}}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "aov", "aovs": "a:albedo"},
        "sky": {"type": "constant", "radiance": 1.0},
        "sensor": {
            "type": "perspective",
            "fov": 90,
            "to_world": djpt.ScalarTransform4f().look_at([0, 0, len(bsdfs)], [0, 0, 0], [0, 1, 0]),
            "film": film,
        },
    }
    for i, (name, bsdf) in enumerate(bsdfs.items()):
        place = djpt.ScalarTransform4f().translate([2.0 * i + 1 - len(bsdfs), 0, 0])
        scene[name] = {"type": "rectangle", "to_world": place, "bsdf": bsdf}
    return djpt.load_dict(scene)


def albedos(scene: Any, **names: Any) -> dict[str, np.ndarray]:
    """The colours of `swatches`."""
    image = pixels(djpt.render(scene, spp=4))
    width = image.shape[1] // len(names)
    return {name: image[:, i * width + 1 : (i + 1) * width - 1].mean(axis=(0, 1)) for i, name in enumerate(names)}

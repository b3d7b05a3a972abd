"""The proof: djpt, Mitsuba and their difference at one seed."""

from __future__ import annotations

from typing import Any

import numpy as np

import djpt
from djpt.images.sheets import Tile, captioned_sheet, shown
from djpt.validation.bridge import mitsuba_renderer
from djpt.validation.comparison import agreement
from djpt.validation.report import difference_picture
from places import IMAGES, LADDER

__all__ = ["proof"]

SPP, SEED = 64, 0

AMPLIFIED = 100_000
"""How many times the difference is enlarged, so that anything of it can be seen."""


def room(size: int) -> dict[str, Any]:
    """Silver, glass and rough copper in the Cornell box, in words that Mitsuba has, too.

    The whole ceiling is the lamp: paths that leave the balls find it often, where a small one would cause fireflies.
    """
    scene: dict[str, Any] = LADDER["room"](size)
    scene["large-sphere"]["bsdf"] = {"type": "conductor", "material": "Ag"}
    light = djpt.ScalarTransform4f().translate([0, 0.99, 0]).rotate([1, 0, 0], 90)
    scene["light"]["to_world"] = light
    scene["light"]["emitter"]["radiance"]["value"] = [1.6, 1.35, 1.05]
    scene["integrator"] = {"type": "path", "max_depth": 8}
    return scene


def proof() -> None:
    """One seed, two renderers; the difference enlarged, red where djpt is brighter and blue where it is darker."""
    scene = room(272)
    # Mitsuba may merge shapes of a scene for speed, which reorders its random numbers.
    reference = mitsuba_renderer(scene, optimize=False)(SPP, SEED)
    image = np.array(djpt.render(djpt.load_dict(scene, optimize=False), spp=SPP, seed=SEED), np.float32)
    found = agreement(image, reference)
    samples = f"{SPP} samples per pixel, seed {SEED}"
    tiles = [
        Tile("djpt", samples, shown(image)),
        Tile("Mitsuba 3", samples, shown(reference)),
        Tile(
            f"difference, {AMPLIFIED:_}-fold".replace("_", " "),
            f"{found.share:.2%} of pixels within {found.tolerance:.1%}",
            difference_picture(image, reference, 1 / AMPLIFIED),
        ),
    ]
    djpt.write(IMAGES / "proof.png", captioned_sheet(tiles))

"""Long renders: where adaptive ones take their samples."""

from __future__ import annotations

import numpy as np

import djpt
from djpt.images.sheets import Tile, captioned_sheet, shown
from places import IMAGES

__all__ = ["adaptive"]


def adaptive() -> None:
    """A picture whose pixels have equal numbers of samples, an adaptive one, and the numbers of that one."""
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=240, height=240)
    description["integrator"]["hide_emitters"] = True
    scene, tiles = djpt.load_dict(description), []
    for is_adaptive, title in ((False, "256 samples per pixel"), (True, "256 on average")):
        *_, found = djpt.render_passes(scene, spp=256, round_spp=16, adaptive=is_adaptive)
        error = found.error().overall
        tiles.append(Tile(title, f"relative RMSE {error:.2%}", shown(found.image())))
    samples = found.samples().numpy()
    grey = np.rint(255 * samples / samples.max()).astype(np.uint8)
    counts = Tile("samples", f"{samples.min():.0f} (black) to {samples.max():.0f}", grey[..., None].repeat(3, axis=2))
    djpt.write(IMAGES / "adaptive.png", captioned_sheet([*tiles, counts]))

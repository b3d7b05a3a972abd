"""Maps of derivatives: cameras before scenes of the gradient matrix, block by block."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.gradients.block_maps import BlockMap, block_map
from tests.gradients.matrix import CELLS

STEP = 0.02
"""Of differences: a fraction of a pixel."""

SCENES = {
    "overlapping bodies, aside, prb_projective": (64, 12),
    "a textured mesh, turn, direct_projective": (256, 12),
    "soft shadows, turn, direct_projective": (256, 12),
    "a mirror, aside, prb_projective": (16, 8),
    "a ball of glass, aside, prb_projective": (256, 6),
}
"""The samples per pixel, and the number of derivative images."""

WINDOWS = {"a ball of glass, aside, prb_projective": (32, 16, 16, 8)}
"""The columns and rows, and their numbers, of crop windows: within the ball, whose outline is noisy."""


def map_of(name: str, **settings: int) -> BlockMap:
    spp, seeds = SCENES[name]
    cell = replace(CELLS[f"a camera before a scene: {name}"], spp=spp, spp_difference=1024)
    if name in WINDOWS:
        camera, sides = cell.camera(), ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
        film = {**camera["film"], **dict(zip(sides, WINDOWS[name], strict=True))}
        cell = replace(cell, camera=lambda: {**camera, "film": film}, spp_difference=16384)
    return block_map(cell, seeds, 2 * seeds, STEP, **settings)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_derivatives_are_right_in_all_blocks(name: str) -> None:
    found = map_of(name)
    assert found.right, found


@pytest.mark.slow
@pytest.mark.parametrize("part", ["sppc", "sppp", "sppi"])
def test_maps_show_what_is_missing(part: str) -> None:
    """The inside of surfaces, outlines, or the edges of shadows and of the light that surfaces reflect."""
    found = map_of("soft shadows, turn, direct_projective", **{part: 0})
    assert not found.right and found.worst.rejected > 1, found

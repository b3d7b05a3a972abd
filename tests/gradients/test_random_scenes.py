"""Scenes drawn at random, whose derivatives are compared with differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gradients.cells import Cell
from tests.gradients.random_scenes import random_cell

SEEDS = (11, 2, 3, 4, 5, 6, 0, 7, 12, 14, 16, 18)
"""Those of scenes that aren't refused, and in which something is seen to move; the first one is fast."""

MOST = 16
"""The most seeds of derivatives, and an eighth of those of differences."""

CORNERS = (
    # Where an outline arrives at the floor behind it, in the sun: a shadow begins there behind a sliver of the floor.
    (8, 8, 7),
    # Where two bodies meet, in the sun, and one throws a shadow on the other that grows slowly along the curve.
    (13, 3, 13),
)
"""Pixels with edges of two kinds that meet, by the seed of the scene, the column and the row."""


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.sparse(12)
def test_derivatives_of_random_scenes_are_not_wrong(seed: int) -> None:
    cell = random_cell(seed)
    outcome = cell.measured(MOST)
    assert outcome.verdict != "wrong", f"{cell.label}: {outcome}"


@pytest.mark.parametrize(("seed", "x", "y"), CORNERS)
@pytest.mark.sparse(2)
def test_where_edges_of_two_kinds_meet_each_counts_once(seed: int, x: int, y: int) -> None:
    outcome = pixel(random_cell(seed), x, y).measured(8)
    assert outcome.verdict == "right", outcome


def pixel(cell: Cell, x: int, y: int) -> Cell:
    """A pixel alone, in direct light and with many samples."""
    node = cell.camera()
    window = {"crop_offset_x": x, "crop_offset_y": y, "crop_width": 1, "crop_height": 1}
    node["film"] = {**node["film"], **window}
    return replace(
        cell,
        camera=lambda: node,
        weights=np.ones((1, 1, 3)),
        integrator={"type": "direct_projective"},
        step=0.008,
        spp=65536,
        spp_difference=65536,
    )

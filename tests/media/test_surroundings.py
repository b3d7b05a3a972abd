"""Fog together with everything else: each BSDF on a mesh, an environment map, light from near and far; as Mitsuba."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.materials import PLUGINS, UNKNOWN_TO_MITSUBA, bsdf, sets_of
from tests.kit.media_scenes import NULL, colour, fog, lit_ball
from tests.kit.mesh_scenes import ball_file
from tests.kit.renders import ours, theirs

FAST = ("null", "roughdielectric")
FIRST = [next(iter(sets_of(plugin))) for plugin in PLUGINS if plugin not in UNKNOWN_TO_MITSUBA]
CASES = [pytest.param(n, id=n, marks=() if n.split("-")[0] in FAST else pytest.mark.slow) for n in FIRST]
SEEDS = 8
MEDIUM = fog(0.6, colour(0.9, 0.8, 0.6), phase={"type": "hg", "g": 0.4})


def sky() -> np.ndarray:
    """A cloudy sky, (8, 16, 3)."""
    return np.random.default_rng(2).uniform(0.2, 2, (8, 16, 3)).astype(np.float32)


def ball_in_fog(folder: Path, material: dict[str, Any], integrator: str) -> dict[str, Any]:
    """A ball of triangles in a cube of fog, on a floor, under a sky and a lamp."""
    scene = lit_ball(None, integrator=integrator, max_depth=6, size=12)
    scene["sky"] = {"type": "envmap", "data": sky()}
    scene["lamp"] = {"type": "point", "position": [2, 3, 2], "intensity": colour(6, 5, 4)}
    scene["ball"] = {"type": "ply", "filename": ball_file(folder), "to_world": T().scale(0.6), "bsdf": material}
    scene["fog"] = {"type": "cube", "to_world": T().scale(1.1), "bsdf": NULL, "interior": MEDIUM}
    scene["floor"] = {"type": "rectangle", "to_world": T().translate([0, -1.5, 0]).rotate([1, 0, 0], -90).scale(4)}
    return scene


@pytest.mark.parametrize("name", CASES)
@pytest.mark.sparse(4)
def test_each_material_in_fog(name: str, tmp_path: Path) -> None:
    """The parts of the picture have Mitsuba's means."""
    scene = ball_in_fog(tmp_path, bsdf(name), "volpath")
    mine, reference = (quarters(render, scene, first) for render, first in ((ours, 0), (theirs, 100)))
    error = np.sqrt((mine.var(axis=0, ddof=1) + reference.var(axis=0, ddof=1)) / SEEDS)
    difference = np.abs(mine.mean(axis=0) - reference.mean(axis=0))
    # Each error is estimated from 14 numbers: 5 of them are passed by one test in 400 of 12.
    assert (difference < 5.5 * error).all()
    assert difference.max() < 0.1 * reference.mean()


def quarters(render: Any, scene: dict[str, Any], first: int) -> np.ndarray:
    """The means of the quarters of images, (SEEDS, 12)."""
    images = np.array([render(scene, spp=64, seed=first + seed) for seed in range(SEEDS)])
    return images.reshape(SEEDS, 2, 6, 2, 6, 3).mean(axis=(2, 4)).reshape(SEEDS, 12)

"""Curves that move, in the light of points, lamps and the sky, whole and with open ends that are seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float
from tests.silhouettes.camera_cases import MOTIONS
from tests.silhouettes.cases import FLOOR, LAMP, POINT, PRB, WALL, Case, ball, sensor, shift, sky
from tests.silhouettes.fog_cases import everywhere, room

STRANDS = str(Path(__file__).parent / "strand.txt")
"""A thick tube of three segments and a thin one beside it, near the origin."""
TAPERED = str(Path(__file__).parent / "tapered.txt")
"""A tube whose ends are points."""
BENDS = np.random.default_rng(4).normal(size=(10, 4)).astype(np.float32) * np.float32([0.5, 0.5, 0.5, 0.05])
ASIDE = sensor((-2, -1, 5))
FROM_ITS_END = sensor((5, 1, 2))


def strands(**more: Any) -> dict[str, Any]:
    return {"type": "bsplinecurve", "filename": STRANDS} | more


def hanging() -> dict[str, Any]:
    return strands(to_world=T().translate([1, 1, 3]).scale(0.6))


def bend(params: Any, theta: Float) -> None:
    """Move all control points, each in its own direction, and change the radii."""
    params["moving.control_points"] = Float(params["moving.control_points"]) + Float(BENDS.ravel()) * theta


def aside(params: Any, theta: Float) -> None:
    """Move all control points by theta along a direction."""
    motion = np.tile(np.float32([1, 0.3, 0, 0]), 10)
    params["moving.control_points"] = Float(params["moving.control_points"]) + Float(motion) * theta


SOME = {"spp": 2048, "step": 0.02, "spp_difference": 16384}
"""Small steps: curves are cut into pieces, whose number may change."""
TEXTURE = {"type": "bitmap", "data": np.random.default_rng(2).random((4, 6, 3)).astype(np.float32), "raw": True}
TURNED = T().rotate([0.6, 0.8, 0], 35).scale(0.9)
FLOOR_BELOW = {**FLOOR, "to_world": T().translate([0, 0, -2]).scale(4)}


def spin(params: Any, theta: Float) -> None:
    """Turn, move and stretch an instance."""
    motion = djpt.Transform4f().translate([0.5 * theta, 0, 0]).rotate([0, 1, 0], 30 * theta).scale(1 + 0.3 * theta)
    params["moving.to_world"] = motion @ djpt.Transform4f(params["moving.to_world"])


CASES: dict[str, Case] = {
    "strands bend in the light of a point": Case(lambda: {"moving": strands(), "light": POINT}, bend, **SOME),
    "strands bend under a sky": Case(lambda: {"moving": strands(), "sky": sky()}, bend, PRB, **SOME),
    "strands whose ends are seen": Case(
        lambda: {"moving": strands(), "light": POINT, "sensor": FROM_ITS_END}, bend, **SOME
    ),
    "strands with a texture": Case(
        lambda: {"moving": strands(bsdf={"type": "diffuse", "reflectance": TEXTURE}), "light": POINT}, bend, **SOME
    ),
    "the shadow of strands in the light of a point": Case(
        lambda: {"moving": hanging(), "light": POINT, "floor": FLOOR, "sensor": ASIDE}, aside
    ),
    "the shadow of strands in the light of a lamp": Case(
        lambda: {"moving": hanging(), "lamp": LAMP, "floor": FLOOR, "sensor": ASIDE}, aside, thorough=True
    ),
    "strands in indirect light": Case(
        lambda: {"moving": hanging(), "light": POINT, "floor": FLOOR, "wall": WALL, "sensor": ASIDE},
        aside,
        PRB,
        depth=4,
        spp=1024,
    ),
    "strands in a floor": Case(lambda: {"moving": strands(), "floor": FLOOR, "light": POINT}, bend, **SOME),
    "a ball behind strands": Case(
        lambda: {"still": strands(), "moving": ball(center=[0, 0, -1]), "light": POINT}, shift("moving.to_world")
    ),
    "a lamp moves above a strand": Case(
        lambda: {
            "strand": strands(filename=TAPERED, to_world=T().translate([1, 1, 3]).scale(0.6)),
            "moving": LAMP,
            "floor": FLOOR,
            "sensor": ASIDE,
        },
        shift("moving.to_world"),
        ("direct_projective",),
        thorough=True,
        spp=512,
    ),
    "a camera in fog, turn: strands": Case(
        lambda: room(everywhere(), strands=strands(to_world=T().translate([0, 0.5, 1]).scale(0.8))),
        MOTIONS["turn"],
        ("volpath",),
        depth=3,
        spp=1024,
        spp_difference=16384,
        by="volpath",
    ),
    "an instance of strands": Case(
        lambda: {
            "group": {"type": "shapegroup", "strands": strands()},
            "moving": {"type": "instance", "to_world": TURNED, "of": {"type": "ref", "id": "group"}},
            "floor": FLOOR_BELOW,
            "light": POINT,
        },
        spin,
        **SOME,
    ),
    **{
        f"a camera, {motion}: strands": Case(
            lambda: {"strands": strands(), "floor": FLOOR_BELOW, "light": POINT}, MOTIONS[motion], spp=512
        )
        for motion in ("step aside", "turn", "field of view")
    },
}

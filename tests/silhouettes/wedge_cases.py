"""Narrow wedges between surfaces: bodies on a floor that overhang it, or that it cuts, and furrows of meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from tests.silhouettes.camera_cases import MOTIONS
from tests.silhouettes.cases import PRB, Case, ball, sensor, shift, slide

WHITE, GREY = {"type": "diffuse", "reflectance": 0.8}, {"type": "diffuse", "reflectance": 0.4}
FLOOR = {"type": "rectangle", "to_world": T().scale(6), "bsdf": GREY}
SKY = {"type": "constant", "radiance": 1.0}
SHIFT = np.float32([0.13, 0, 0])
FROM_ABOVE, ASIDE = sensor((0.8, -3.2, 5), fov=26), sensor((0.5, -6, 3), fov=24)


def furrow() -> Any:
    """Two walls, 40 degrees apart and open towards +z, that meet in a line beside the y axis, off borders of pixels."""
    x, z = 2 * np.sin(np.radians(20)), 2 * np.cos(np.radians(20))
    points = [[0, -2, 0], [0, 2, 0], [x, -2, z], [x, 2, z], [-x, -2, z], [-x, 2, z]]
    faces = np.array([[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 5, 4]], np.uint32)
    return djpt.Mesh("moving", np.float32(points) + SHIFT, faces, props={"bsdf": WHITE, "face_normals": True})


def cup(height: float, bsdf: dict[str, Any]) -> Any:
    """A square cup, upside down a pyramid without its tip, whose bottom is at a height."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    levels = [np.c_[size * corners, np.full(4, z)] for size, z in ((0.4, height), (1.0, height + 0.8))]
    quads = [(3, 2, 1, 0), (4, 5, 6, 7), *((k, (k + 1) % 4, (k + 1) % 4 + 4, k + 4) for k in range(4))]
    faces = np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))], np.uint32)
    return djpt.Mesh("moving", np.float32(np.concatenate(levels)), faces, props={"bsdf": bsdf, "face_normals": True})


def sun(*direction: float) -> dict[str, Any]:
    return {"type": "directional", "direction": list(direction), "irradiance": 3.0}


def a_ball_in_a_floor() -> dict[str, Any]:
    return {"moving": ball(WHITE, center=[0, 0, 0.4], radius=0.8), "floor": FLOOR, "sky": SKY, "sensor": ASIDE}


def a_furrow() -> dict[str, Any]:
    return {"moving": furrow(), "sun": sun(-0.2, 0, -1), "sensor": FROM_ABOVE}


def a_cup(height: float, light: dict[str, Any], bsdf: dict[str, Any] = WHITE) -> dict[str, Any]:
    return {"moving": cup(height, bsdf), "floor": FLOOR, "light": light, "sensor": ASIDE}


def a_tube(light: dict[str, Any], table: bool = False) -> dict[str, Any]:
    """A tube that stands on a floor, or on a table above it."""
    tube = {"type": "cylinder", "p0": [0, 0, 0], "p1": [0, 0, 0.9], "radius": 0.7, "bsdf": WHITE}
    under = {"floor": FLOOR}
    if table:
        under = {
            "table": {**FLOOR, "to_world": T().scale(1.5)},
            "floor": {**FLOOR, "to_world": T().translate([0, 0, -1]).scale(6)},
        }
    return {"moving": tube, **under, "light": light, "sensor": ASIDE}


def a_furrow_in_a_mirror() -> dict[str, Any]:
    mirror = {"type": "rectangle", "to_world": T().translate([0, 0, 6]).rotate([1, 0, 0], 180).scale(4)}
    seen = sensor((0.8, -3.2, 1), fov=26)
    seen["to_world"] = T().look_at([1.6, -6, 1], [0.8, -3, 6], [0, 1, 0])
    lamp = ball(center=[1.2, 0, 5], radius=0.4, emitter={"type": "area", "radiance": 30.0})
    return {"moving": furrow(), "mirror": {**mirror, "bsdf": {"type": "conductor"}}, "lamp": lamp, "sensor": seen}


LOW = sun(0.5, 0.9, -0.35)
MOVE = shift("moving.to_world")
CASES: dict[str, Case] = {
    "a ball that a floor cuts": Case(a_ball_in_a_floor, MOVE, step=0.02),
    "a furrow": Case(a_furrow, slide, step=0.02),
    "a furrow, indirect light": Case(a_furrow, slide, PRB, depth=4, step=0.02),
    "a furrow in a mirror": Case(a_furrow_in_a_mirror, slide, PRB, depth=3, step=0.02),
    "a ball that a floor cuts, indirect light": Case(a_ball_in_a_floor, MOVE, PRB, depth=4, step=0.02),
    "a tube on a floor": Case(lambda: a_tube(SKY), MOVE, step=0.02),
    "a tube on a floor, indirect light": Case(lambda: a_tube(SKY), MOVE, PRB, depth=4, step=0.02),
    "a tube on a table": Case(lambda: a_tube(LOW, table=True), MOVE, step=0.02),
    "a cup on a floor": Case(lambda: a_cup(0.0, LOW), slide, step=0.02),
    "a cup that a floor cuts, indirect light": Case(lambda: a_cup(-0.2, SKY), slide, PRB, depth=4, step=0.02),
    "a cup that a floor cuts": Case(lambda: a_cup(-0.2, SKY), slide, step=0.02),
    "a mirror that a floor cuts": Case(lambda: a_cup(-0.2, SKY, {"type": "conductor"}), slide, step=0.02),
}
for motion in ("step aside", "turn"):
    CASES |= {
        f"a camera, {motion}: a ball that a floor cuts": Case(a_ball_in_a_floor, MOTIONS[motion], step=0.02),
        f"a camera, {motion}: a furrow": Case(a_furrow, MOTIONS[motion], step=0.02),
        f"a camera, {motion}: a tube on a floor": Case(lambda: a_tube(SKY), MOTIONS[motion], step=0.02),
        f"a camera, {motion}: a cup on a floor": Case(lambda: a_cup(0.0, SKY), MOTIONS[motion], step=0.02),
    }

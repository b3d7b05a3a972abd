"""What mirrors, glass and masks show of shapes and cameras that move: cases that central differences check."""

from __future__ import annotations

from typing import Any

import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from tests.silhouettes.camera_cases import orbit
from tests.silhouettes.cases import FLOOR, SIZE, Case, ball, edit, plate, sensor, shift, sky, slide, turn, turn_head

MIRROR = {"type": "conductor"}
GLASS = {"type": "dielectric"}
PAPER = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.3]}}
SKY = {"type": "constant", "radiance": 0.8}
LAMP = {"type": "sphere", "center": [2, 2, 5], "radius": 1.0, "emitter": {"type": "area", "radiance": 10.0}}
PRB = ("prb_projective",)


def ring() -> Any:
    """A smooth mesh of a torus, which hides itself in part."""
    u, v = np.meshgrid(np.arange(24) / 24, np.arange(12) / 12, indexing="ij")
    x, y = np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)
    c, s = np.cos(2 * np.pi * v), np.sin(2 * np.pi * v)
    normals = np.stack([x * c, y * c, s], -1).reshape(-1, 3)
    points = np.stack([x * (0.6 + 0.25 * c), y * (0.6 + 0.25 * c), 0.25 * s], -1).reshape(-1, 3)
    points = points @ np.array([[1, 0, 0], [0, 0.5, 0.866], [0, -0.866, 0.5]]) + [0, 0, 1.5]
    normals = normals @ np.array([[1, 0, 0], [0, 0.5, 0.866], [0, -0.866, 0.5]])
    i, j = np.meshgrid(np.arange(24), np.arange(12), indexing="ij")
    a, b = i * 12 + j, (i + 1) % 24 * 12 + j
    c, d = i * 12 + (j + 1) % 12, (i + 1) % 24 * 12 + (j + 1) % 12
    faces = np.stack([a, b, d, a, d, c], -1).reshape(-1, 3)
    return djpt.Mesh("moving", points.astype(np.float32), faces, normals, props={"bsdf": PAPER})


CASES: dict[str, Case] = {
    "a lamp in a mirror": Case(
        lambda: {
            "moving": {
                "type": "disk",
                "to_world": T().translate([0.3, 0.2, 3]).rotate([1, 0, 0], 180),
                "emitter": {"type": "area", "radiance": 2.0},
            },
            "mirror": plate(MIRROR),
            "sensor": sensor((-3, -1, 5)),
        },
        shift("moving.to_world"),
        step=0.02,
    ),
    "a ball in a round mirror": Case(
        lambda: {
            "moving": ball(PAPER, center=[0.9, 0, 0], radius=0.7),
            "mirror": ball(MIRROR, center=[-0.8, 0, 0], radius=0.9),
            "sky": sky(),
        },
        shift("moving.to_world"),
        PRB,
        depth=3,
    ),
    "a mirror that turns before a box": Case(
        lambda: {
            "moving": {**plate(MIRROR), "to_world": T().rotate([0, 1, 0], 10).scale(4)},
            "box": {
                "type": "cube",
                "bsdf": PAPER,
                "to_world": T().translate([0, 0, 1.5]).rotate([0.6, 0.8, 0], 40).scale(0.6),
            },
            "sky": sky(),
            "sensor": sensor((-3, -1, 5)),
        },
        turn("moving.to_world", 10),
        PRB,
        depth=3,
        step=0.02,
        spp=512,
    ),
    "a ring in a mirror": Case(
        lambda: {"moving": ring(), "mirror": plate(MIRROR), "sky": sky(), "sensor": sensor((-3, -1, 5))},
        slide,
        PRB,
        depth=3,
    ),
    "a shadow in a mirror": Case(
        lambda: {
            "moving": ball(PAPER, center=[0.5, 0.3, 1], radius=0.7),
            "floor": {**FLOOR, "to_world": T().translate([0, 0, -1]).scale(4)},
            "mirror": {
                "type": "rectangle",
                "bsdf": MIRROR,
                "to_world": T().translate([0, 0, 6.5]).rotate([1, 0, 0], 180).scale(9),
            },
            "lamp": LAMP,
            "sensor": {**sensor(), "to_world": T().look_at([-3, 0, 2.5], [-1, 0, 6.5], [0, 1, 0])},
        },
        shift("moving.to_world"),
        PRB,
        depth=3,
    ),
    "a ball behind a ball of glass": Case(
        lambda: {
            "moving": ball(PAPER, center=[0.4, 0, -1.5], radius=0.6),
            "glass": ball(GLASS, center=[0, 0, 1]),
            "sky": sky(),
        },
        shift("moving.to_world"),
        PRB,
        depth=4,
    ),
    "a ball of glass over a panel": Case(
        lambda: {
            "moving": ball(GLASS),
            "panel": {
                "type": "rectangle",
                "to_world": T().translate([0, 0, -2]).scale(1.5),
                "emitter": {"type": "area", "radiance": 1.0},
            },
        },
        shift("moving.to_world"),
        PRB,
        depth=3,
        spp=2048,
    ),
    "a table of plastic": Case(
        lambda: {
            "moving": ball(PAPER, center=[0.3, 0.1, 1.2], radius=0.8),
            "table": plate({"type": "plastic", "diffuse_reflectance": 0.3}),
            "sky": sky(),
            "sensor": sensor((-3, -1, 4)),
        },
        shift("moving.to_world"),
        PRB,
        depth=3,
    ),
    "a camera, aside: a mirror": Case(
        lambda: {
            "ball": ball(PAPER, center=[0.9, 0, 0], radius=0.7),
            "mirror": ball(MIRROR, center=[-0.8, 0, 0], radius=0.9),
            "sky": sky(),
        },
        shift("sensor.to_world"),
        PRB,
        depth=3,
    ),
}
FIELDS = {"type": "checkerboard", "to_uv": T().scale([6, 6, 1])}
RIM = sensor()
RIM["film"] = {**RIM["film"], "width": 128, "height": 128, "crop_width": SIZE, "crop_height": SIZE}
RIM["film"] |= {"crop_offset_x": 95, "crop_offset_y": 50}
CASES["a camera, step aside: the rim of a round mirror before fields"] = Case(
    lambda: {
        "mirror": ball(MIRROR, radius=1.3),
        "wall": {
            "type": "rectangle",
            "to_world": T().translate([0.1, 0.2, -2]).scale(5),
            "bsdf": {"type": "diffuse", "reflectance": FIELDS},
        },
        "sky": {"type": "constant", "radiance": 1.0},
        "sensor": RIM,
    },
    shift("sensor.to_world"),
    PRB,
    depth=3,
    spp=2048,
    step=0.004,
)


def between_walls() -> dict[str, Any]:
    """A mirror between two walls that touch."""
    upright = T().translate([0, 1.5, 0.5]).rotate([1, 0, 0], 90)
    return {
        "mirror": ball(MIRROR, center=[-0.5, 0.3, -0.3], radius=0.6),
        "floor": {"type": "rectangle", "to_world": T().translate([0, 0, -1]).scale(1.5), "bsdf": PAPER},
        "wall": {"type": "rectangle", "to_world": upright.scale(1.5), "bsdf": PAPER},
        "sky": sky(),
    }


WAYS = {
    **{"turn": turn_head, "field of view": edit("sensor.x_fov", 20)},
    **{"orbit": orbit, "step aside": shift("sensor.to_world")},
}
for motion, move in WAYS.items():
    CASES[f"a camera, {motion}: a mirror between walls that touch"] = Case(
        between_walls, move, PRB, depth=4, step=0.005, spp=1024, spp_difference=65536
    )


def before_fields(bsdf: Any) -> dict[str, Any]:
    """That scene with a ball of another material."""
    nodes = CASES["a camera, step aside: the rim of a round mirror before fields"].nodes()
    return {**nodes, "mirror": ball(bsdf, radius=1.3)}


# The wall in the mirror sees the outline of the ball, beyond which the sky is as bright as what the ball shows of it.
for name, bsdf in (("round mirror", MIRROR), ("ball of glass", GLASS)):
    CASES[f"a camera, step aside: the rim of a {name} before fields, that see it"] = Case(
        lambda bsdf=bsdf: before_fields(bsdf), shift("sensor.to_world"), PRB, depth=4, spp=2048, step=0.004
    )

"""Shapes that see themselves: open meshes with dents, which shine on themselves, rooms, and tubes."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float, Point3f
from tests.silhouettes.cases import PRB, Case, ball, corners, sensor, slide, turn

RINGS, AROUND = 5, 9
GREY = {"type": "diffuse", "reflectance": 0.8}
SKY = {"sky": {"type": "constant", "radiance": 0.5}, "sensor": sensor((1.6, -3.2, 4.6), fov=30)}
LAMP = {"lamp": ball(center=[0.5, 1.2, 3], radius=0.5, emitter={"type": "area", "radiance": 6.0})}


def bowl(bsdf: Any, smooth: bool = False, **props: Any) -> Any:
    """Half of a ball, open towards +z, whose vertices are up to 8 per cent too near or too far; the outside is +."""
    ring, turn = np.meshgrid(np.arange(1, RINGS + 1), np.arange(AROUND), indexing="ij")
    polar, azimuth = ring * (0.5 * np.pi / RINGS), turn * (2 * np.pi / AROUND)
    radius = 1 + 0.08 * np.sin(3 * ring + 2.3 * turn)
    sides = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)], -1)
    points = np.concatenate([[[0, 0, -1]], (radius[..., None] * sides).reshape(-1, 3)]).astype(np.float32)
    a, b = 1 + np.arange(AROUND), 1 + np.roll(np.arange(AROUND), -1)
    faces = [np.stack([0 * a, b, a], -1)]
    for k in range(0, (RINGS - 1) * AROUND, AROUND):
        faces += [np.stack([a, b, b + AROUND], -1) + k, np.stack([a, b + AROUND, a + AROUND], -1) + k]
    mesh = djpt.Mesh("moving", points, np.concatenate(faces), props={"bsdf": bsdf, **props})
    if smooth:
        mesh.recompute_vertex_normals()
    return mesh


def bend(params: Any, theta: Float) -> None:
    """Bend a mesh."""
    p = dr.unravel(Point3f, Float(params["moving.vertex_positions"]))
    moved = Point3f(p.x + theta * dr.sin(3 * p.y), p.y, p.z + theta * dr.cos(2 * p.x))
    params["moving.vertex_positions"] = Float(dr.ravel(moved))


swell = corners(lambda theta: djpt.Transform4f().scale([1 + theta, 1 + theta, 1 + theta]))
spin = corners(
    lambda theta: djpt.Transform4f().translate([theta, 0.3 * theta, 0.2 * theta]).rotate([0, 1, 0], 15 * theta)
)
TWO_SIDED = {"type": "twosided", "nested": GREY}
SHINES = {"emitter": {"type": "area", "radiance": 1.0}, "flip_normals": True}
TUBE = {"type": "cylinder", "p0": [0, 0, -1], "p1": [0, 0, 1], "radius": 0.8, "bsdf": TWO_SIDED}
NEAR = {"lamp": ball(center=[1.5, 0.8, 2.6], radius=0.4, emitter={"type": "area", "radiance": 20.0})}
ASIDE = sensor((-1.0, -1.2, 3.8), fov=34)
CASES: dict[str, Case] = {
    "a bowl with dents": Case(lambda: {"moving": bowl(TWO_SIDED), **SKY}, swell, step=0.02),
    "a bowl with dents, black inside": Case(lambda: {"moving": bowl(GREY), **SKY}, swell, step=0.02),
    "a smooth bowl with dents": Case(lambda: {"moving": bowl(TWO_SIDED, smooth=True), **SKY}, swell, step=0.02),
    "dents light each other": Case(
        lambda: {"moving": bowl(TWO_SIDED), **SKY, **LAMP}, bend, PRB, depth=4, spp=512, step=0.02
    ),
    "dents light each other, and slide": Case(
        lambda: {"moving": bowl(TWO_SIDED), **SKY, **LAMP}, slide, PRB, depth=7, spp=512, step=0.02
    ),
    "a ball in a bowl": Case(
        lambda: {"moving": bowl(TWO_SIDED), "ball": ball(GREY, center=[0.2, 0.1, -0.6], radius=0.4), **SKY, **LAMP},
        slide,
        PRB,
        depth=4,
        spp=512,
        step=0.02,
    ),
    "dents that shine": Case(lambda: {"moving": bowl(GREY, **SHINES), "sensor": SKY["sensor"]}, bend, step=0.02),
    "dents that shine, and light each other": Case(
        lambda: {"moving": bowl(GREY, **SHINES), "sensor": SKY["sensor"]}, bend, PRB, depth=4, spp=512, step=0.02
    ),
    "a room that is a cube": Case(
        lambda: {
            "moving": {"type": "cube", "to_world": T().scale(2), "bsdf": TWO_SIDED},
            "lamp": ball(center=[0.5, 0.8, 0.6], radius=0.3, emitter={"type": "area", "radiance": 10.0}),
            "sensor": sensor((-1.4, -1.2, 1.5), fov=70),
        },
        spin,
        PRB,
        depth=4,
        step=0.02,
    ),
    "a tube before a lamp": Case(lambda: {"moving": TUBE, **NEAR, "sensor": ASIDE}, turn("moving.to_world", 20)),
    "a tube that lights itself": Case(
        lambda: {"moving": TUBE, **NEAR, "sensor": ASIDE}, turn("moving.to_world", 20), PRB, depth=3
    ),
}

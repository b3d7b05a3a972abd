"""Cases of lights that move, and of what moves in their beams, whose derivatives central differences check."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float
from tests.silhouettes.cases import ASIDE, FLOOR, POINT, PRB, SPOTS, WALL, Case, Move, ball, shift
from tests.silhouettes.test_projective import octahedron


def shine(x: float, y: float, z: float) -> Move:
    """Move a point of light."""

    def move(params: Any, theta: Float) -> None:
        params["light.position"] = djpt.Point3f(params["light.position"]) + djpt.Vector3f(x, y, z) * theta

    return move


def swing(params: Any, theta: Float) -> None:
    """Turn a light about its own place, and move it."""
    own = djpt.Transform4f().rotate([0.8, -0.6, 0], 10 * theta)
    there = djpt.Transform4f().translate([0.5 * theta, 0, 0.3 * theta])
    params["light.to_world"] = there @ djpt.Transform4f(params["light.to_world"]) @ own


SPOT = {
    "type": "spot",
    "to_world": T().look_at([2, 2, 6], [0, 0, 0], [0, 1, 0]),
    "intensity": 60.0,
    "cutoff_angle": 30.0,
}
CASES: dict[str, Case] = {
    f"a light that moves: {name}": Case(
        lambda light=light: {
            "ball": ball({"type": "roughplastic", "alpha": 0.3}, center=[1, 1, 3], radius=0.4),
            "board": {"type": "rectangle", "to_world": T().translate([-0.5, 0, 1]).rotate([1, 1, 0], 30).scale(0.7)},
            "light": light,
            "floor": {**FLOOR, "bsdf": {"type": "diffuse", "reflectance": SPOTS}},
            "sensor": ASIDE,
        },
        move,
        ("prb_projective",) if depth > 2 else Case.kinds,
        depth=depth,
        spp=512,
    )
    for name, light, move, depth in (
        ("a point", POINT, shine(1, 0.3, 0.5), 2),
        ("a point, seen indirectly", POINT, shine(1, 0.3, 0.5), 4),
        ("a spot", SPOT, swing, 2),
        ("the sun", {"type": "directional", "to_world": T().look_at([3, 3, 10], [0, 0, 0], [0, 1, 0])}, swing, 2),
    )
}
BEAM = {
    "type": "projector",
    "to_world": T().look_at([2, 2, 6], [0.2, 0, 0], [0, 1, 0]),
    "irradiance": SPOTS,
    "scale": 20.0,
    "fov": 20.0,
}
CASES |= {
    f"the beam of a projector: {name}": Case(
        lambda nodes=nodes: {
            "board": {
                "type": "rectangle",
                "to_world": T().translate([-0.5, 0, 1]).rotate([0.6, 0.8, 0], 30).scale(0.7),
            },
            "light": BEAM,
            "floor": FLOOR,
            "sensor": ASIDE,
            **nodes,
        },
        move,
        PRB if depth > 2 else Case.kinds,
        depth=depth,
        step=0.01,
        spp=512,
        spp_difference=16384,
    )
    for name, move, depth, nodes in (
        ("it moves", swing, 2, {}),
        ("a floor rises", shift("floor.to_world", 0, 0, 1), 2, {}),
        ("a board moves", shift("board.to_world", 1, 0, 0.5), 2, {}),
        ("a camera moves", shift("sensor.to_world", 1, 0, 0), 2, {}),
        ("it moves, seen indirectly", swing, 4, {"wall": WALL}),
    )
}


def smooth_octahedron() -> Any:
    """An octahedron with interpolated normals, which stands askew."""
    flat = octahedron((0, 0, 0), 1.3)
    points = np.array(flat.positions).reshape(-1, 3) @ T().rotate([0.28, 0.96, 0], 25).matrix[:3, :3].T
    found = djpt.Mesh("moving", points.astype(np.float32), np.array(flat.indices))
    found.recompute_vertex_normals()
    return found


def spin(params: Any, theta: Float) -> None:
    """Turn the vertices of a mesh about the y axis."""
    points = dr.unravel(djpt.Point3f, Float(params["moving.vertex_positions"]))
    params["moving.vertex_positions"] = dr.ravel(djpt.Transform4f().rotate([0, 1, 0], 30 * theta) @ points)


LOW = {"type": "sphere", "center": [-5, -0.35, -0.6], "emitter": {"type": "area", "radiance": 60.0}}
"""A lamp near the horizon of a face that the camera sees."""
CASES["a smooth octahedron turns before a low lamp"] = Case(
    lambda: {"moving": smooth_octahedron(), "light": LOW}, spin, step=0.01, spp=1024, spp_difference=65536
)

"""The shape of the bench of inverse problems: a bumpy body, found by large steps."""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import math
import tempfile
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from inverse_scenes import Problem, camera

__all__ = ["shape"]


def icosphere(times: int) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (V, 3) and faces (F, 3) of an icosahedron whose faces were divided into four, on the unit sphere."""
    g = (1 + 5**0.5) / 2
    corners = [[-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0], [0, -1, g], [0, 1, g]]
    points = [np.array(p) / np.hypot(1, g) for p in [*corners, [0, -1, -g], [0, 1, -g], [g, 0, -1], [g, 0, 1]]]
    points += [np.array(p) / np.hypot(1, g) for p in ([-g, 0, -1], [-g, 0, 1])]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2)]
    faces += [(10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5)]
    faces += [(2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    for _ in range(times):
        middles = dict[tuple[int, int], int]()

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            if (edge := (min(a, b), max(a, b))) not in middles:
                middles[edge] = len(points)
                points.append((points[a] + points[b]) / np.linalg.norm(points[a] + points[b]))
            return middles[edge]

        divided = [(a, b, c, middle(a, b), middle(b, c), middle(c, a)) for a, b, c in faces]
        faces = [f for a, b, c, d, e, g in divided for f in ((a, d, g), (b, e, d), (c, g, e), (d, e, g))]
    return np.array(points, np.float32), np.array(faces)


BALL, FACES = icosphere(2)
SMOOTH = djpt.ad.LargeSteps(BALL, FACES, 5.0)
"""Large steps: the vertices by their differential coordinates."""
BUMPS = [([0.3, 0.5, 0.8], 0.5), ([-0.8, -0.3, 0.4], 0.35), ([0.6, -0.7, -0.2], 0.4), ([-0.2, 0.7, -0.6], 0.3)]


def radius(directions: np.ndarray) -> np.ndarray:
    """How far the true shape's surface is from its centre, in unit directions (N, 3)."""
    near = [(height, directions @ (np.array(way) / np.linalg.norm(way))) for way, height in BUMPS]
    return 0.8 + sum(height * np.exp(-3 * (1 - cosine)) for height, cosine in near)


def differential(vertices: np.ndarray) -> np.ndarray:
    """The differential coordinates of vertices (V, 3)."""
    return np.array(SMOOTH.to_differential(djpt.Float(np.ascontiguousarray(vertices, np.float32).ravel())))


def radii(x: np.ndarray) -> np.ndarray:
    """How far the vertices are from the centre, relative to the true surface there."""
    vertices = np.array(SMOOTH.from_differential(djpt.TensorXf(np.asarray(x, np.float32).reshape(BALL.shape))))
    lengths = np.linalg.norm(vertices, axis=1)
    return lengths / radius(vertices / lengths[:, None])


def bumpy_body(size: int) -> dict[str, Any]:
    """A body of triangles in a lamp's light, before a dark sky, seen from four sides."""
    # Not OBJ: it is read in the order in which faces name vertices.
    file = Path(tempfile.mkdtemp()) / "ball.ply"
    djpt.Mesh("ball", BALL, FACES, props={"face_normals": True}).write_ply(file)
    views = {
        f"sensor{k}": camera(size, [5 * math.cos(a), 5 * math.sin(a), 3 * (-1) ** k], [0, 0, 0], 32)
        for k, a in enumerate(np.linspace(0.3, 0.3 + 1.5 * math.pi, 4).tolist())
    }
    return {
        "type": "scene",
        "integrator": {"type": "direct_projective", "sppi": 0},
        **views,
        "body": {
            "type": "ply",
            "filename": str(file),
            "face_normals": True,
            "bsdf": {"type": "diffuse", "reflectance": 0.6},
        },
        "sky": {"type": "constant", "radiance": 0.1},
        "light": {"type": "point", "position": [3, -3, 5], "intensity": 40.0},
        "other": {"type": "point", "position": [-4, 3, -4], "intensity": 40.0},
    }


def apply_shape(module: Any, params: Any, x: Any) -> None:
    """The vertices of the body, from their differential coordinates."""
    params["body.vertex_positions"] = dr.ravel(SMOOTH.from_differential(x))


def shape() -> Problem:
    """A shape, by large steps."""
    return Problem(
        "shape by large steps",
        "The 162 vertices of a body that begins as a ball, from four sides. Both renderers move the differential "
        "coordinates of all vertices (Nicolet et al. 2021). The error is that of the vertices' distances from the "
        "centre.",
        bumpy_body,
        differential(BALL * radius(BALL)[:, None]),
        differential(BALL),
        apply_shape,
        "TensorXf",
        (0.03, 0.06, 0.1),
        (-50.0, 50.0),
        "least_squares",
        spp=16,
        seen=radii,
        uniform=True,
        views=4,
        coarse=1,
        size=48,
        iterations=12,
    )

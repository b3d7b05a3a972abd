"""The caustic of the bench of inverse problems: the heights of a pane of glass, from the light behind it."""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import tempfile
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from inverse_scenes import Problem

__all__ = ["caustic"]

T = djpt.ScalarTransform4f
HEIGHTS, POINTS = 9, 33
"""The unknown heights along an axis, and the vertices of the mesh that runs smoothly through them."""
X, Y = np.meshgrid(np.linspace(-1, 1, POINTS, dtype=np.float32), np.linspace(-1, 1, POINTS, dtype=np.float32))


def pane(size: int) -> dict[str, Any]:
    """Parallel light behind a pane of glass, as in Mitsuba's tutorial, seen on a wall."""
    k = np.arange(POINTS * POINTS).reshape(POINTS, POINTS)
    a, b, c, d = k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]
    faces = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))])
    file = Path(tempfile.mkdtemp()) / "pane.ply"
    flat = np.stack([X, Y, 0 * X], axis=-1).reshape(-1, 3)
    djpt.Mesh("pane", flat, faces, props={"face_normals": False}).write_ply(file)
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0, "specular_reflectance": 0.0}
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "gaussian"}}
    return {
        "type": "scene",
        "integrator": {"type": "ptracer", "max_depth": 4, "unproven_gradients": True},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "film": film,
            "to_world": T().look_at([0, 0, -0.5], [0, 0, -1], [0, 1, 0]),
        },
        "wall": {"type": "rectangle", "to_world": T().translate([0, 0, -3]).scale(3)},
        "lens": {"type": "ply", "filename": str(file), "bsdf": glass},
        "top": {"type": "rectangle", "to_world": T().translate([0, 0, 0.2]), "bsdf": glass},
        "lamp": {
            "type": "rectangle",
            "to_world": T().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(0.85),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": {"type": "directionalarea", "radiance": 1.0},
        },
    }


def apply_heights(module: Any, params: Any, x: Any) -> None:
    """The vertices of the pane, from the heights, in hundredths."""
    z = dr.resample(x, (POINTS, POINTS), filter="cubic")
    flat = [module.Float(np.ascontiguousarray(along.ravel())) for along in (X, Y)]
    params["lens.vertex_positions"] = dr.ravel(module.Point3f(*flat, 0.01 * z.array))


def relief(x: np.ndarray) -> np.ndarray:
    """The heights that light passes by, but for their mean, by which little changes."""
    inner = np.asarray(x).reshape(HEIGHTS, HEIGHTS)[1:-1, 1:-1]
    return inner - inner.mean()


def caustic() -> Problem:
    """A pane of glass, by its caustic."""
    at = np.linspace(-1, 1, HEIGHTS)
    u, v = np.meshgrid(at, at)
    truth = 4 * np.sin(2.2 * u + 0.5) * np.cos(1.8 * v) + 2 * np.cos(3.5 * v + 1) + 1.5 * np.sin(4 * u * v)
    return Problem(
        "caustic",
        "9 x 9 heights, in hundredths, of a pane of glass with 33 x 33 vertices, from the light that it throws onto a "
        "wall; light paths are differentiated. The error is that of the heights which light passes by.",
        pane,
        truth.astype(np.float32),
        np.zeros((HEIGHTS, HEIGHTS), np.float32),
        apply_heights,
        "TensorXf",
        (0.05, 0.1, 0.2),
        (-20.0, 20.0),
        "least_squares",
        spp=16,
        spp_divisor=2,
        spp_derivatives=4,
        seen=relief,
        size=48,
        iterations=30,
        steps=600,
    )

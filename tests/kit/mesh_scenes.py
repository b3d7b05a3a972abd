"""Scenes that mix meshes of all kinds with analytic shapes, materials and lights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Color3f
from djpt.textures import Texture
from tests.kit.axes import unit
from tests.kit.meshes import bumpy_sheet, write_binary_ply

__all__ = ["PATH", "ball", "ball_file", "diffuse", "gallery", "sheet_file", "uv_texture"]

PATH = {"type": "path", "max_depth": 6, "rr_depth": 3}


def ball(rows: int = 12, bumps: float = 0.1) -> dict[str, Any]:
    """A closed bumpy ball of unit size that shares vertices, with smooth normals and texture coordinates."""
    u, v = np.meshgrid(np.arange(2 * rows) / (2 * rows), np.linspace(0, 1, rows + 1)[1:-1])
    u, v = (x.ravel() for x in (u, v))
    phi, theta = 2 * np.pi * u, np.pi * v
    p = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    p *= 1 + bumps * np.sin(5 * p[:, :1]) * np.cos(4 * p[:, 1:2])
    p = np.concatenate([p, [[0, 0, 1], [0, 0, -1]]])
    ring, wide = np.arange(2 * rows), 2 * rows
    faces = [np.stack([np.full(wide, len(p) - 2), ring, (ring + 1) % wide], 1)]
    for row in range(rows - 2):
        a, b = row * wide + ring, row * wide + (ring + 1) % wide
        faces += [np.stack([a, a + wide, b], 1), np.stack([b, a + wide, b + wide], 1)]
    last = (rows - 2) * wide
    faces.append(np.stack([last + ring, np.full(wide, len(p) - 1), last + (ring + 1) % wide], 1))
    uv = np.concatenate([np.stack([u, v], 1), [[0.5, 0], [0.5, 1]]])
    return {
        "positions": p.astype(np.float32),
        "faces": np.concatenate(faces).astype(np.int32),
        "normals": (p / np.linalg.norm(p, axis=1, keepdims=True)).astype(np.float32),
        "texcoords": uv.astype(np.float32),
    }


def ball_file(folder: Path, rows: int = 12, **keys: Any) -> str:
    """The ball as a PLY file."""
    return str(write_binary_ply(folder / f"ball{rows}{''.join(map(str, keys.values()))}.ply", ball(rows), **keys))


def sheet_file(folder: Path, n: int = 6, seed: int = 0, **keys: Any) -> str:
    """The crumpled sheet as a PLY file."""
    name = f"sheet{n}_{seed}{''.join(map(str, keys.values()))}.ply"
    return str(write_binary_ply(folder / name, bumpy_sheet(n, seed), **keys))


def diffuse(*color: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(color)}}


def two_sided(*color: float) -> dict[str, Any]:
    return {"type": "twosided", "inner": diffuse(*color)}


def gallery(
    folder: Path,
    size: tuple[int, int] = (32, 32),
    rfilter: str | dict[str, Any] = "box",
    integrator: dict[str, Any] | None = None,
    lights: tuple[str, ...] = ("lamp", "point", "sky", "panel"),
    **film: Any,
) -> dict[str, Any]:
    """Meshes (smooth, flat, flipped, mirrored), a sphere, a cube and a floor under several lights."""
    rfilter = {"type": rfilter} if isinstance(rfilter, str) else rfilter
    smooth, flat = ball_file(folder), ball_file(folder, 8, normals=False, uv=False)
    sheet = sheet_file(folder)
    available: dict[str, Any] = {
        "lamp": {
            "type": "ply",
            "filename": flat,
            "to_world": T().translate([-1.2, 1.6, 0.6]).scale(0.25),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [9, 8, 6]}},
        },
        "point": {"type": "point", "position": [1.5, 2, 2], "intensity": {"type": "rgb", "value": [2, 3, 4]}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.15, 0.3]}},
        "panel": {
            "type": "rectangle",
            "to_world": T().translate([0.5, 2.5, 0]).rotate([1, 0, 0], 90).scale(0.5),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [5, 5, 4]}},
        },
    }
    return {
        "type": "scene",
        "integrator": integrator or PATH,
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": T().look_at(origin=[0.3, 1.2, 4.5], target=[0, 0.1, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": rfilter, **film},
        },
        "floor": {
            "type": "rectangle",
            "to_world": T().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(3),
            "bsdf": diffuse(0.6, 0.5, 0.4),
        },
        "smooth": {"type": "ply", "filename": smooth, "to_world": T().translate([-0.9, -0.3, 0]).scale(0.7)},
        "flat": {
            "type": "ply",
            "filename": smooth,
            "face_normals": True,
            "to_world": T().translate([0.9, -0.4, 0.3]).rotate(unit(1, 1, 0), 50).scale([0.6, 0.4, 0.5]),
            "bsdf": diffuse(0.2, 0.6, 0.3),
        },
        "flipped": {
            "type": "ply",
            "filename": sheet,
            "flip_normals": True,
            "to_world": T().translate([0.1, 0.6, -1.2]).scale([1.6, 1.2, 1]),
            "bsdf": two_sided(0.7, 0.2, 0.2),
        },
        "mirrored": {
            "type": "ply",
            "filename": flat,
            "to_world": T().translate([0, -0.7, 1]).scale([-0.3, 0.3, 0.3]),
            "bsdf": {"type": "twosided", "front": diffuse(0.9, 0.8, 0.1), "back": diffuse(0.1, 0.1, 0.9)},
        },
        "ball": {"type": "sphere", "center": [0.3, 0.5, 0.2], "radius": 0.25, "bsdf": diffuse(0.3, 0.3, 0.8)},
        "block": {"type": "cube", "to_world": T().translate([1.6, -0.6, -0.8]).rotate([0, 1, 0], 30).scale(0.4)},
        **{name: available[name] for name in lights},
    }


class Stripes(Texture):
    """Colours that follow uv: red by u, green by v, blue in stripes."""

    def restrict(self, allowed: Any, where: str) -> None:
        pass

    def eval(self, si: Any, active: Any = True) -> Color3f:
        u, v = si.uv.x - dr.floor(si.uv.x), si.uv.y - dr.floor(si.uv.y)
        return Color3f(0.1 + 0.8 * u, 0.1 + 0.8 * v, 0.5 + 0.4 * dr.sin(20 * u))


djpt.register_texture("stripes", Stripes)


def uv_texture(scene: dict[str, Any], *names: str) -> dict[str, Any]:
    """The scene with stripes on some shapes."""
    for name in names:
        scene[name]["bsdf"] = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": {"type": "stripes"}}}
    return scene

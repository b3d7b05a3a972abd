"""The scenes of `meshes.py`: bumpy spheres over a floor, twenty meshes, 64 analytic shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import djpt

__all__ = [
    "bumpy_sphere",
    "instances",
    "many_shapes",
    "over_floor",
    "textured_sphere",
    "twenty_meshes",
    "write_bumpy_sphere",
]


def write_bumpy_sphere(folder: Path, triangles: int, seed: int = 0) -> Path:
    """Write a PLY file of about `triangles` triangles: a unit sphere with bumps of all sizes."""
    path = folder / f"bumpy_{triangles}_{seed}.ply"
    if not path.exists():
        positions, faces = bumps(triangles, seed)
        x, y, z = positions.T / np.linalg.norm(positions, axis=1)
        uv = np.stack([np.arctan2(z, x) / (2 * np.pi) % 1, np.arccos(y) / np.pi], axis=1)
        mesh = djpt.Mesh("bumpy", positions, faces, vertex_texcoords=uv, props={"face_normals": True})
        mesh.write_ply(path)
    return path


def bumps(triangles: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The vertices and faces by longitude and latitude; the radius is a sum of sines of rising frequency."""
    rows = int(np.sqrt(triangles / 4)) + 1
    columns = 2 * rows
    phi = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    theta = np.linspace(0.02, np.pi - 0.02, rows)
    p = np.stack(
        np.broadcast_arrays(
            np.sin(theta)[:, None] * np.cos(phi), np.cos(theta)[:, None], np.sin(theta)[:, None] * np.sin(phi)
        ),
        axis=-1,
    ).reshape(-1, 3)
    rng, radius = np.random.default_rng(seed), np.ones(len(p))
    for octave in range(7):
        waves, phases = 1.5 * 2.0**octave * rng.normal(size=(4, 3)), rng.uniform(0, 2 * np.pi, 4)
        radius += 0.06 / 1.7**octave * np.sin(p @ waves.T + phases).sum(axis=1)
    here = (np.arange(rows - 1)[:, None] * columns + np.arange(columns)).ravel()
    right = (np.arange(rows - 1)[:, None] * columns + (np.arange(columns) + 1) % columns).ravel()
    faces = np.concatenate(
        [np.stack([here, right, here + columns], 1), np.stack([right, right + columns, here + columns], 1)]
    )
    return p * radius[:, None], faces


def diffuse(color: Any) -> dict[str, Any]:
    """A diffuse BSDF."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [float(c) for c in color]}}


def bumpy_sphere(file: Path, face_normals: bool) -> dict[str, Any]:
    """A shape from `write_bumpy_sphere`."""
    return {"type": "ply", "filename": str(file), "face_normals": face_normals, "bsdf": diffuse((0.7, 0.5, 0.4))}


def textured_sphere(module: Any, file: Path) -> dict[str, Any]:
    """A shape from `write_bumpy_sphere` with vertex normals and a texture."""
    squares = {"type": "checkerboard", "to_uv": module.ScalarTransform4f().scale([20, 10, 1])}
    return {**bumpy_sphere(file, False), "bsdf": {"type": "diffuse", "reflectance": squares}}


def instances(module: Any, file: Path) -> dict[str, Any]:
    """A thousand instances of a bumpy sphere."""
    rng = np.random.default_rng(0)
    scene = stage(module, [0, 4, 12], -0.8, 9, 8)
    scene["group"] = {"type": "shapegroup", "ball": bumpy_sphere(file, True)}
    axis = [float(x) for x in np.array([0, 1, 0.3]) / np.linalg.norm([0, 1, 0.3])]
    for i in range(1000):
        place = [float(x) for x in rng.uniform(-1, 1, 3) * [6, 1, 6]]
        turned = module.ScalarTransform4f().translate(place).rotate(axis, float(rng.uniform(0, 360)))
        scene[f"copy_{i}"] = {
            "type": "instance",
            "group": {"type": "ref", "id": "group"},
            "to_world": turned.scale(0.15),
        }
    return scene


def stage(module: Any, origin: Any, floor: float, scale: float, lamp: float) -> dict[str, Any]:
    """A camera, a floor and a lamp."""
    transform = module.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": transform().look_at(origin=origin, target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 256, "height": 256, "rfilter": {"type": "box"}},
        },
        "floor": {
            "type": "rectangle",
            "to_world": transform().translate([0, floor, 0]).rotate([1, 0, 0], -90).scale([scale, scale, 1]),
            "bsdf": diffuse((0.7, 0.5, 0.4)),
        },
        "light": {
            "type": "rectangle",
            "to_world": transform().translate([0, lamp, 0]).rotate([1, 0, 0], 90).scale(scale / 3),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [8, 8, 8]}},
        },
    }


def over_floor(module: Any, ball: dict[str, Any]) -> dict[str, Any]:
    """A ball on a floor under a lamp."""
    return {**stage(module, [0, 0.6, 3.2], -1.2, 3, 3), "ball": ball}


def twenty_meshes(module: Any, files: list[Path]) -> dict[str, Any]:
    """Twenty bumpy spheres, eight materials."""
    rng = np.random.default_rng(1)
    materials = [diffuse(rng.uniform(0.2, 0.8, 3)) for _ in range(8)]
    scene = stage(module, [0, 2.5, 7], -0.8, 6, 6)
    for i, file in enumerate(files):
        place = [1.5 * (i % 5 - 2), 0.3 * (i % 3), 1.5 * (i // 5 - 1.5)]
        scene[f"ball_{i}"] = {
            **bumpy_sphere(file, True),
            "to_world": module.ScalarTransform4f().translate(place).scale(0.6),
            "bsdf": materials[i % 8],
        }
    return scene


def many_shapes(module: Any) -> dict[str, Any]:
    """64 spheres, boxes, disks and cylinders, turned at random, six materials."""
    rng = np.random.default_rng(5)
    materials = [diffuse(rng.uniform(0.2, 0.8, 3)) for _ in range(6)]
    scene = stage(module, [0, 3.5, 9], -0.6, 6, 6)
    for i in range(64):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        place = [1.1 * (i % 8 - 3.5), rng.uniform(0, 0.6), 1.1 * (i // 8 - 3.5)]
        turned = module.ScalarTransform4f().translate([float(x) for x in place])
        turned = turned.rotate([float(x) for x in axis], float(rng.uniform(0, 360)))
        scene[f"shape_{i}"] = {
            "type": ("sphere", "cube", "disk", "cylinder")[(i + i // 8) % 4],
            "to_world": turned.scale(float(rng.uniform(0.25, 0.45))),
            "bsdf": materials[i % 6],
        }
    return scene

"""Derivatives by motion against Mitsuba's, at equal error: ``python benchmarks/motion.py``.

In the manner of Mitsuba's tutorials on the pose of an object, on shadows and on shapes: `prb_projective` with each
renderer's own settings, an image and a reverse derivative of a weighted sum of its pixels, by the place of a mesh of
5,120 triangles. The error is the variance of this derivative between seeds. The ratio is that of variance times
seconds, which is the time for the same error.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from inverse_shape import icosphere
from pairs import Row, in_pairs, report

SEEDS, SPP, SIZE = 16, 16, 64
"""The numbers of derivatives that a variance is computed from, of samples per pixel, and of pixels along a side."""
REQUIRED, AIM = 3.0, 5.0

Scene = Callable[[Any, Path], dict[str, Any]]


def bumpy_body(file: Path) -> None:
    """Write a ball with bumps."""
    points, faces = icosphere(4)
    radius = 0.5 * (1 + 0.12 * np.sin(6 * points[:, :1]) * np.sin(5 * points[:, 1:2]) + 0.1 * np.cos(7 * points[:, 2:]))
    mesh = djpt.Mesh("body", (radius * points).astype(np.float32), faces)
    mesh.recompute_vertex_normals()
    mesh.write_ply(file)


def with_body(module: Any, file: Path, nodes: dict[str, Any], origin: list[float], depth: int) -> dict[str, Any]:
    """A scene with the body."""
    transform = module.ScalarTransform4f
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "gaussian"}, "pixel_format": "rgb"}
    return {
        "type": "scene",
        "integrator": {"type": "prb_projective", "max_depth": depth},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": transform().look_at(origin=origin, target=[0, 0, 0.5], up=[0, 0, 1]),
            "film": film,
        },
        "body": {
            "type": "ply",
            "filename": str(file),
            "to_world": transform().translate([0, 0, 0.8]),
            "bsdf": {"type": "diffuse"},
        },
        **nodes,
    }


def floor_and_lamp(module: Any) -> dict[str, Any]:
    """A floor, and a lamp above it."""
    transform = module.ScalarTransform4f
    return {
        "floor": {"type": "rectangle", "to_world": transform().scale(4)},
        "lamp": {
            "type": "rectangle",
            "to_world": transform().look_at(origin=[1.5, 1, 3], target=[0, 0, 0], up=[0, 1, 0]).scale(0.4),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 20.0}},
        },
    }


def shadow(module: Any, file: Path) -> dict[str, Any]:
    """A body above a floor, in the light of a lamp."""
    return with_body(module, file, floor_and_lamp(module), [2, -3, 2.5], 3)


def room(module: Any, file: Path) -> dict[str, Any]:
    """The same between two walls."""
    transform = module.ScalarTransform4f
    walls = {
        "wall": {"type": "rectangle", "to_world": transform().translate([0, 1.5, 1]).rotate([1, 0, 0], 90).scale(2)},
        "side": {"type": "rectangle", "to_world": transform().translate([-1.5, 0, 1]).rotate([0, 1, 0], 90).scale(2)},
    }
    return with_body(module, file, {**floor_and_lamp(module), **walls}, [2.5, -3.5, 2], 4)


def sky(module: Any, file: Path) -> dict[str, Any]:
    """A body under an uneven sky."""
    row, column = np.arange(16)[:, None, None], np.arange(32)[None, :, None]
    radiance = 0.3 + np.abs(np.sin(0.3 * row + column * (np.pi / 16))) * np.ones((1, 1, 3))
    light = {"type": "envmap", "bitmap": module.Bitmap(radiance.astype(np.float32))}
    return with_body(module, file, {"sky": light}, [2, -3, 1], 3)


SCENES: dict[str, Scene] = {"a shadow": shadow, "a room": room, "under a sky": sky}
COLUMN = np.linspace(-1, 1, SIZE, dtype=np.float32)
WEIGHTS = np.broadcast_to(COLUMN[None, :, None] - 0.6 * COLUMN[:, None, None], (SIZE, SIZE, 3))


class Renderer:
    """A scene in one of the renderers."""

    def __init__(self, module: Any, description: dict[str, Any]) -> None:
        self.module, self.scene = module, module.load_dict(description)
        self.start = module.Float(module.traverse(self.scene)["body.vertex_positions"])
        self.weights = module.TensorXf(np.ascontiguousarray(WEIGHTS))

    def gradient(self, seed: int) -> np.ndarray:
        """The derivative by the place of the body, (3,)."""
        module, params = self.module, self.module.traverse(self.scene)
        shift = module.Vector3f(0)
        dr.enable_grad(shift)
        params["body.vertex_positions"] = dr.ravel(dr.unravel(module.Point3f, self.start) + shift)
        params.update()
        image = module.render(self.scene, params, spp=SPP, seed=seed)
        dr.backward(dr.sum(image * self.weights, axis=None))
        return np.array(dr.grad(shift), np.float64).ravel()


def rows(pairs: int, quick: bool) -> Iterator[Row]:
    """The comparison of each scene."""
    for name, scene in SCENES.items():
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "body.ply"
            bumpy_body(file)
            ours, theirs = (Renderer(module, scene(module, file)) for module in (djpt, mi))
            times, told = in_pairs(ours.gradient, theirs.gradient, pairs)
            found = [
                np.array([r.gradient(seed) for seed in range(1, (6 if quick else SEEDS) + 1)]) for r in (ours, theirs)
            ]
            variances = [float(values.var(axis=0, ddof=1).sum()) for values in found]
            error = np.sqrt(sum(values.var(axis=0, ddof=1) / len(values) for values in found))
            z = float(np.abs((found[0].mean(axis=0) - found[1].mean(axis=0)) / error).max())
            ratio = variances[1] / variances[0]
            note = f"{told}, variance {variances[1]:.3g} / {variances[0]:.3g}, means differ by z {z:.1f}"
            yield Row(f"variance x time, {name}", REQUIRED, AIM, [ratio * t for t in times], note)


if __name__ == "__main__":
    sys.exit(report(__doc__, "Variance x time of derivatives by motion, Mitsuba / djpt", rows))

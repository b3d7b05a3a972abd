"""Recover smoke from pictures of it: 32^3 densities from six views.

A ring of smoke floats in front of a sky, with a lamp on one side. Six cameras around it have taken pictures; the
density is unknown, and the search starts with none at all. Each step renders one view, compares it with its picture,
and lets Adam follow the gradient of the mean squared difference by all densities: 8^3 at first, then 16^3 and 32^3. Run
it with

    python examples/smoke.py --out smoke.png

and look at the picture that it writes: a view that was given and one that was not; in each row what was
found on each grid, at last the truth.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import drjit as dr
import numpy as np
from drjit.opt import Adam

T = djpt.ScalarTransform4f
KEY = "smoke.interior_medium.sigma_t.data"
GIVEN = tuple((angle, height) for angle, height in zip(range(0, 360, 60), (0.2, 1.4) * 3, strict=True))
"""The angle in degrees and the height of the cameras."""
OTHER = (30.0, 2.4)
"""A view that isn't given."""


def ring(resolution: int) -> np.ndarray:
    """The true densities, (Z, Y, X): a tilted ring of smoke."""
    axis = (np.arange(resolution) + 0.5) / resolution * 2 - 1
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    tilted = y - 0.4 * x
    from_ring = np.hypot(np.hypot(x, z) - 0.55, tilted)
    puffs = 1 + 0.5 * np.sin(3 * np.arctan2(z, x)) * np.cos(8 * tilted)
    return (12 * puffs * np.clip(1 - (from_ring / 0.3) ** 2, 0, None)).astype(np.float32)


def load(densities: np.ndarray, size: int) -> djpt.Scene:
    """The smoke with six cameras of `size` x `size` pixels, and a seventh for the view that isn't given."""

    def camera(angle: float, height: float) -> dict[str, Any]:
        at = [4.2 * np.cos(np.radians(angle)), height, 4.2 * np.sin(np.radians(angle))]
        film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "box"}}
        return {"type": "perspective", "fov": 28, "to_world": T().look_at(at, [0, 0, 0], [0, 1, 0]), "film": film}

    grid = {"type": "gridvolume", "data": densities, "to_world": T().translate([-1, -1, -1]).scale(2)}
    smoke = {"type": "heterogeneous", "sigma_t": grid, "albedo": {"type": "rgb", "value": [0.9, 0.8, 0.7]}}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "prbvolpath", "max_depth": 6},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.25, 0.3, 0.4]}},
        "lamp": {"type": "point", "position": [-2.5, 3, 1], "intensity": {"type": "rgb", "value": [30, 26, 20]}},
        "smoke": {"type": "cube", "bsdf": {"type": "null"}, "interior": smoke},
    }
    scene.update({f"camera{number}": camera(*place) for number, place in enumerate((*GIVEN, OTHER))})
    return djpt.load_dict(scene)


def smoothed(values: np.ndarray) -> np.ndarray:
    """Numbers on a grid (Z, Y, X, 1), each mixed with its neighbours along the axes by the weights 1/4, 1/2, 1/4."""
    for axis in range(3):
        ends = [(1, 1) if axis == k else (0, 0) for k in range(4)]
        near = np.moveaxis(np.pad(values, ends, mode="edge"), axis, 0)
        values = np.moveaxis(near[:-2] / 4 + near[1:-1] / 2 + near[2:] / 4, 0, axis)
    return np.ascontiguousarray(values)


def recover(
    scene: djpt.Scene,
    pictures: Sequence[djpt.TensorXf],
    *,
    resolution: int = 32,
    steps: int = 60,
    spp: int = 32,
    rate: float = 0.5,
    report: Callable[[int, float], None] | None = None,
) -> np.ndarray:
    """Fit the densities of `scene` to the pictures of its first cameras; return them, (Z, Y, X, 1).

    The search begins without smoke on a coarse grid, whose few numbers each get many samples, and makes it finer twice.
    Gradients are smoothed, which takes away most of their noise: neighbours have similar densities.

    Args:
        scene: The scene; its densities are changed.
        pictures: What the cameras should see, (H, W, 3) each.
        resolution: The densities along each axis in the end: a multiple of 4.
        steps: Steps of Adam on each grid; each looks at one picture, in turn.
        spp: Samples per pixel of each step's picture, and as many for its gradient.
        rate: Size of the first steps on the first grid, 0.7 times that on the next. On each it shrinks to a tenth, so
            that noise averages out.
        report: Called with the number and the loss of each step.
    """
    params = djpt.traverse(scene)
    densities = np.zeros((resolution // 4,) * 3 + (1,), np.float32)
    for stage in range(3):
        if stage:
            densities = smoothed(densities.repeat(2, 0).repeat(2, 1).repeat(2, 2))
        optimizer = Adam(lr=rate, params={KEY: djpt.TensorXf(densities)})
        for step in range(stage * steps, (stage + 1) * steps):
            # Finer grids have less to change, and more noise in each number.
            optimizer.set_learning_rate(rate * 0.7**stage * 0.1 ** (step / steps - stage))
            params.update(optimizer)
            view = step % len(pictures)
            image = djpt.render(scene, params, sensor=view, spp=spp, seed=step)
            loss = dr.mean(dr.square(image - pictures[view]), axis=None)
            dr.backward(loss)
            variable = optimizer[KEY]
            dr.set_grad(variable, djpt.TensorXf(smoothed(np.array(dr.grad(variable)))))
            optimizer.step()
            optimizer[KEY] = dr.maximum(optimizer[KEY], 0)
            if report is not None:
                params.update({KEY: dr.detach(optimizer[KEY])})
                report(step, loss.item())
        densities = np.array(dr.detach(optimizer[KEY]))
    params.update({KEY: djpt.TensorXf(densities)})
    return densities


def main() -> None:
    """Take the pictures, forget the smoke, recover it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("smoke.png"), help="picture to write")
    parser.add_argument("--size", type=int, default=64, help="width and height of the views in pixels")
    parser.add_argument("--resolution", type=int, default=32, help="densities along each axis")
    parser.add_argument("--steps", type=int, default=60, help="steps on each of three grids")
    parser.add_argument("--spp", type=int, default=16, help="samples per pixel of a step")
    arguments = parser.parse_args()

    truth = ring(arguments.resolution)
    scene = load(truth, arguments.size)
    pictures = [djpt.render(scene, sensor=view, spp=256, seed=1000 + view) for view in range(len(GIVEN))]
    shown = (0, len(GIVEN))

    def views() -> list[np.ndarray]:
        return [np.array(djpt.render(scene, sensor=view, spp=128, seed=999)) for view in shown]

    columns, last = [views()], 3 * arguments.steps - 1
    start, rendering = time.perf_counter(), 0.0

    def report(step: int, loss: float) -> None:
        nonlocal rendering
        if step % 20 == 0 or step == last:
            print(f"step {step:4d}   loss {loss:.6f}")
        if (step + 1) % arguments.steps == 0:
            begin = time.perf_counter()
            columns.insert(-1, views())
            rendering += time.perf_counter() - begin

    options = {"resolution": arguments.resolution, "steps": arguments.steps, "spp": arguments.spp}
    found = recover(scene, pictures, report=report, **options)
    print(f"{last + 1} steps in {time.perf_counter() - start - rendering:.1f} s")
    error = np.sqrt(np.mean((found[..., 0] - truth) ** 2)) / np.sqrt(np.mean(truth**2))
    print(f"relative error of the densities: {error:.3f}")

    rows = [np.concatenate([column[row] for column in columns], axis=1) for row in range(len(shown))]
    djpt.write(arguments.out, np.concatenate(rows, axis=0))
    print(f"{arguments.out}: a given view above, another below; from left to right, at last the truth")


if __name__ == "__main__":
    main()

"""Recover smoke from pictures of it: 32^3 densities from six views.

A ring of smoke floats in front of a sky, with a lamp on one side. Six cameras around it have taken pictures; the
density is unknown, and the search starts with none at all. Each step renders one view, compares it with its picture,
and lets Adam follow the gradient of the mean squared difference by all 32768 numbers. Run it with

    python examples/smoke.py --out smoke.png

and look at the picture that it writes: a view that was given and one that was not; in each row what was found after
some of the steps, at last the truth.
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
        return {"type": "perspective", "fov": 36, "to_world": T().look_at(at, [0, 0, 0], [0, 1, 0]), "film": film}

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


def recover(
    scene: djpt.Scene,
    pictures: Sequence[djpt.TensorXf],
    *,
    steps: int = 240,
    spp: int = 8,
    rate: float = 0.5,
    report: Callable[[int, float], None] | None = None,
) -> np.ndarray:
    """Fit the densities of `scene` to the pictures of its first cameras; return them, (Z, Y, X, 1).

    Args:
        scene: The scene, whose densities are the start of the search; they are changed.
        pictures: What the cameras should see, (H, W, 3) each.
        steps: Steps of Adam; each looks at one picture, in turn.
        spp: Samples per pixel of each step's picture, and as many for its gradient.
        rate: Size of the first steps. It shrinks to a tenth, so that noise averages out.
        report: Called with the number and the loss of each step.
    """
    params = djpt.traverse(scene)
    optimizer = Adam(lr=rate, params={KEY: djpt.TensorXf(params[KEY])})
    for step in range(steps):
        optimizer.set_learning_rate(rate * 0.1 ** (step / steps))
        params.update(optimizer)
        view = step % len(pictures)
        image = djpt.render(scene, params, sensor=view, spp=spp, seed=step)
        loss = dr.mean(dr.square(image - pictures[view]), axis=None)
        dr.backward(loss)
        optimizer.step()
        optimizer[KEY] = dr.maximum(optimizer[KEY], 0)
        if report is not None:
            report(step, loss.item())
    params.update({KEY: dr.detach(optimizer[KEY])})
    return np.array(params[KEY])


def main() -> None:
    """Take the pictures, forget the smoke, recover it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("smoke.png"), help="picture to write")
    parser.add_argument("--size", type=int, default=96, help="width and height of the views in pixels")
    parser.add_argument("--resolution", type=int, default=32, help="densities along each axis")
    parser.add_argument("--steps", type=int, default=240)
    parser.add_argument("--spp", type=int, default=8, help="samples per pixel of a step")
    arguments = parser.parse_args()

    truth = ring(arguments.resolution)
    scene = load(truth, arguments.size)
    pictures = [djpt.render(scene, sensor=view, spp=256, seed=1000 + view) for view in range(len(GIVEN))]
    shown = (0, len(GIVEN))

    def views() -> list[np.ndarray]:
        return [np.array(djpt.render(scene, sensor=view, spp=128, seed=999)) for view in shown]

    columns, last = [views()], arguments.steps - 1
    params = djpt.traverse(scene)
    params[KEY] = np.zeros_like(truth)
    params.update()
    start, rendering = time.perf_counter(), 0.0

    def report(step: int, loss: float) -> None:
        nonlocal rendering
        if step % 20 == 0 or step == last:
            print(f"step {step:4d}   loss {loss:.6f}")
        if step + 1 in (last // 24, last // 6, last + 1):
            begin = time.perf_counter()
            columns.insert(-1, views())
            rendering += time.perf_counter() - begin

    found = recover(scene, pictures, steps=arguments.steps, spp=arguments.spp, report=report)
    print(f"{arguments.steps} steps in {time.perf_counter() - start - rendering:.1f} s")
    error = np.sqrt(np.mean((found[..., 0] - truth) ** 2)) / np.sqrt(np.mean(truth**2))
    print(f"relative error of the densities: {error:.3f}")

    rows = [np.concatenate([column[row] for column in columns], axis=1) for row in range(len(shown))]
    djpt.write(arguments.out, np.concatenate(rows, axis=0))
    print(f"{arguments.out}: a given view above, another below; from left to right, at last the truth")


if __name__ == "__main__":
    main()

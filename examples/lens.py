"""Shape a pane of glass so that the light behind it is a picture.

Parallel light falls through a pane onto a wall. One side of the pane is a mesh, whose heights are looked for: where it
is curved it gathers light, as the bottom of a pool does. `ptracer` follows the light, and differentiates what arrives
by the heights.

What light paths do at outlines is left out of such derivatives, which have to be asked for (`unproven_gradients`).
Here nothing is missing: no light meets the border of the pane, and all of it arrives in the picture.

First the heights of few points are looked for, between which the pane is smooth, then those of more and more: light has
a long way to go, and small bumps would send it astray.

    python examples/lens.py --out lens.png

writes the light behind a flat pane, behind the one that was found, and the given picture. The design: M. Papas et al.,
"Goal-based Caustics", 2011; by derivatives of light paths: M. Nimier-David et al., "Mitsuba 2", 2019, section 4.3.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import drjit as dr
import numpy as np

T = djpt.ScalarTransform4f
KEY = "lens.vertex_positions"
LIT = 0.85
"""Half the width of the light; the pane reaches from -1 to 1."""
DISTANCE = 3.0
"""From the pane to the wall."""


def pane(points: int) -> djpt.Mesh:
    """A square in z = 0 whose normals, which the light is refracted by, are interpolated."""
    x, y = np.meshgrid(np.linspace(-1, 1, points), np.linspace(-1, 1, points))
    k = np.arange(points * points).reshape(points, points)
    a, b, c, d = k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]
    faces = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))])
    positions = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    return djpt.Mesh("lens", positions, faces, props={"bsdf": GLASS})


GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0, "specular_reflectance": 0.0}
"""Without what it reflects, which misses the wall."""


def load(size: int, points: int) -> djpt.Scene:
    """The lamp, the pane, whose upper side is flat, and the wall, at which the camera looks from below the pane."""
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "gaussian"}}
    black = {"type": "diffuse", "reflectance": 0.0}
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "ptracer", "max_depth": 4, "unproven_gradients": True},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": T().look_at([0, 0, -0.5], [0, 0, -1], [0, 1, 0]),
                "film": film,
                # Its points cover the lamp evenly.
                "sampler": {"type": "sobol"},
            },
            "wall": {"type": "rectangle", "to_world": T().translate([0, 0, -DISTANCE]).scale(3)},
            "lens": pane(points),
            "top": {"type": "rectangle", "to_world": T().translate([0, 0, 0.2]), "bsdf": GLASS},
            "lamp": {
                "type": "rectangle",
                "to_world": T().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(LIT),
                "bsdf": black,
                "emitter": {"type": "directionalarea", "radiance": 1.0},
            },
        }
    )


def picture(size: int) -> Any:
    """A face, (size, size): how bright the wall is to be; 0 where no light can arrive."""
    x = ((np.arange(size) + 0.5) / size * 2 - 1) / 0.93
    x, y = np.meshgrid(x, x)
    r = np.hypot(x, y)

    def line(distance: Any, width: float) -> Any:
        return np.exp(-np.square(distance / width))

    eyes = line(np.hypot(np.abs(x) - 0.28, y + 0.25), 0.12)
    mouth = line(r - 0.42, 0.08) * np.clip(6 * y, 0, 1)
    lit = np.maximum(np.abs(x), np.abs(y)) < 0.9
    return 0.15 * lit + line(r - 0.75, 0.09) + eyes + mouth


def search(
    scene: djpt.Scene,
    target: djpt.TensorXf,
    *,
    steps: int = 30,
    spp: int = 16,
    rate: float = 0.08,
    levels: tuple[int, ...] = (5, 9, 17, 33, 65),
    report: Callable[[int, float], None] | None = None,
) -> Any:
    """Find the heights of the pane, on a grid, from the light behind it.

    Args:
        scene: The scene, whose pane is changed.
        target: The light, (H, W, 3), linear.
        steps: Steps of Adam for each level.
        spp: Light paths per pixel of a step.
        rate: The length of a step in heights, on a grid of one point.
        levels: The points of the grids along an axis, one grid after the other.
        report: Called after each level with its points and the loss, the mean square of differences.
    """
    params = djpt.traverse(scene)
    flat = dr.unravel(djpt.Point3f, djpt.Float(params[KEY]))
    points = round(dr.width(flat) ** 0.5)
    heights, seed = dr.zeros(djpt.TensorXf, (levels[0], levels[0])), 0
    for level in levels:
        optimizer = djpt.ad.Adam(lr=rate, params={"heights": dr.resample(heights, (level, level), filter="linear")})
        for step in range(steps):
            optimizer.set_learning_rate(rate / level * (1 - 0.7 * step / steps))
            z = dr.resample(optimizer["heights"], (points, points), filter="cubic")
            params[KEY] = dr.ravel(djpt.Point3f(flat.x, flat.y, flat.z + z.array))
            params.update()
            image = djpt.render(scene, params, spp=spp, seed=seed)
            loss = dr.mean(dr.square(image - target), axis=None)
            dr.backward(loss)
            optimizer.step()
            seed += 1
        heights = dr.detach(optimizer["heights"])
        if report is not None:
            report(level, float(loss.array[0]))
    return heights


def main() -> None:
    """Look at the light behind a flat pane, and shape the pane."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("lens.png"), help="picture to write")
    parser.add_argument("--size", type=int, default=64, help="width and height in pixels")
    parser.add_argument("--points", type=int, default=65, help="points of the pane along an axis")
    parser.add_argument("--steps", type=int, default=30, help="steps for each of the grids")
    arguments = parser.parse_args()

    scene = load(arguments.size, arguments.points)
    before = djpt.render(scene, spp=512, seed=2**20).numpy()
    wanted = picture(arguments.size)[:, :, None] * [1.0, 1.0, 1.0]
    # As much light as there is.
    target = djpt.TensorXf((wanted * before.sum() / wanted.sum()).astype(np.float32))

    begin = time.perf_counter()

    def report(level: int, loss: float) -> None:
        print(f"{level:3d} x {level:<3d} heights   loss {loss:.2e}   {time.perf_counter() - begin:.0f} s")

    search(scene, target, steps=arguments.steps, report=report)
    after = djpt.render(scene, spp=512, seed=2**20).numpy()
    djpt.write(arguments.out, np.concatenate([before, after, target.numpy()], axis=1))
    print(f"{arguments.out}: behind a flat pane, behind the one that was found, and the given picture")


if __name__ == "__main__":
    main()

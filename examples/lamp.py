"""Find a lamp by the shadow that a plate throws.

The picture shows a white floor with a shadow on it, and neither the lamp nor the plate. Where the shadow ends says
where the lamp is; its brightness tells the distance. Both change as the lamp moves: `direct_projective` has the
derivatives of the light on the floor and of the edges of shadows. Adam takes the lamp from the other side of the plate
to its place. The pictures are blurred at first, so that shadows far apart feel each other.

    python examples/lamp.py --out lamp.png

writes the picture with the lamp where the search starts, with the one that was found, and the given one.
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
from drjit.opt import Adam

T = djpt.ScalarTransform4f
KEY = "lamp.position"
BLUR = 0.2
"""The standard deviation of the first blur, in widths of the picture."""
TRUTH, START = (1.2, 0.8, 3.5), (-1.0, -0.6, 4.5)


def load(size: int) -> djpt.Scene:
    """A floor in the light of a lamp at its true place, and a plate above it, out of the picture."""
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    place = T().look_at([0, -6, 2.5], [0, 0, 0], [0, 0, 1])
    return djpt.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "fov": 30, "to_world": place, "film": film},
            "floor": {"type": "rectangle", "to_world": T().scale(20)},
            "plate": {"type": "disk", "to_world": T().translate([0, 0, 2.2]).scale(0.6)},
            "lamp": {"type": "point", "position": list(TRUTH), "intensity": 20.0},
        }
    )


def search(
    scene: djpt.Scene,
    target: djpt.TensorXf,
    start: tuple[float, float, float],
    *,
    steps: int = 100,
    spp: int = 16,
    rate: float = 0.15,
    report: Callable[[int, float, Any], None] | None = None,
) -> Any:
    """Find the place of the lamp, (3,), from a picture.

    Args:
        scene: The scene, whose lamp is moved.
        target: The picture, (H, W, 3), linear.
        start: The place to start from.
        steps: Steps of Adam.
        spp: Samples per pixel of each picture, and of each estimate of a derivative.
        rate: The length of the first steps. It shrinks to a fiftieth, so that noise averages out.
        report: Called with the number and the loss of each step, and the place.
    """
    params, how = djpt.traverse(scene), djpt.load_dict({"type": "direct_projective"})
    optimizer = Adam(lr=rate, params={KEY: djpt.Point3f(*start)})
    for step in range(steps):
        optimizer.set_learning_rate(rate * 0.02 ** (step / steps))
        params.update(optimizer)
        image = djpt.render(scene, params, integrator=how, spp=spp, seed=step)
        blur = blurring(len(target), BLUR * len(target) * (1 - step / steps) ** 2)
        difference = np.einsum("ij,jkc,lk->ilc", blur, np.array(image - target), blur, optimize=True)
        # The loss is half the sum of the squares; its derivative by the pixels is blurred once more.
        slope = np.einsum("ij,ilc,lk->jkc", blur, difference, blur, optimize=True)
        dr.backward(dr.sum(image * djpt.TensorXf(slope.astype(np.float32)), axis=None))
        optimizer.step()
        if report is not None:
            report(step, float(np.square(difference).mean()), place_of(optimizer[KEY]))
    params.update({KEY: dr.detach(optimizer[KEY])})
    return place_of(optimizer[KEY])


def blurring(size: int, sigma: float) -> Any:
    """The matrix (size, size) of a Gaussian filter whose standard deviation is `sigma` pixels."""
    place = np.arange(size)
    weights = np.exp(-0.5 * np.square((place[:, None] - place) / (sigma + 1e-3)))
    return weights / weights.sum(axis=1, keepdims=True)


def place_of(point: Any) -> Any:
    """A point as a NumPy array, (3,)."""
    return np.array(dr.detach(point)).ravel()


def main() -> None:
    """Take a picture, forget where the lamp was, find it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("lamp.png"), help="picture to write")
    parser.add_argument("--size", type=int, default=96, help="width and height in pixels")
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--spp", type=int, default=16, help="samples per pixel of a step")
    arguments = parser.parse_args()

    scene = load(arguments.size)
    params = djpt.traverse(scene)
    target = djpt.render(scene, spp=256, seed=2**20)
    params[KEY] = START
    params.update()
    before = djpt.render(scene, spp=256)

    def report(step: int, loss: float, place: Any) -> None:
        if step % 10 == 0 or step == arguments.steps - 1:
            print(f"step {step:4d}   loss {loss:.2e}   off by {np.linalg.norm(place - TRUTH):.4f}")

    begin = time.perf_counter()
    found = search(scene, target, START, steps=arguments.steps, spp=arguments.spp, report=report)
    print(f"{time.perf_counter() - begin:.1f} s; the lamp is at {np.round(found, 3)}, found; {TRUTH}, true")
    after = djpt.render(scene, spp=256)
    djpt.write(arguments.out, np.concatenate([np.array(i) for i in (before, after, target)], axis=1))
    print(f"{arguments.out}: start, found, given")


if __name__ == "__main__":
    main()

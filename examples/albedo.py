"""Recover the albedos of the Cornell box from a picture of it.

The white, green and red paint are unknown: all start as the same grey. Each step renders the
scene, compares it with the target picture, and lets Adam follow the gradient of the mean squared
(relative) difference by the nine numbers. Run it with

    python examples/albedo.py --out albedo.png

and look at the picture that it writes: before, target and after, side by side.
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

KEYS = [f"{paint}.reflectance.value" for paint in ("white", "green", "red")]


def load(size: int) -> djpt.Scene:
    """The Cornell box with `size` x `size` pixels."""
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=size, height=size)
    return djpt.load_dict(description)


def values(params: djpt.SceneParameters) -> dict[str, Any]:
    """The three albedos as NumPy arrays of shape (3,)."""
    return {key: np.array(dr.detach(params[key])).ravel() for key in KEYS}


def recover(
    scene: djpt.Scene,
    target: djpt.TensorXf,
    *,
    steps: int = 80,
    spp: int = 16,
    rate: float = 0.1,
    report: Callable[[int, float], None] | None = None,
) -> dict[str, Any]:
    """Fit the albedos of `scene` to the picture `target`; return them by name.

    Args:
        scene: The scene, whose albedos are the start of the search; they are changed.
        target: The picture, (H, W, 3), linear.
        steps: Steps of Adam.
        spp: Samples per pixel of each step's picture, and as many for its gradient.
        rate: Size of the first steps. It shrinks to a twentieth, so that noise averages out.
        report: Called with the number and the loss of each step.
    """
    params = djpt.traverse(scene)
    optimizer = Adam(lr=rate, params={key: djpt.Color3f(params[key]) for key in KEYS})
    for step in range(steps):
        optimizer.set_learning_rate(rate * 0.05 ** (step / steps))
        params.update(optimizer)
        # A new seed in each step: the noise of the steps is independent and averages out.
        image = djpt.render(scene, params, spp=spp, seed=step)
        # Relative to the target, so that dark pixels count as well; its square keeps noise from biasing the result.
        loss = dr.mean(dr.square((image - target) / (target + 0.1)), axis=None)
        dr.backward(loss)
        optimizer.step()
        for key in KEYS:
            optimizer[key] = dr.clip(optimizer[key], 0, 1)
        if report is not None:
            report(step, loss.item())
    params.update({key: dr.detach(optimizer[key]) for key in KEYS})
    return values(params)


def main() -> None:
    """Make a target picture, forget the albedos, recover them."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("albedo.png"), help="picture to write")
    parser.add_argument("--size", type=int, default=256, help="width and height in pixels")
    parser.add_argument("--steps", type=int, default=80)
    parser.add_argument("--spp", type=int, default=16, help="samples per pixel of a step")
    arguments = parser.parse_args()

    scene = load(arguments.size)
    params = djpt.traverse(scene)
    truth = values(params)
    target = djpt.render(scene, spp=256, seed=2**31)

    for key in KEYS:
        params[key] = 0.5
    params.update()
    before = djpt.render(scene, spp=256)

    def report(step: int, loss: float) -> None:
        if step % 10 == 0 or step == arguments.steps - 1:
            print(f"step {step:4d}   loss {loss:.6f}")

    start = time.perf_counter()
    found = recover(scene, target, steps=arguments.steps, spp=arguments.spp, report=report)
    print(f"{arguments.steps} steps in {time.perf_counter() - start:.1f} s\n")

    print(f"{'':6}{'true':^24}{'found':^24}error")
    for key in KEYS:
        error = np.abs(found[key] - truth[key]).max()
        row = "".join("{:8.4f}{:8.4f}{:8.4f}".format(*albedo[key]) for albedo in (truth, found))
        print(f"{key.split('.')[0]:6}{row}{error:9.4f}")

    after = djpt.render(scene, spp=256)
    djpt.write(arguments.out, np.concatenate([np.array(i) for i in (before, target, after)], axis=1))
    print(f"\n{arguments.out}: before, target, after")


if __name__ == "__main__":
    main()

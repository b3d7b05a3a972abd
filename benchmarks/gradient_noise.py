"""The noise of gradients, times their time, in the ten problems of `inverse.py`: as `render` has them, and as a search.

By `render`: an image and one reverse derivative of the mean square of its residuals, each with samples of its own, by
the default sampler, `independent`. As `least_squares` has it, with `sobol`: the sixth of a row of steps that approach
the same place, each a fiftieth of the way from start to truth, with tables of derivatives and means over steps where
there are some, in recorded functions where shapes, cameras and volumes stay as they are. The error is the mean square
of the difference from a mean of 48 gradients by `render`, bias included; seconds are those of the processor, of one
thread, for the last step alone, kernels compiled and functions recorded before.

    python benchmarks/gradient_noise.py
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import dataclasses
import math
import sys
import time
from typing import Any

import drjit as dr
import numpy as np
from inverse import PROBLEMS, Renderer, in_djpt
from inverse_scenes import Problem

from djpt.apps.benchmarks.measuring import heading, machine
from djpt.apps.optimization.least_squares import Problem as Equations
from djpt.apps.optimization.passes import Passes

STEPS, STEP = 6, 0.02
"""The number of steps of a row, and their length relative to the way from start to truth."""
NEAR = 0.8
"""Where the row ends on that way."""
REFERENCE, ROWS = 48, 12
"""The numbers of gradients of the reference, and of rows."""

Doubles = np.ndarray[Any, np.dtype[np.float64]]


def by_render(renderer: Renderer, x: Doubles, seed: int) -> tuple[Doubles, float]:
    """The gradient of the mean square of the residuals, and its seconds."""
    problem, begun = renderer.problem, time.process_time()
    unknown = renderer.typed(x.astype(np.float32))
    dr.enable_grad(unknown)
    renderer.set(unknown)
    image = djpt.render(renderer.scene, renderer.params, spp=problem.spp, seed=seed)
    dr.backward(dr.mean(dr.square(image - renderer.target), axis=None))
    return np.array(unknown.grad, np.float64).ravel(), time.process_time() - begun


def in_search(equations: Equations, x: Doubles, way: Doubles, seed: int) -> tuple[Doubles, float]:
    """The same of the last step of a row that ends at x, and its seconds."""
    equations.before, before = None, np.zeros(())
    for k in range(STEPS):
        place, number = x - (STEPS - 1 - k) * STEP * way, 100 * seed + k
        if k:
            # A search has this from judging the step before.
            before = equations.residuals(place, number + 50)
        begun = time.process_time()
        now = equations.residuals(place, number)
        if k:
            equations.noise = float(np.mean(np.square(now - before))) / 2
        slope = equations.slope(place, now, number)
    return slope * 2 / now.size, time.process_time() - begun


def measured(problem: Problem) -> tuple[float, float, float, float]:
    """Errors relative to the mean square of the reference, and seconds: by `render`, and in a search."""
    plainly = Renderer(djpt, problem, in_djpt(problem, "independent"))
    renderer = Renderer(djpt, problem, in_djpt(problem))
    module, scene, target, apply, spp = djpt, renderer.scene, renderer.target, problem.apply, problem.spp

    def residual(x: Any, seed: Any) -> Any:
        params = module.traverse(scene)
        apply(module, params, x["x"])
        params.update()
        return module.render(scene, params, spp=spp, seed=seed) - target

    start, truth = (np.asarray(end, np.float64) for end in (problem.start, problem.truth))
    x, way = start + NEAR * (truth - start), (truth - start).ravel()
    frozen = problem.frozen or problem.method == "gauss_newton"
    equations = Equations(Passes(residual, frozen), {"x": renderer.typed(problem.start)}, {}, {})
    in_search(equations, x.ravel(), way, 0)
    rows = [in_search(equations, x.ravel(), way, 1 + k) for k in range(ROWS)]
    plainly.target = renderer.target
    by_render(plainly, x, 0)
    plain = [by_render(plainly, x, 1 + k) for k in range(REFERENCE)]
    reference = np.mean([gradient for gradient, _ in plain], axis=0)
    size = float(np.mean(np.square(reference)))
    found = []
    for several in (plain, rows):
        errors = [float(np.mean(np.square(gradient - reference))) / size for gradient, _ in several]
        found += [float(np.mean(errors)), float(np.median([seconds for _, seconds in several]))]
    return found[0], found[1], found[2], found[3]


def main() -> int:
    """Print errors, seconds, and the ratio of their products."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*", choices=[*PROBLEMS, []], default=[])
    names = parser.parse_args().problems or list(PROBLEMS)
    dr.set_thread_count(1)
    print(heading(machine(), "noise x time by render / in a search"))
    ratios = []
    for name in names:
        # Derivatives of what moves need the integrator for it, not differences of images.
        problem = dataclasses.replace(PROBLEMS[name](), differences=0.0)
        error, seconds, later_error, later_seconds = measured(problem)
        ratios.append(error * seconds / (later_error * later_seconds))
        print(
            f"{problem.name:<42} error {error:.4f} -> {later_error:.4f}, ms {1e3 * seconds:.1f} -> "
            f"{1e3 * later_seconds:.1f}, ratio {ratios[-1]:.2f}",
            flush=True,
        )
    print(f"geometric mean {math.exp(np.mean(np.log(ratios))):.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Times of djpt, compared with Mitsuba 3 on the same machine.

    python benchmarks/versus_mitsuba.py [--quick] [--pairs N] [--json FILE]

Both renderers run in this process and share Dr.Jit's threads. They take turns, pair by pair, so
that other load on the machine slows both; the ratio of a row is the median over the pairs of
Mitsuba's time divided by djpt's, with the smallest and the largest. Kernels are compiled before
the clock starts, except in the row that measures just that. Exit code 1: a required ratio was missed.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import statistics
import sys
from collections.abc import Iterator
from typing import Any

import mitsuba as mi
import numpy as np
from gradients import image_and_gradient
from pairs import Row, first_image, in_pairs, report

ALBEDOS = [f"{paint}.reflectance.value" for paint in ("white", "green", "red")]


def cornell_box(module: Any, rfilter: str, integrator: str = "path") -> dict[str, Any]:
    """The scene as `module` (djpt or mitsuba) describes it: 256x256, depth 8."""
    scene = module.cornell_box()
    scene["sensor"]["film"]["rfilter"] = {"type": rfilter}
    scene["integrator"] = {"type": integrator, "max_depth": 8}
    return scene


# ---- rows -------------------------------------------------------------------------------


def image_row(rfilter: str, spp: int, pairs: int, required: float, aim: float) -> Row:
    """Measure an image, kernels compiled."""
    ours, theirs = (m.load_dict(cornell_box(m, rfilter)) for m in (djpt, mi))
    ratios, times = in_pairs(
        lambda seed: djpt.render(ours, spp=spp, seed=seed), lambda seed: mi.render(theirs, spp=spp, seed=seed), pairs
    )
    return Row(f"image, {rfilter} filter, {spp} spp", required, aim, ratios, times)


def first_image_row(rfilter: str, pairs: int, required: float) -> Row:
    """Measure the first image of a process that finds no compiled kernels, without its imports."""
    results = [(first_image("mitsuba", rfilter), first_image("djpt", rfilter)) for _ in range(pairs)]
    medians = [
        [statistics.median(pair[side][key] for pair in results) for side in (0, 1)] for key in ("image", "process")
    ]
    (their_image, our_image), (their_process, our_process) = medians
    whole = statistics.median(theirs["process"] / ours["process"] for theirs, ours in results)
    return Row(
        f"first image in a process, {rfilter} filter, 16 spp",
        required,
        None,
        [theirs["image"] / ours["image"] for theirs, ours in results],
        f"{1e3 * their_image:.0f} ms / {1e3 * our_image:.0f} ms; with Python and imports "
        f"{their_process:.2f} s / {our_process:.2f} s = {whole:.2f}",
    )


def gradient_rows(rfilter: str, pairs: int, required: float, aim: float) -> Iterator[Row]:
    """Measure an image and the gradient of a linear loss by nine numbers: time, and agreement at equal seeds."""
    loss_weights = np.random.default_rng(0).random((256, 256, 3), dtype=np.float32)

    ours, theirs = (image_and_gradient(m, cornell_box(m, rfilter), ALBEDOS, loss_weights) for m in (djpt, mi))
    ratios, times = in_pairs(ours, theirs, pairs)
    yield Row(f"image and gradient, {rfilter} filter, 16 spp", required, aim, ratios, times)

    a, b = (np.array([np.array(g).ravel() for g in work(7)]) for work in (ours, theirs))
    error = float(np.abs(a - b).max() / np.abs(b).max())
    yield Row("  its difference, of the largest", 0.01, None, [error], "same seed, nine components", at_most=True)


def all_rows(pairs: int, quick: bool) -> Iterator[Row]:
    """Measure all rows of the table."""
    spp = 64 if quick else 256
    yield image_row("box", spp, pairs, 12, 15)
    yield image_row("gaussian", spp, pairs, 8, 10)
    yield first_image_row("box", min(pairs, 5), 2.5)
    yield first_image_row("gaussian", min(pairs, 5), 1.5)
    yield from gradient_rows("box", pairs, 8, 11)
    yield from gradient_rows("gaussian", pairs, 6.5, 9)


if __name__ == "__main__":
    sys.exit(report(__doc__.split("\n")[0], "Cornell box, 256x256, depth 8", all_rows))

"""How fast is djpt, compared with Mitsuba 3 on the same machine?

    python benchmarks/versus_mitsuba.py [--quick] [--pairs N] [--json FILE]

Both renderers run in this process and share Dr.Jit's threads. They take turns, pair by pair, so
that whatever slows the machine down slows both; the ratio of a row is the median over the pairs of
Mitsuba's time divided by djpt's, with the smallest and the largest. Kernels are compiled before
the clock starts, except in the row that measures just that. Exit code 1: a required ratio was missed.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

FIRST_IMAGE = Path(__file__).with_name("first_image.py")
ALBEDOS = [f"{paint}.reflectance.value" for paint in ("white", "green", "red")]


@dataclass
class Row:
    """One line of the table."""

    what: str
    required: float | None
    """None: for information."""
    aim: float | None
    ratios: list[float]
    """Mitsuba's time / djpt's, one per pair; or a single number that must not exceed `required`."""
    note: str = ""
    at_most: bool = False

    @property
    def measured(self) -> float:
        """The median."""
        return statistics.median(self.ratios)

    @property
    def passed(self) -> bool:
        """Was the required number reached?"""
        if self.required is None:
            return True
        return self.measured <= self.required if self.at_most else self.measured >= self.required


# ---- measuring --------------------------------------------------------------------------


def seconds(work: Callable[[], Any]) -> float:
    """The time of one call, until all its results are computed."""
    dr.sync_thread()
    start = time.perf_counter()
    dr.eval(work())
    dr.sync_thread()
    return time.perf_counter() - start


def in_pairs(ours: Callable[[int], Any], theirs: Callable[[int], Any], pairs: int) -> tuple[list[float], str]:
    """The ratios of interleaved calls, and the median times in words. Each call gets a new seed."""
    for seed in (0, 1):
        seconds(lambda seed=seed: ours(seed))
        seconds(lambda seed=seed: theirs(seed))
    times = []
    for seed in range(2, pairs + 2):
        times.append((seconds(lambda seed=seed: theirs(seed)), seconds(lambda seed=seed: ours(seed))))
    their_time, our_time = (statistics.median(column) for column in zip(*times, strict=True))
    return [a / b for a, b in times], f"{1e3 * their_time:.0f} ms / {1e3 * our_time:.0f} ms"


def cornell_box(module: Any, rfilter: str, integrator: str = "path") -> dict[str, Any]:
    """The scene as `module` (djpt or mitsuba) describes it: 256x256, depth 8."""
    scene = module.cornell_box()
    scene["sensor"]["film"]["rfilter"] = {"type": rfilter}
    scene["integrator"] = {"type": integrator, "max_depth": 8}
    return scene


# ---- rows -------------------------------------------------------------------------------


def image_row(rfilter: str, spp: int, pairs: int, required: float, aim: float) -> Row:
    """An image, warm."""
    ours, theirs = (m.load_dict(cornell_box(m, rfilter)) for m in (djpt, mi))
    ratios, times = in_pairs(
        lambda seed: djpt.render(ours, spp=spp, seed=seed), lambda seed: mi.render(theirs, spp=spp, seed=seed), pairs
    )
    return Row(f"image, {rfilter} filter, {spp} spp", required, aim, ratios, times)


def first_image_row(rfilter: str, pairs: int, required: float | None) -> Row:
    """The first image of a process that finds no compiled kernels, without its imports."""
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


def first_image(renderer: str, rfilter: str) -> dict[str, float]:
    """`image`: seconds from the end of the imports to the image; `process`: from start to exit."""
    with tempfile.TemporaryDirectory() as cache:
        start = time.perf_counter()
        done = subprocess.run(
            [sys.executable, str(FIRST_IMAGE), renderer, rfilter],
            env={**os.environ, "DRJIT_CACHE_DIR": cache},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        return {"image": float(done.stdout.split()[-1]), "process": time.perf_counter() - start}


def gradient_rows(rfilter: str, pairs: int, required: float, aim: float) -> Iterator[Row]:
    """An image and the gradient of a linear loss by nine numbers; time, and agreement at equal seeds."""
    loss_weights = np.random.default_rng(0).random((256, 256, 3), dtype=np.float32)

    def gradient(module: Any) -> Callable[[int], list[Any]]:
        scene = module.load_dict(cornell_box(module, rfilter, "prb"))
        params = module.traverse(scene)
        for key in ALBEDOS:
            dr.enable_grad(params[key])
        params.update()
        weights = module.TensorXf(loss_weights)

        def work(seed: int) -> list[Any]:
            for key in ALBEDOS:
                dr.clear_grad(params[key])
            image = module.render(scene, params, spp=16, seed=seed)
            dr.backward(dr.mean(image * weights, axis=None))
            return [dr.grad(params[key]) for key in ALBEDOS]

        return work

    ours, theirs = gradient(djpt), gradient(mi)
    ratios, times = in_pairs(ours, theirs, pairs)
    yield Row(f"image and gradient, {rfilter} filter, 16 spp", required, aim, ratios, times)

    a, b = (np.array([np.array(g).ravel() for g in work(7)]) for work in (ours, theirs))
    error = float(np.abs(a - b).max() / np.abs(b).max())
    yield Row("  its difference, of the largest", 0.01, None, [error], "same seed, nine components", at_most=True)


def all_rows(pairs: int, spp: int) -> Iterator[Row]:
    """The whole table."""
    yield image_row("box", spp, pairs, 12, 15)
    yield image_row("gaussian", spp, pairs, 8, 10)
    yield first_image_row("box", min(pairs, 5), 2.5)
    yield first_image_row("gaussian", min(pairs, 5), None)
    yield from gradient_rows("box", pairs, 8, 11)
    yield from gradient_rows("gaussian", pairs, 6.5, 9)


# ---- reporting --------------------------------------------------------------------------


def machine() -> dict[str, Any]:
    """What the numbers depend on."""
    cpu, flags = platform.processor() or platform.machine(), ""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        fields = dict(line.split(":", 1) for line in cpuinfo.read_text().split("\n\n")[0].splitlines() if ":" in line)
        fields = {key.strip(): value.strip() for key, value in fields.items()}
        cpu, flags = fields.get("model name", cpu), fields.get("flags", "")
    return {
        "cpu": cpu,
        "vectors": "AVX-512" if "avx512f" in flags else "AVX2" if "avx2" in flags else "",
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": dr.thread_count(),
        "load": os.getloadavg()[0],
        "llvm": ".".join(map(str, dr.detail.llvm_version())),
        "python": platform.python_version(),
        "drjit": dr.__version__,
        "mitsuba": mi.__version__,
        "djpt": djpt.__version__,
    }


def heading(facts: dict[str, Any]) -> str:
    """The machine in two lines."""
    versions = ", ".join(f"{name} {facts[name]}" for name in ("djpt", "mitsuba", "drjit", "python"))
    return (
        f"{facts['cpu']} {facts['vectors']}, {facts['cores']} cores, {facts['threads']} threads, "
        f"load {facts['load']:.1f}, LLVM {facts['llvm']}\n{versions}\n"
        "Cornell box, 256x256, depth 8; Mitsuba's time / djpt's, median of interleaved pairs (smallest, largest)\n"
    )


def line(row: Row) -> str:
    """One line of the table."""
    sign = "<=" if row.at_most else ">="
    required = "" if row.required is None else f"{sign} {row.required:g}"
    aim = "" if row.aim is None else f"{row.aim:g}"
    verdict = "" if row.required is None else "ok" if row.passed else "MISSED"
    if row.at_most:
        measured = f"{row.measured:.5f}"
    else:
        measured = f"{row.measured:.2f} ({min(row.ratios):.2f}, {max(row.ratios):.2f})"
    return LAYOUT.format(row.what, required, aim, measured, verdict, row.note)


LAYOUT = "{:49} {:>8} {:>5} {:>22}  {:6}  {}"


def main() -> int:
    """Measure, print, say whether all required numbers were reached."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="3 pairs, 64 spp in place of 256")
    parser.add_argument("--pairs", type=int, help="pairs of each row (default 7)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to FILE as well")
    arguments = parser.parse_args()
    pairs = arguments.pairs or (3 if arguments.quick else 7)
    if pairs < 1:
        parser.error("--pairs must be at least 1")

    mi.set_variant("llvm_ad_rgb")
    djpt.set_variant("llvm_ad_rgb")
    facts = machine()
    print(heading(facts))
    print(LAYOUT.format("what", "required", "aim", "measured", "", "Mitsuba / djpt").rstrip())
    rows = []
    for row in all_rows(pairs, 64 if arguments.quick else 256):
        print(line(row), flush=True)
        rows.append(row)
    if arguments.json:
        numbers = [{**asdict(row), "measured": row.measured, "passed": row.passed} for row in rows]
        arguments.json.write_text(json.dumps({"machine": facts, "rows": numbers}, indent=1) + "\n")
    return 0 if all(row.passed for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())

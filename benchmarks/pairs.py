"""Measurements of two renderers in turns, and their report: shared by the benchmarks of this folder."""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import json
import math
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

from djpt.jit.backends import load_backend, variant
from djpt.jit.llvm.lanes import force_lanes, instruction_set, lane_count

__all__ = ["Row", "first_image", "heading", "in_pairs", "machine", "report", "seconds", "times_in_pairs"]

FIRST_IMAGE = Path(__file__).with_name("first_image.py")


@dataclass
class Row:
    """One line of the table."""

    what: str
    required: float | None
    """The ratio to be reached; None: for information."""
    aim: float | None
    ratios: list[float]
    """Mitsuba's time / djpt's, one per pair; or a single number that must not exceed `required`."""
    note: str = ""
    at_most: bool = False

    @property
    def measured(self) -> float:
        """The median of the ratios."""
        return statistics.median(self.ratios)

    @property
    def passed(self) -> bool:
        """Whether the required number was reached."""
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


def times_in_pairs(
    ours: Callable[[int], Any],
    theirs: Callable[[int], Any],
    pairs: int,
    warm_up: int = 2,
    limit: float = math.inf,
) -> list[tuple[float, float]]:
    """Measure interleaved calls: pairs of seconds, theirs and ours, after `warm_up` pairs. Each call gets a new seed.

    There are fewer than `pairs`, but at least one, if they take longer than `limit` seconds together.
    """
    for seed in range(warm_up):
        seconds(lambda seed=seed: ours(seed))
        seconds(lambda seed=seed: theirs(seed))
    times: list[tuple[float, float]] = []
    while len(times) < pairs and sum(map(sum, times)) < limit:
        seed = len(times) + 2
        times.append((seconds(lambda seed=seed: theirs(seed)), seconds(lambda seed=seed: ours(seed))))
    return times


def in_pairs(ours: Callable[[int], Any], theirs: Callable[[int], Any], pairs: int) -> tuple[list[float], str]:
    """Measure interleaved calls: their ratios, and the median times in words. Each call gets a new seed."""
    times = times_in_pairs(ours, theirs, pairs)
    their_time, our_time = (statistics.median(column) for column in zip(*times, strict=True))
    return [a / b for a, b in times], f"{1e3 * their_time:.0f} ms / {1e3 * our_time:.0f} ms"


def first_image(renderer: str, scene: str) -> dict[str, float]:
    """The seconds of `first_image.py` from the end of the imports to the image, `image`, and to the exit, `process`."""
    with tempfile.TemporaryDirectory() as cache:
        start = time.perf_counter()
        done = subprocess.run(
            [sys.executable, str(FIRST_IMAGE), renderer, scene],
            env={**os.environ, "DRJIT_CACHE_DIR": cache},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        return {"image": float(done.stdout.split()[-1]), "process": time.perf_counter() - start}


# ---- reporting --------------------------------------------------------------------------


def machine() -> dict[str, Any]:
    """The facts that the numbers depend on: processor, versions, variant."""
    cpu = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        fields = dict(line.split(":", 1) for line in cpuinfo.read_text().split("\n\n")[0].splitlines() if ":" in line)
        fields = {key.strip(): value.strip() for key, value in fields.items()}
        cpu = fields.get("model name", cpu)
    return {
        "cpu": cpu,
        "vectors": f"{instruction_set()}, {lane_count()} lanes" if variant() == "llvm_ad_rgb" else gpu(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": dr.thread_count(),
        "load": os.getloadavg()[0],
        "llvm": ".".join(map(str, dr.detail.llvm_version())),
        "python": platform.python_version(),
        "drjit": dr.__version__,
        "mitsuba": mi.__version__,
        "djpt": djpt.__version__,
    }


def gpu() -> str:
    """The name of the GPU and of its driver, as far as they can be found out, and the version of CUDA."""
    command = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[0]
    except (OSError, subprocess.SubprocessError, IndexError):
        found = "GPU"
    version = ".".join(map(str, dr.detail.cuda_version()))
    return f"{found}, compute capability {dr.detail.cuda_compute_capability()}, CUDA {version}"


def heading(facts: dict[str, Any], what: str) -> str:
    """The machine in two lines, and what was measured."""
    versions = ", ".join(f"{name} {facts[name]}" for name in ("djpt", "mitsuba", "drjit", "python"))
    return (
        f"{facts['cpu']} {facts['vectors']}, {facts['cores']} cores, {facts['threads']} threads, "
        f"load {facts['load']:.1f}, LLVM {facts['llvm']}\n{versions}\n"
        f"{what}; Mitsuba's time / djpt's, median of interleaved pairs (smallest, largest)\n"
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


def report(description: str, what: str, all_rows: Callable[[int, bool], Iterator[Row]]) -> int:
    """Read the command line, measure `all_rows(pairs, quick)`, print; return 0 if all required numbers were reached."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="3 pairs, and smaller images")
    parser.add_argument("--pairs", type=int, help="pairs of each row (default 7)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to FILE as well")
    parser.add_argument("--lanes", type=int, choices=(8, 16), help="compile for AVX2 or AVX-512")
    arguments = parser.parse_args()
    pairs = arguments.pairs or (3 if arguments.quick else 7)
    if pairs < 1:
        parser.error("--pairs must be at least 1")

    mi.set_variant("llvm_ad_rgb")
    djpt.set_variant("llvm_ad_rgb")
    if arguments.lanes:
        load_backend()
        force_lanes(arguments.lanes)
    facts = machine()
    print(heading(facts, what))
    print(LAYOUT.format("what", "required", "aim", "measured", "", "Mitsuba / djpt").rstrip())
    rows = []
    for row in all_rows(pairs, arguments.quick):
        print(line(row), flush=True)
        rows.append(row)
    if arguments.json:
        numbers = [{**asdict(row), "measured": row.measured, "passed": row.passed} for row in rows]
        arguments.json.write_text(json.dumps({"machine": facts, "rows": numbers}, indent=1) + "\n")
    return 0 if all(row.passed for row in rows) else 1

"""Measurements of two renderers in turns, and the facts of the machine that they depend on."""

from __future__ import annotations

import importlib.metadata
import math
import os
import platform
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr

import djpt
from djpt.jit.backends import variant
from djpt.jit.llvm.gathers import gather_as_llvm_does
from djpt.jit.llvm.lanes import instruction_set, lane_count

__all__ = ["CLOCKS", "heading", "machine", "seconds", "times_in_pairs"]

CLOCKS: dict[str, Callable[[], float]] = {"wall": time.perf_counter, "cpu": time.process_time}
"""What is measured: the time that passes, or the time of all processors that this process takes."""


def seconds(work: Callable[[], Any], clock: str = "wall") -> float:
    """The time of one call, until all its results are computed."""
    now = CLOCKS[clock]
    dr.sync_thread()
    start = now()
    dr.eval(work())
    dr.sync_thread()
    return now() - start


def times_in_pairs(
    ours: Callable[[int], Any],
    theirs: Callable[[int], Any],
    pairs: int,
    warm_up: int = 2,
    limit: float = math.inf,
    clock: str = "wall",
) -> list[tuple[float, float]]:
    """Measure interleaved calls: pairs of seconds, theirs and ours, after `warm_up` pairs. Each call gets a new seed.

    There are fewer than `pairs`, but at least one, if they take longer than `limit` seconds together. Kernels of
    theirs are compiled as without djpt.
    """

    def their_seconds(seed: int) -> float:
        with gather_as_llvm_does():
            return seconds(lambda: theirs(seed), clock)

    def our_seconds(seed: int) -> float:
        return seconds(lambda: ours(seed), clock)

    for seed in range(warm_up):
        our_seconds(seed)
        their_seconds(seed)
    times: list[tuple[float, float]] = []
    while len(times) < pairs and sum(map(sum, times)) < limit:
        seed = len(times) + 2
        times.append((their_seconds(seed), our_seconds(seed)))
    return times


def machine() -> dict[str, Any]:
    """The facts that the numbers depend on: processor, versions, variant."""
    cpu = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        fields = dict(line.split(":", 1) for line in cpuinfo.read_text().split("\n\n")[0].splitlines() if ":" in line)
        fields = {key.strip(): value.strip() for key, value in fields.items()}
        cpu = fields.get("model name", cpu)
        if "cpu family" in fields and cpu.startswith("AMD"):  # which doesn't tell its generation by name everywhere
            cpu += f" (family {fields['cpu family']}, model {fields.get('model', '?')})"
    return {
        "cpu": cpu,
        "vectors": f"{instruction_set()}, {lane_count()} lanes" if variant() == "llvm_ad_rgb" else gpu(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": dr.thread_count(),
        "load": os.getloadavg()[0],
        "llvm": ".".join(map(str, dr.detail.llvm_version())),
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in ("drjit", "mitsuba")},
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
        f"{what}; Mitsuba's time / djpt's, median of interleaved pairs\n"
    )

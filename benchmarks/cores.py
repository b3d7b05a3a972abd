"""How the time of an image falls with the number of threads, and what more cores would give.

    python benchmarks/cores.py [--runs N] [--cores N]

Per image: the time with 1, 2, 4, .. threads, and the part S that only one thread works on, by two measures. *Python* is
the processor's time that the calling thread needs to trace and launch kernels, without what it does while it waits.
*Fitted* follows from the times with one thread and with two: T(n) = S + P / n, so S = 2 T(2) - T(1). *Work* is the time
of the processor in all, with one thread. By Amdahl's law `--cores` cores (64) are Work / (S + (Work - S) / cores) times
as fast as one; S is *Python*. Let nothing else run meanwhile: *fitted* needs an idle machine.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import drjit as dr
from mesh_scenes import bumpy_sphere, over_floor, write_bumpy_sphere

from djpt.rendering.schedules import passes

LAYOUT = "{:40} {:>24} {:>10} {:>10} {:>10} {:>12}"


class TimedEvent(passes.Event):  # type: ignore[misc]
    """An event that adds up the processor's time of the calling thread in waits: it works on kernels there."""

    waited = 0.0

    def wait(self) -> None:
        start = time.thread_time()
        super().wait()
        TimedEvent.waited += time.thread_time() - start


def images(folder: Path) -> Iterator[tuple[str, dict[str, Any], int]]:
    """What is measured: name, scene, samples per pixel."""
    for size, rfilter in ((256, "box"), (256, "gaussian"), (1024, "box"), (1024, "gaussian")):
        scene = djpt.cornell_box()
        scene["sensor"]["film"].update(width=size, height=size, rfilter={"type": rfilter})
        yield f"Cornell box, {size} x {size}, {rfilter}", scene, 64
    yield (
        "10^5 triangles, 256 x 256, box",
        over_floor(djpt, bumpy_sphere(write_bumpy_sphere(folder, 100_000), True)),
        64,
    )


def measured(work: Callable[[], Any], runs: int) -> tuple[float, float, float]:
    """Medians in seconds: of a call until its result is there, of all work, and of the calling thread's own work."""
    walls, every, own = [], [], []
    for run in range(runs + 1):
        dr.sync_thread()
        TimedEvent.waited = 0.0
        start, together, used = time.perf_counter(), time.process_time(), time.thread_time()
        result = work()
        used = time.thread_time() - used - TimedEvent.waited
        dr.eval(result)
        dr.sync_thread()
        if run:
            walls.append(time.perf_counter() - start)
            every.append(time.process_time() - together)
            own.append(used)
    return statistics.median(walls), statistics.median(every), statistics.median(own)


def line(name: str, scene: dict[str, Any], spp: int, counts: list[int], runs: int, cores: int) -> str:
    """Measure an image; return a line of the table."""
    loaded, times, work, own = djpt.load_dict(scene), {}, 0.0, 0.0
    for count in reversed(counts):
        dr.set_thread_count(count)
        times[count], work, used = measured(lambda: djpt.render(loaded, spp=spp), runs)
        # A single thread computes kernels while they are launched.
        own = used if count > 1 else own
    fitted = f"{1e3 * max(0.0, 2 * times[2] - times[1]):.0f} ms" if 2 in times else "-"
    faster = work / (own + (work - own) / cores)
    walls = " / ".join(f"{1e3 * times[count]:.0f}" for count in counts)
    numbers = f"{walls} ms", f"{1e3 * work:.0f} ms", f"{1e3 * own:.1f} ms", fitted, f"x {faster:.1f}"
    return LAYOUT.format(f"{name}, {spp} spp", *numbers)


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--runs", type=int, default=5, help="runs of each image (5); medians are printed")
    parser.add_argument("--cores", type=int, default=64, help="cores to predict for (64)")
    arguments = parser.parse_args()
    there, passes.Event = os.cpu_count() or 1, TimedEvent  # type: ignore[misc]
    counts = [2**k for k in range(max(2, there.bit_length()))]
    print(f"{there} processors, load {os.getloadavg()[0]:.1f}\n")
    threads = " / ".join(str(count) for count in counts)
    print(LAYOUT.format("image", f"{threads} threads", "work", "Python", "fitted", f"{arguments.cores} cores"))
    with tempfile.TemporaryDirectory() as folder:
        for name, scene, spp in images(Path(folder)):
            print(line(name, scene, spp, counts, arguments.runs, arguments.cores), flush=True)


if __name__ == "__main__":
    main()

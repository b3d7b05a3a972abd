"""Measurements of two renderers in turns, and their report: shared by the benchmarks of this folder."""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
from history import append, entry

from djpt.apps.benchmarks.measuring import heading, machine, times_in_pairs
from djpt.jit.backends import load_backend
from djpt.jit.llvm.lanes import force_lanes

__all__ = ["Row", "first_image", "in_pairs", "report"]

# For the processes that benchmarks start: as in an installed package, modules are compiled once and not by each.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

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
    parser.add_argument("--history", action="store_true", help="append the ratios to benchmarks/history.jsonl")
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
    print(heading(facts, f"{what} (smallest, largest)"))
    print(LAYOUT.format("what", "required", "aim", "measured", "", "Mitsuba / djpt").rstrip())
    rows = []
    for row in all_rows(pairs, arguments.quick):
        print(line(row), flush=True)
        rows.append(row)
    if arguments.json:
        numbers = [{**asdict(row), "measured": row.measured, "passed": row.passed} for row in rows]
        arguments.json.write_text(json.dumps({"machine": facts, "rows": numbers}, indent=1) + "\n")
    if arguments.history:
        append(entry(Path(sys.argv[0]).stem, facts, [(row.what, row.measured) for row in rows if not row.at_most]))
    return 0 if all(row.passed for row in rows) else 1

"""The history of speed: a line for each run of a benchmark, and the page that shows them.

    python benchmarks/history.py        writes docs/benchmark-history.md anew

`make bench` appends to ``benchmarks/history.jsonl``: machine, versions, the commit, and the ratio of each row. Lines of
one machine can be compared; those of different ones can't.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

__all__ = ["append", "entry", "page"]

ROOT = Path(__file__).resolve().parents[1]
HISTORY = Path(__file__).with_name("history.jsonl")
PAGE = ROOT / "docs" / "benchmark-history.md"

SHOWN = 12
"""The newest runs of a machine that the page shows."""

INTRODUCTION = """# Benchmark history

Mitsuba's time divided by djpt's, run by run, the newest first; above 1, djpt is faster. `make bench` appends a run to
`benchmarks/history.jsonl`, and writes this page. Runs of one machine can be compared, where its load was low: that is
the number of processes that wanted to run when the benchmark began. The sizes of kernels, which no load changes, are
watched by a test; `python -m tests.kit.kernel_sizes` prints them.
"""


def commit() -> str:
    """The commit of the working copy, with a plus sign if files were changed; empty where there is none.

    The history itself doesn't count: each benchmark of `make bench` adds a line to it.
    """

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no", "--", ".", f":!{HISTORY.relative_to(ROOT)}")
    return git("rev-parse", "--short=8", "HEAD") + ("+" if changed else "")


def entry(benchmark: str, facts: dict[str, Any], rows: Iterable[tuple[str, float]]) -> dict[str, Any]:
    """What a run leaves in the history."""
    return {
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d"),
        "commit": commit(),
        "benchmark": benchmark,
        "machine": f"{facts['cpu']}, {facts['vectors']}, {facts['cores']} cores",
        "load": round(facts["load"], 1),
        **{name: facts[name] for name in ("djpt", "mitsuba", "drjit", "llvm")},
        "rows": {what.strip(): round(measured, 3) for what, measured in rows},
    }


def append(run: dict[str, Any], history: Path = HISTORY) -> None:
    """Add a run to the history."""
    with history.open("a", encoding="utf-8") as file:
        file.write(json.dumps(run) + "\n")


def page(runs: Sequence[dict[str, Any]]) -> str:
    """The page: a table for each machine and benchmark, with a column for each run."""
    tables: defaultdict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for run in runs:
        tables[run["machine"], run["benchmark"]].append(run)
    parts = [INTRODUCTION]
    for machine in sorted({machine for machine, _ in tables}):
        parts.append(f"## {machine}\n")
        for (where, benchmark), all_runs in sorted(tables.items()):
            if where == machine:
                parts.append(f"`python benchmarks/{benchmark}.py`\n\n{table(all_runs[::-1][:SHOWN])}")
    return "\n".join(parts)


def table(runs: Sequence[dict[str, Any]]) -> str:
    """Runs as columns, rows of the benchmark as rows."""
    names = list(dict.fromkeys(name for run in runs for name in run["rows"]))
    heads = [f"{run['date']}, djpt {run['djpt']}, `{run['commit']}`, load {run['load']}" for run in runs]
    lines = [["", *heads], ["---"] * (len(runs) + 1)]
    lines += [[name, *(f"{run['rows'][name]:.2f}" if name in run["rows"] else "" for run in runs)] for name in names]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def main() -> int:
    """Write the page."""
    PAGE.write_text(page([json.loads(line) for line in HISTORY.read_text().splitlines()]))
    return 0


if __name__ == "__main__":
    sys.exit(main())

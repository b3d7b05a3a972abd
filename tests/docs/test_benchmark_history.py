"""The history of benchmarks: what a run leaves, and that the page is made of it."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

from tests.kit.processes import ROOT

SCRIPT = ROOT / "benchmarks" / "history.py"

pytestmark = pytest.mark.skipif(not SCRIPT.exists(), reason="not a working copy of the repository")

FACTS = {"cpu": "A", "vectors": "AVX2, 8 lanes", "cores": 2, "load": 0.512, "djpt": "1.0", "mitsuba": "3", "drjit": "1"}


def run_of(date: str, ratio: float, machine: str = "A") -> dict[str, Any]:
    made: dict[str, Any] = runpy.run_path(str(SCRIPT))["entry"](
        "meshes", {**FACTS, "cpu": machine, "llvm": "19.1.7"}, [("  a mesh", ratio)]
    )
    return {**made, "date": date, "commit": "abc"}


def test_a_run_is_appended(tmp_path: Path) -> None:
    names = runpy.run_path(str(SCRIPT))
    history = tmp_path / "history.jsonl"
    for ratio in (1.5, 1.75):
        names["append"](run_of("2026-01-01", ratio), history)
    runs = [json.loads(line) for line in history.read_text().splitlines()]
    assert [run["rows"] for run in runs] == [{"a mesh": 1.5}, {"a mesh": 1.75}]
    assert runs[0]["machine"] == "A, AVX2, 8 lanes, 2 cores" and runs[0]["load"] == 0.5


def test_the_newest_run_comes_first_and_machines_stay_apart() -> None:
    runs = [run_of("2026-01-01", 1.5), run_of("2026-01-03", 3, "B"), run_of("2026-01-02", 1.75)]
    text = runpy.run_path(str(SCRIPT))["page"](runs)
    assert "| a mesh | 1.75 | 1.50 |\n" in text
    assert "| a mesh | 3.00 |\n" in text
    assert text.index("## A,") < text.index("## B,")


def test_the_page_is_that_of_the_history() -> None:
    names = runpy.run_path(str(SCRIPT))
    runs = [json.loads(line) for line in names["HISTORY"].read_text().splitlines()]
    assert names["PAGE"].read_text() == names["page"](runs), "python benchmarks/history.py"

"""Where the pictures go, and the scene that several of them show."""

from __future__ import annotations

import runpy
from pathlib import Path

__all__ = ["IMAGES", "LADDER", "ROOT"]

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"

LADDER = runpy.run_path(str(ROOT / "benchmarks" / "ladder.py"))
"""The names of the benchmark of integrators: ``room``, a Cornell box with three shiny balls, and ``STEPS``."""

"""``python -m djpt.benchmarks SCENE...``: djpt against Mitsuba on this machine, as ``djpt benchmarks``."""

from __future__ import annotations

import sys

from djpt.apps.cli.main import run

if __name__ == "__main__":
    sys.argv.insert(1, "benchmarks")
    run()

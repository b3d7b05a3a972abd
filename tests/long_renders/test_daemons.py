"""The end of a process while a daemon thread renders: no abort, no message, and no waiting for threads that wait."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

SCRIPT = """
import queue, sys, threading, time
import numpy as np
import djpt

description = djpt.cornell_box()
description["sensor"]["film"].update(width=64, height=64)
scene = djpt.load_dict(description)
begun = threading.Event()

def forever():
    while True:
        {work}
        begun.set()

threading.Thread(target=forever, daemon=True).start()
begun.wait()
time.sleep({seconds})
sys.exit(3)
"""

WORK = {
    "render": "djpt.render(scene, spp=64)",
    "numpy": "np.array(djpt.render(scene, spp=256))",
    "rounds": "list(djpt.render_passes(scene, spp=512))",
    "to_file": "djpt.render_to_file(scene, 'a.exr', spp=64)",
}


def ended(work: str, seconds: float, folder: Path) -> tuple[int, str, str]:
    """How a process ends `seconds` after its daemon thread has rendered first: its exit code and what it prints."""
    script = folder / "script.py"
    script.write_text(SCRIPT.format(work=work, seconds=seconds))
    done = subprocess.run(
        [sys.executable, script.name], capture_output=True, text=True, check=False, timeout=300, cwd=folder
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.sparse(4)
@pytest.mark.parametrize("name", WORK)
@pytest.mark.slow
def test_a_process_ends_while_a_daemon_thread_renders(name: str, tmp_path: Path) -> None:
    for seconds in (0.0, 0.05, 0.2):
        assert ended(WORK[name], seconds, tmp_path) == (3, "", "")


@pytest.mark.parametrize("wait", ["queue.Queue().get()", "time.sleep(1000)"])
@pytest.mark.sparse(2)
def test_nobody_waits_for_a_thread_that_waits(wait: str, tmp_path: Path) -> None:
    before = time.perf_counter()
    work = f"np.array(djpt.render(scene, spp=1)); begun.set(); {wait}"
    assert ended(work, 0.0, tmp_path) == (3, "", "")
    assert time.perf_counter() - before < 100

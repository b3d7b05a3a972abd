"""No kernel grows without a word: its operations are those of a table, which a commit has to change."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import drjit as dr
import pytest

import djpt
from tests.kit.kernel_sizes import COMMAND, TABLE, verdict
from tests.kit.processes import ROOT


@pytest.mark.skipif(dr.backend_v(djpt.Float) != dr.JitBackend.LLVM, reason="kernels of processors")
def test_kernels_have_the_size_of_the_table() -> None:
    """In a process of its own, for eight lanes and without what other tests have recorded."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.kit.kernel_sizes"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        cwd=ROOT,
        env={**os.environ, "DJPT_TEST_QUICK": "1"},
    )
    assert done.returncode == 0, done.stderr
    changed = verdict(json.loads(done.stdout.splitlines()[-1]), json.loads(TABLE.read_text()))
    assert not changed, "\n".join([*changed, f"If that is intended: {COMMAND}, and say why in the commit"])


def test_three_per_cent_pass() -> None:
    assert verdict({"a": 1030, "b": 97}, {"a": 1000, "b": 100}) == []
    assert verdict({"a": 1031}, {"a": 1000}) == ["a: 1000 -> 1031 (+3.1%)"]
    assert verdict({"a": 969}, {"a": 1000}) == ["a: 1000 -> 969 (-3.1%)"]
    assert verdict({"a": 1}, {"b": 1}) == ["a: not in the table", "b: in the table alone"]

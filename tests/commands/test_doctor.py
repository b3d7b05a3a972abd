"""`djpt doctor`: says what was found, what was chosen, why, and what to do; never dies."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

import djpt
from djpt.apps.cli import doctor
from djpt.apps.cli.doctor import Finding, Report, examine, print_report
from tests.kit.processes import old_llvm, run_python

DOCTOR = "import sys; from djpt.apps.cli.doctor import main; sys.exit(main())"


@pytest.mark.slow
def test_this_machine() -> None:
    report = examine()
    assert report.usable
    assert djpt.__version__ in report["djpt"].found
    assert report["drjit"].verdict == report["LLVM"].verdict == report["Trial"].verdict == "ok"
    assert "LLVM" in report["Trial"].found or "cuda" in report["Variant"].found
    with pytest.raises(KeyError):
        report["nothing"]


WIDTH = """
import re
from djpt.jit.types import Float
import drjit as dr
with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
    dr.eval(dr.arange(Float, 8) + 1)
    code = dr.kernel_history()[-1]["ir"].getvalue()
name = next(name for name, text in (("AVX-512", "+avx512f"), ("AVX2", "+avx2"), ("NEON", "+neon")) if text in code)
print(re.search(r"<(\\d+) x float>", code)[1], name)
"""


@pytest.mark.skipif(djpt.variant() != "llvm_ad_rgb", reason="lanes are LLVM's")
@pytest.mark.slow
def test_it_names_the_width_of_kernels() -> None:
    """That of the code that Dr.Jit hands to LLVM."""
    done = run_python("-c", WIDTH)
    width, name = done.stdout.split()
    assert f", {width} lanes ({name}), " in examine()["Trial"].found


@pytest.mark.slow
def test_it_works_from_another_folder(tmp_path: Path) -> None:
    done = run_python("-c", DOCTOR, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("djpt can render on this machine.\n")


def test_without_llvm(tmp_path: Path) -> None:
    done = run_python("-c", DOCTOR, folders=tmp_path)
    assert done.returncode == 3
    assert done.stderr == ""
    assert "!!  LLVM       no usable library" in done.stdout
    assert "No libLLVM was found" in done.stdout
    assert done.stdout.count("apt-get install -y libllvm19") == 1, "the same advice twice"
    assert done.stdout.endswith("djpt can't render on this machine yet: see the lines marked !!\n")


@pytest.mark.parametrize("version", [14, 15, 16])
@pytest.mark.sparse(3)
def test_with_an_old_llvm(tmp_path: Path, version: int) -> None:
    library = old_llvm(tmp_path, version)
    done = run_python("-c", DOCTOR, folders=tmp_path)
    assert (done.returncode, done.stderr) == (3, "")
    assert f"LLVM {version}: too old, 17 is needed" in done.stdout
    done = run_python("-c", DOCTOR, library=library)
    assert (done.returncode, done.stderr) == (3, "")
    assert "DRJIT_LIBLLVM_PATH is set to a library that" in done.stdout


@pytest.mark.slow
def test_it_says_why(tmp_path: Path) -> None:
    chosen = run_python("-c", "import os, djpt; print(os.environ['DRJIT_LIBLLVM_PATH'])").stdout.strip()
    assert "DRJIT_LIBLLVM_PATH asks for it" in run_python("-c", DOCTOR, library=chosen).stdout
    (tmp_path / "libLLVM-18.so").symlink_to(chosen)
    old_llvm(tmp_path, 15)
    text = run_python("-c", DOCTOR, folders=tmp_path).stdout
    assert f"the best one in DJPT_LLVM_DIRS={tmp_path}; passed over:" in text
    assert "LLVM 15: too old" in text


def test_an_unknown_variant() -> None:
    done = run_python("-c", DOCTOR, variant="scalar_rgb")
    assert (done.returncode, done.stderr) == (3, "")
    assert "unknown variant 'scalar_rgb'" in done.stdout


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("import os; os.abort()", "ended with signal SIGABRT"),
        ("import sys; sys.exit(7)", "ended with exit status 7"),
        ('print(\'{"total": 3, "threads": 2, "llvm": "19"}\')', "computed 3, not 20"),
    ],
)
def test_a_trial_that_dies_is_a_finding(monkeypatch: pytest.MonkeyPatch, code: str, found: str) -> None:
    monkeypatch.setattr(doctor, "_TRIAL", code)
    report = examine()
    assert not report.usable
    assert report["Trial"].verdict == "problem"
    assert found in report["Trial"].found


def test_missing_packages_and_libatomic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "libatomic_missing", lambda: True)
    assert "apt-get install -y libatomic1" in examine()["libatomic"].advice
    assert doctor._package("djpt-no-such-package", "needed").verdict == "problem"
    assert doctor._package("djpt-no-such-package", "only for this test").verdict == "note"


def test_the_report_keeps_text_as_it_is() -> None:
    """No markup: a path may contain brackets."""
    report = Report((Finding("LLVM", "/opt/[red]/libLLVM.so", "note", "first\nsecond"),), usable=False)
    stream = io.StringIO()
    print_report(report, Console(file=stream, soft_wrap=True, highlight=False))
    lines = stream.getvalue().splitlines()
    assert lines[0] == "--  LLVM  /opt/[red]/libLLVM.so"
    assert [line.strip() for line in lines[1:3]] == ["first", "second"]

"""Python processes on pretended machines: each sees only the LLVM libraries that a test gives it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

__all__ = ["ROOT", "compile_library", "old_llvm", "run_python"]

ROOT = Path(__file__).resolve().parents[2]
DECIDING = ("DRJIT_LIBLLVM_PATH", "DJPT_LLVM_DIRS", "DJPT_LLVM_CHOSEN", "DJPT_VARIANT", "PYTHONPATH")


def run_python(
    *arguments: str,
    folders: Path | str | None = None,
    library: Path | str | None = None,
    variant: str | None = None,
    cwd: Path | str = ROOT,
    timeout: float = 120,
) -> subprocess.CompletedProcess[str]:
    """``python *arguments`` with the given LLVM folders, user-set library and variant, nothing inherited."""
    environment = {key: value for key, value in os.environ.items() if key not in DECIDING}
    if folders is not None:
        environment["DJPT_LLVM_DIRS"] = str(folders)
    if library is not None:
        environment["DRJIT_LIBLLVM_PATH"] = str(library)
    if variant is not None:
        environment["DJPT_VARIANT"] = variant
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
        env=environment,
        cwd=cwd,
    )


def old_llvm(folder: Path, version: int) -> Path:
    """A library that calls itself LLVM `version`.

    The real one where this machine has it, so that a test that lets it through would see
    the process die; else a text file, which is rejected by its name before it is opened.
    """
    folder.mkdir(exist_ok=True)
    target = folder / f"libLLVM-{version}.so.1"
    for real in (Path("/usr/lib/x86_64-linux-gnu") / target.name, Path(f"/usr/lib/llvm-{version}/lib/{target.name}")):
        if real.exists():
            target.symlink_to(real)
            return target
    target.write_text("not a library\n")
    return target


def compile_library(target: Path, source: str) -> bool:
    """Compile a C file to a shared library; False if this machine has no compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return False
    path = target.with_suffix(".c")
    path.write_text(source)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", str(target), str(path)], check=True)
    return True

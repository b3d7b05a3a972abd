"""The folder of a private LLVM, and the steps in which sources fill it."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from djpt.errors import BackendError
from djpt.jit.llvm.finder import private_folders

__all__ = ["output_of", "private_folder", "put"]

PATIENCE = 300.0
"""Seconds after which a command is given up."""


def private_folder() -> Path:
    """The first of the private folders that can be written to, created if needed.

    Raises:
        BackendError: None of them can be written to.
    """
    for folder in map(Path, private_folders()):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    raise BackendError(f"can't write to any of {', '.join(private_folders())}")


def output_of(command: Sequence[str], what: str, folder: Path | None = None) -> str:
    """Run a command in a folder and return what it prints.

    Raises:
        BackendError: The command can't be run, fails or takes longer than `PATIENCE`: with the last lines it printed.
    """
    environment = {**os.environ, "LC_ALL": "C"}
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            check=False,
            cwd=folder,
            env=environment,
            timeout=PATIENCE,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BackendError(f"can't {what}: {error}") from error
    if done.returncode:
        last = "\n".join(f"    {line}" for line in done.stdout.strip().splitlines()[-3:])
        raise BackendError(f"can't {what}: {' '.join(command[:1])} said\n{last}")
    return done.stdout


def put(source: Path, target: Path) -> None:
    """Copy a file to its place in one step, so that an interrupted installation leaves no incomplete library.

    A symbolic link stays one.
    """
    partial = target.with_name(f".{target.name}.partial")
    partial.unlink(missing_ok=True)
    shutil.copyfile(source, partial, follow_symlinks=False)
    if not partial.is_symlink():
        partial.chmod(0o755)
    partial.replace(target)

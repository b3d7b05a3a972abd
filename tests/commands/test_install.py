"""The package as it is installed, and every entry point on a machine without LLVM."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.kit.processes import ROOT, old_llvm, run_python

ROOT_FOLDERS = ("integrators", "materials", "scenes", "validation")

# -------------------------- Layout --------------------------


@pytest.mark.parametrize("name", ROOT_FOLDERS)
def test_root_folders_are_subpackages_and_nothing_else(name: str) -> None:
    if not (ROOT / "djpt" / name).is_symlink():
        pytest.skip("not a working copy of the repository")
    assert (ROOT / "djpt" / name).resolve() == ROOT / name
    done = run_python("-c", f"import {name}")
    assert done.returncode == 1
    assert f"ImportError: '{name}' is part of djpt: import djpt.{name} instead" in done.stderr


def contents(names: Sequence[str]) -> set[str]:
    return {name for name in names if name.endswith((".py", ".typed"))}


def build(source: Path, target: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(target)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_wheel_and_source_archive(tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    build(ROOT, tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    (archive,) = tmp_path.glob("*.tar.gz")
    modules = contents(zipfile.ZipFile(wheel).namelist())
    here = {str(p.relative_to(ROOT)) for p in (ROOT / "djpt").rglob("*.py")}
    here |= {f"djpt/{p.relative_to(ROOT)}" for name in ROOT_FOLDERS for p in (ROOT / name).rglob("*.py")}
    assert modules == here | {"djpt/py.typed", "pytest_djpt.py"}

    # A wheel that is built from the source archive has the same contents.
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path / "source")
    (source,) = (tmp_path / "source").iterdir()
    build(source, tmp_path / "again")
    assert contents(zipfile.ZipFile(next((tmp_path / "again").glob("*.whl"))).namelist()) == modules

    # And it runs from where no repository is.
    with zipfile.ZipFile(wheel) as files:
        files.extractall(tmp_path / "site")
    path = str(tmp_path / "site")
    code = f"import sys; sys.path.insert(0, {path!r}); import djpt; djpt.cornell_box(); print(djpt.__file__)"
    done = run_python("-c", code, cwd=tmp_path)
    assert done.stdout.startswith(path), done.stderr


# ---------------- Entry points without LLVM -----------------

ENTRIES = [
    ("-m", "djpt", "render", "cornell_box", "-o", "{folder}/out.exr", "--spp", "1"),
    ("-m", "djpt", "doctor"),
    ("-c", "import sys; from djpt.apps.cli.main import main; sys.argv[1:] = ['doctor']; sys.exit(main())"),
]


@pytest.mark.sparse(16)
@pytest.mark.parametrize("arguments", ENTRIES, ids=lambda a: " ".join(a[:3])[:24])
@pytest.mark.parametrize("version", [None, 14, 15, 16])
def test_the_command_line_without_a_usable_llvm(
    tmp_path: Path, arguments: tuple[str, ...], version: int | None
) -> None:
    machines = [{"folders": tmp_path}]
    if version:
        machines.append({"library": old_llvm(tmp_path, version)})
    for machine in machines:
        done = run_python(*(a.format(folder=tmp_path) for a in arguments), **machine)
        text = done.stdout + done.stderr
        assert done.returncode == 3, text
        assert "version 17 or newer" in text or "DRJIT_LIBLLVM_PATH is set to a library" in text
        assert "Traceback" not in text
        assert not (tmp_path / "out.exr").exists()


def test_commands_that_need_no_llvm(tmp_path: Path) -> None:
    done = run_python("-m", "djpt", "--help", folders=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "doctor" in done.stdout

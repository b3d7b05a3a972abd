"""The package as it is installed, the private LLVM, and every entry point on a machine without LLVM."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from djpt.errors import BackendError
from djpt.jit.llvm import installer
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


@pytest.mark.sparse(4)
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


# ---------------------- Private LLVM ------------------------


def test_nothing_is_installed_if_llvm_is_there() -> None:
    done = run_python("-m", "djpt.jit.llvm", "--if-needed")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("djpt: the CPU backend works, with ")
    assert done.stdout.count("\n") == 1


@pytest.mark.parametrize("version", [14, 15, 16])
def test_a_users_own_choice_is_not_overruled(tmp_path: Path, version: int) -> None:
    done = run_python("-m", "djpt.jit.llvm", "--if-needed", library=old_llvm(tmp_path, version))
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("djpt: DRJIT_LIBLLVM_PATH is set to a library that the CPU backend")


@pytest.fixture
def private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "private"
    monkeypatch.setattr(installer, "private_folders", lambda: [str(folder)])
    monkeypatch.setattr(installer.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(installer.sys, "platform", "linux")
    return folder


def fake_wheel(command: Sequence[str], what: str) -> None:
    """Stand in for ``pip download``."""
    target = Path(command[command.index("--dest") + 1]) / "lavavu_osmesa-1.9.10-cp312-cp312-linux_x86_64.whl"
    with zipfile.ZipFile(target, "w") as archive:
        for name in ("libLLVM-17-0.so", "libffi-0.so.6", "libtinfo-0.so.6", "libOSMesa-0.so"):
            archive.writestr(f"lavavu_osmesa.libs/{name}", name)
        archive.writestr("lavavu/__init__.py", "")


def test_only_the_needed_files_are_kept(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installer, "_run", fake_wheel)
    monkeypatch.setattr(installer, "_sha256", lambda path: installer.WHEEL_SHA256)
    assert installer.install_llvm() == private
    kept = {path.name: path.read_text() for path in private.iterdir()}
    assert kept == {name: name for name in ("libLLVM-17-0.so", "libffi-0.so.6", "libtinfo-0.so.6")}


def test_a_changed_wheel_is_refused(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installer, "_run", fake_wheel)
    with pytest.raises(BackendError, match=r"its SHA-256 differs\); it was discarded"):
        installer.install_llvm()
    assert list(private.iterdir()) == []


def test_no_network(private: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(private.parent))
    with pytest.raises(BackendError, match=r"can't download lavavu-osmesa==1.9.10 from the package index"):
        installer.install_llvm()
    assert list(private.iterdir()) == []
    assert "Traceback" not in capfd.readouterr().err


def test_other_platforms_get_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installer.platform, "machine", lambda: "riscv64")
    with pytest.raises(BackendError, match=r"there is no private LLVM for .* on riscv64"):
        installer.install_llvm()


def test_no_folder_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(installer, "private_folders", lambda: [str(tmp_path / "file" / "llvm")])
    with pytest.raises(BackendError, match="can't write to any of"):
        installer._private_folder()


def test_libatomic_without_apt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installer.shutil, "which", lambda name: None)
    with pytest.raises(BackendError, match="no apt-get"):
        installer.install_libatomic()


def test_libatomic_is_looked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def closed(name: str) -> None:
        raise OSError("cannot open shared object file")

    monkeypatch.setattr(installer, "private_folders", lambda: [str(tmp_path)])
    monkeypatch.setattr(installer.sys, "platform", "linux")
    monkeypatch.setattr(installer.ctypes, "CDLL", closed)
    assert installer.libatomic_missing()
    monkeypatch.setattr(installer.sys, "platform", "darwin")
    assert not installer.libatomic_missing()

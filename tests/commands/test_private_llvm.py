"""LLVM is fetched where a machine has none, from the first source that has it, and never where that is forbidden."""

from __future__ import annotations

import os
import shutil
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from djpt.apps.cli import console
from djpt.errors import BackendError
from djpt.jit.llvm import debian, finder, installer, private_copy, wheel
from djpt.jit.llvm.finder import Candidate, Search
from tests.kit.processes import compile_library, old_llvm, run_python

NOTHING = Search(None)
FOUND = Search(Candidate("/somewhere/libLLVM.so.19.1", 19))

Say = Callable[[str], None]


@pytest.fixture
def private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The private folder, on a pretended Linux on x86-64."""
    folder = tmp_path / "private"
    folder.mkdir()
    monkeypatch.setattr(private_copy, "private_folders", lambda: [str(folder)])
    monkeypatch.setattr(wheel.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(wheel.sys, "platform", "linux")
    return folder


def say_nothing(line: str) -> None:
    pass


# ---- when it is fetched ------------------------------------------------------------------------------


class Machine:
    """A pretended machine: what was tried on it, and which sources work there."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, works: Sequence[str], found: Search = NOTHING) -> None:
        self.tried: list[str] = []
        self.found = found
        self._works = works

        def prepared() -> Search:
            return self.found

        prepared.cache_clear = lambda: None  # type: ignore[attr-defined]
        monkeypatch.setattr(installer, "prepare", prepared)
        monkeypatch.setattr(installer, "search", prepared)
        monkeypatch.setattr(installer, "libatomic_missing", lambda: False)
        monkeypatch.setattr(installer, "SOURCES", {name: self._source(name) for name in installer.SOURCES})
        monkeypatch.delitem(installer.sys.modules, "drjit", raising=False)
        for name in (installer.SOURCES_VARIABLE, "DJPT_VARIANT"):
            monkeypatch.delenv(name, raising=False)

    def _source(self, name: str) -> Callable[[Path, Say], None]:
        def fetch(folder: Path, say: Say) -> None:
            self.tried.append(name)
            if name not in self._works:
                raise BackendError(f"no {name} here")
            self.found = FOUND

        return fetch


@pytest.mark.parametrize(
    ("works", "asked", "tried"),
    [
        (("debian", "wheel"), None, ["debian"]),
        (("wheel",), None, ["debian", "wheel"]),
        (("debian", "wheel"), "wheel", ["wheel"]),
        (("debian", "wheel"), "wheel, debian", ["wheel"]),
        (("debian", "wheel"), "none", []),
        (("debian", "wheel"), "debian,none", []),
    ],
)
def test_sources_are_tried_in_order(
    works: Sequence[str], asked: str | None, tried: list[str], private: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = Machine(monkeypatch, works)
    if asked is not None:
        monkeypatch.setenv(installer.SOURCES_VARIABLE, asked)
    installer.provide()
    assert machine.tried == tried
    assert machine.found is (FOUND if tried else NOTHING)


@pytest.mark.parametrize(
    "found",
    [
        FOUND,
        Search(None, from_user=True),
        Search(None, folders=("/opt/llvm",)),
        Search(None, too_late=True),
    ],
    ids=["there", "the user's library", "the user's folders", "too late"],
)
def test_nothing_is_fetched(found: Search, private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(monkeypatch, tuple(installer.SOURCES), found)
    installer.provide()
    assert machine.tried == []


def test_all_sources_fail(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As without a network: each reason, then what can be done."""
    machine = Machine(monkeypatch, ())
    with pytest.raises(BackendError) as raised:
        installer.provide()
    assert machine.tried == ["debian", "wheel"]
    lines = str(raised.value).splitlines()
    assert lines[:3] == ["LLVM can't be fetched:", "    debian: no debian here", "    wheel: no wheel here"]
    assert any("apt-get install -y libllvm19" in line for line in lines)
    assert lines[-1].startswith("or set DRJIT_LIBLLVM_PATH")


def test_a_library_that_cant_be_opened_isnt_taken(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Machine(monkeypatch, ("debian", "wheel"))
    monkeypatch.setattr(installer, "search", lambda: NOTHING)
    with pytest.raises(BackendError, match=r"debian: its library can't be opened(.|\n)*wheel: its library can't"):
        installer.provide()


def test_unknown_sources(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Machine(monkeypatch, ())
    monkeypatch.setenv(installer.SOURCES_VARIABLE, "debain")
    with pytest.raises(BackendError, match="DJPT_LLVM_SOURCES: unknown source 'debain'; did you mean 'debian'"):
        installer.provide()


def test_libatomic_is_fetched_where_it_is_missing(
    private: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Machine(monkeypatch, (), FOUND)
    folders: list[Path] = []
    monkeypatch.setattr(installer, "libatomic_missing", lambda: not folders)
    monkeypatch.setattr(installer.debian, "fetch_libatomic", lambda folder, say: folders.append(folder))
    installer.provide()
    assert folders == [private]
    assert "libatomic.so.1" in capsys.readouterr().err


@pytest.mark.parametrize(("renders", "variant", "calls"), [(True, "", 1), (False, "", 0), (True, "cuda_ad_rgb", 0)])
def test_commands_that_render_fetch(renders: bool, variant: str, calls: int, monkeypatch: pytest.MonkeyPatch) -> None:
    provided: list[int] = []
    monkeypatch.setattr(console, "prepare", lambda: NOTHING)
    monkeypatch.setattr(installer, "provide", lambda: provided.append(1))
    monkeypatch.setenv("DJPT_VARIANT", variant)
    command = click.command("trial", cls=console.Command, renders=renders)(lambda: click.echo("runs"))
    result = CliRunner().invoke(command)
    assert (result.output, len(provided)) == ("runs\n", calls)


# ---- the wheel ---------------------------------------------------------------------------------------


def fake_wheel(command: Sequence[str], what: str) -> str:
    """Stand in for ``pip download``."""
    target = Path(command[command.index("--dest") + 1]) / "lavavu_osmesa-1.9.10-cp312-cp312-linux_x86_64.whl"
    with zipfile.ZipFile(target, "w") as archive:
        for name in ("libLLVM-17-0.so", "libffi-0.so.6", "libtinfo-0.so.6", "libOSMesa-0.so"):
            archive.writestr(f"lavavu_osmesa.libs/{name}", name)
        archive.writestr("lavavu/__init__.py", "")
    return ""


def test_only_the_needed_files_are_kept(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(wheel, "output_of", fake_wheel)
    monkeypatch.setattr(wheel, "sha256", lambda path: wheel.SHA256)
    wheel.fetch(private, said.append)
    kept = {path.name: path.read_text() for path in private.iterdir()}
    assert kept == {name: name for name in ("libLLVM-17-0.so", "libffi-0.so.6", "libtinfo-0.so.6")}
    assert len(said) == 1 and "84 MB" in said[0] and wheel.SHA256 in said[0]


def test_a_changed_wheel_is_refused(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wheel, "output_of", fake_wheel)
    with pytest.raises(BackendError, match=r"its SHA-256 differs\); it was discarded"):
        wheel.fetch(private, say_nothing)
    assert list(private.iterdir()) == []


def test_no_network(private: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(private.parent))
    with pytest.raises(BackendError, match=r"can't download lavavu-osmesa==1.9.10 from the package index"):
        wheel.fetch(private, say_nothing)
    assert list(private.iterdir()) == []
    assert "Traceback" not in capfd.readouterr().err


def test_the_wheel_on_other_machines(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wheel.platform, "machine", lambda: "riscv64")
    with pytest.raises(BackendError, match=r"the wheel is for Linux on x86_64, not for linux on riscv64"):
        wheel.fetch(private, say_nothing)


# ---- the distribution's package ----------------------------------------------------------------------

APT = r"""#!/bin/sh
# Stands in for apt-get, apt-cache and dpkg-deb.
echo "$(basename "$0") $*" >> "$MIRROR/calls"
case "$(basename "$0") $*" in
*" update") [ -e "$MIRROR/offline" ] && { echo "E: Temporary failure resolving"; exit 100; } ;;
*" policy "*) cat "$MIRROR/policy" ;;
*" --print-uris --no-install-recommends install "*) cat "$MIRROR/install" ;;
*" --print-uris download "*) cat "$MIRROR/download" ;;
*" download "*) cp "$MIRROR"/*.deb . ;;
"dpkg-deb "*) mkdir -p "$3"; cp -a "$MIRROR/contents/." "$3" ;;
esac
exit 0
"""

POLICY = """libllvm20:
  Installed: (none)
  Candidate: (none)
libllvm19:
  Installed: (none)
  Candidate: 1:19.1.7-3
libllvm18:
  Installed: (none)
  Candidate: 1:18.1.8-1
"""

CHECKSUM = "ab" * 32


@pytest.fixture
def mirror(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A distribution with libllvm19, which needs a libz3 that the system lacks."""
    folder, tools = tmp_path / "mirror", tmp_path / "tools"
    libraries = folder / "contents" / "usr" / "lib" / "x86_64-linux-gnu"
    libraries.mkdir(parents=True)
    (folder / "contents" / "usr" / "lib" / "llvm-19" / "lib").mkdir(parents=True)
    (folder / "contents" / "usr" / "lib" / "llvm-19" / "lib" / "libLLVM.so.1").symlink_to(
        "../../x86_64-linux-gnu/libLLVM.so.19.1"
    )
    (libraries / "libLLVM.so.19.1").write_text("LLVM")
    (libraries / "libLLVM-19.so.1").symlink_to("libLLVM.so.19.1")
    (libraries / "libz3.so.4").write_text("z3")
    (libraries / "libz3.a").write_text("for compilers")
    (folder / "libllvm19_1%3a19.1.7-3_amd64.deb").write_text("a package")
    (folder / "policy").write_text(POLICY)
    files = {"libllvm19": "libllvm19_1%3a19.1.7-3_amd64.deb", "libz3-4": "libz3-4_4.8-1_amd64.deb"}
    lines = [f"'http://mirror.example/pool/{file}' {file} 25000000" for file in files.values()]
    (folder / "install").write_text("".join(f"{line} MD5Sum:{'0' * 32}\n" for line in lines))
    (folder / "download").write_text("".join(f"{line} SHA256:{CHECKSUM}\n" for line in lines))
    tools.mkdir()
    for name in ("apt-get", "apt-cache", "dpkg-deb"):
        (tools / name).write_text(APT)
        (tools / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tools}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("MIRROR", str(folder))
    return folder


def test_libraries_of_the_packages_are_kept(private: Path, mirror: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(debian, "libatomic_missing", lambda: True)
    debian.fetch(private, said.append)
    assert {path.name for path in private.iterdir()} == {"libLLVM.so.19.1", "libLLVM-19.so.1", "libz3.so.4"}
    assert (private / "libLLVM-19.so.1").read_text() == "LLVM"
    assert said == [
        f"libllvm19 1:19.1.7-3 from mirror.example, 25.0 MB, SHA-256 {CHECKSUM}",
        f"libz3-4 4.8-1 from mirror.example, 25.0 MB, SHA-256 {CHECKSUM}",
    ]
    calls = (mirror / "calls").read_text()
    assert " install libllvm19 libatomic1\n" in calls and " download libllvm19=1:19.1.7-3 libz3-4=4.8-1\n" in calls


def test_a_distribution_without_a_usable_llvm(private: Path, mirror: Path) -> None:
    """As Ubuntu 22.04, where LLVM 15 is the newest."""
    (mirror / "policy").write_text("")
    with pytest.raises(BackendError, match=r"the distribution has none of libllvm19, .*libllvm17"):
        debian.fetch(private, say_nothing)
    assert list(private.iterdir()) == []


def test_a_distribution_out_of_reach(private: Path, mirror: Path) -> None:
    (mirror / "offline").touch()
    with pytest.raises(BackendError, match=r"can't read the distribution's package lists: apt-get said\n.*resolving"):
        debian.fetch(private, say_nothing)
    assert list(private.iterdir()) == []


def test_the_c_library_is_never_mixed(private: Path, mirror: Path) -> None:
    line = "'http://mirror.example/libc6_2.41_amd64.deb' libc6_2.41_amd64.deb 2800000"
    for name, checksum in (("install", f"MD5Sum:{'0' * 32}"), ("download", f"SHA256:{CHECKSUM}")):
        (mirror / name).write_text(f"{(mirror / name).read_text()}{line} {checksum}\n")
    with pytest.raises(BackendError, match="libllvm19 needs another libc6 than the system's"):
        debian.fetch(private, say_nothing)
    assert list(private.iterdir()) == []


def test_without_apt(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(debian.shutil, "which", lambda name: None)
    with pytest.raises(BackendError, match="this system has no apt-get"):
        debian.fetch_libatomic(private, say_nothing)


# ---- the command -------------------------------------------------------------------------------------


def test_nothing_is_installed_if_llvm_is_there() -> None:
    done = run_python("-m", "djpt.jit.llvm", "--if-needed")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("djpt: the CPU backend works, with ")
    assert done.stdout.count("\n") == 1


@pytest.mark.parametrize("version", [14, 15, 16])
@pytest.mark.sparse(2)
def test_a_users_own_choice_is_not_overruled(tmp_path: Path, version: int) -> None:
    done = run_python("-m", "djpt.jit.llvm", "--if-needed", library=old_llvm(tmp_path, version))
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("djpt: DRJIT_LIBLLVM_PATH is set to a library that the CPU backend")


def test_no_folder_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(private_copy, "private_folders", lambda: [str(tmp_path / "file" / "llvm")])
    with pytest.raises(BackendError, match="can't write to any of"):
        private_copy.private_folder()


def test_libatomic_is_looked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def closed(name: str) -> None:
        raise OSError("cannot open shared object file")

    monkeypatch.setattr(finder, "private_folders", lambda: [str(tmp_path)])
    monkeypatch.setattr(finder.sys, "platform", "linux")
    monkeypatch.setattr(finder.ctypes, "CDLL", closed)
    assert finder.libatomic_missing()
    monkeypatch.setattr(finder.sys, "platform", "darwin")
    assert not finder.libatomic_missing()


def test_a_private_library_opens_with_its_neighbours(private: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The libraries of a private folder depend on others that only this folder has."""
    if not (shutil.which("gcc") and compile_library(private / "libdjpttrial.so.4", "int djpt_trial(void) {return 1;}")):
        pytest.skip("no compiler")
    source = private / "LLVM.c"
    source.write_text("int djpt_trial(void); int djpt_outer(void) {return djpt_trial();}")
    path = private / "libLLVM.so.19.1"
    command = ["gcc", "-shared", "-fPIC", "-o", str(path), str(source), str(private / "libdjpttrial.so.4")]
    private_copy.output_of(command, "compile a trial")
    monkeypatch.setattr(finder, "private_folders", lambda: [str(private)])
    library, problem = finder._open(str(path))
    assert problem == "" and library is not None and library.djpt_outer() == 1

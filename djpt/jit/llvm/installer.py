"""The installation of a private libLLVM in this Python environment, without root: ``python -m djpt.jit.llvm``.

For Linux on x86-64 where the system has no usable LLVM (a bare image, Ubuntu 22.04). PyPI
has no package of libLLVM, but one wheel bundles AlmaLinux' build of LLVM 17 with all of its
C interface; three of its files are kept. It is pinned and its checksum verified. The second
thing a bare image lacks, libatomic.so.1, comes from the distribution's own package.
"""

from __future__ import annotations

import argparse
import ctypes
import glob
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

from djpt.errors import BackendError
from djpt.jit.llvm.finder import prepare, private_folders, search

__all__ = ["install_libatomic", "install_llvm", "libatomic_missing", "main"]

WHEEL = "lavavu-osmesa==1.9.10"
WHEEL_SHA256 = "9c39696ae876dbbcaf2bfce52533a8bd59dd891d3f97925944e1a5c9ff82bf37"
WHEEL_TAGS = ("--platform=manylinux_2_28_x86_64", "--python-version=3.12", "--implementation=cp", "--abi=cp312")
KEPT = ("libffi-", "libtinfo-", "libLLVM-")
"""The files of the wheel that are kept, in the order of writing: the library last, when it can be opened."""

_TRY_BACKEND = """
import sys
import djpt
from djpt.errors import BackendError
from djpt.jit.backends import load_backend
try:
    backend = load_backend()
except BackendError as error:
    sys.exit(str(error))
import drjit
if drjit.minimum(backend.Float(1, 2), 1.5)[1] != 1.5:
    sys.exit("the CPU backend of Dr.Jit computes wrong results")
"""


def _private_folder() -> Path:
    """The first of the private folders that can be written to, created if needed."""
    for folder in map(Path, private_folders()):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    raise BackendError(f"can't write to any of {', '.join(private_folders())}")


def _run(command: Sequence[str], what: str) -> None:
    """Run a command; if it fails, raise with the last lines that it printed."""
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    except OSError as error:
        raise BackendError(f"can't {what}: {error}") from error
    if done.returncode:
        last = "\n".join(f"    {line}" for line in done.stdout.strip().splitlines()[-5:])
        raise BackendError(f"can't {what}: {' '.join(command[:4])} .. said\n{last}")


def _put(source: Path, target: Path) -> None:
    """Copy a file to its place in one step, so that an interrupted installation leaves no incomplete library."""
    partial = target.with_name(f".{target.name}.partial")
    shutil.copyfile(source, partial)
    partial.chmod(0o755)
    partial.replace(target)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def install_llvm() -> Path:
    """Download the wheel and keep its libLLVM; return the folder.

    Raises:
        BackendError: not Linux on x86-64, no network, no space, or a wheel with another checksum.
    """
    if (sys.platform, platform.machine()) != ("linux", "x86_64"):
        raise BackendError(f"there is no private LLVM for {sys.platform} on {platform.machine()}")
    folder = _private_folder()
    print(f"djpt: fetching a private LLVM 17 into {folder} (84 MB to download, 121 MB on disk)", flush=True)
    # Beside the target, since /tmp may be small, or on another disk.
    with tempfile.TemporaryDirectory(dir=folder) as name:
        temporary = Path(name)
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
        options = ["--quiet", "--no-deps", "--only-binary=:all:", "--dest", name, *WHEEL_TAGS]
        _run([*pip, "download", *options, WHEEL], f"download {WHEEL} from the package index")
        wheel = next(temporary.glob("*.whl"))
        if _sha256(wheel) != WHEEL_SHA256:
            raise BackendError(f"{wheel.name} isn't the expected file (its SHA-256 differs); it was discarded")
        with zipfile.ZipFile(wheel) as archive:
            members = [m for m in archive.namelist() if ".libs/" in m]
            for prefix in KEPT:
                for member in members:
                    if os.path.basename(member).startswith(prefix):
                        _put(Path(archive.extract(member, temporary)), folder / os.path.basename(member))
    return folder


def libatomic_missing() -> bool:
    """True if Dr.Jit can't be imported because libatomic.so.1 is missing (its Linux wheels link it)."""
    if sys.platform != "linux":
        return False
    for name in ["libatomic.so.1", *(os.path.join(folder, "libatomic.so.1") for folder in private_folders())]:
        try:
            ctypes.CDLL(name)
            return False
        except OSError:
            continue
    return True


def install_libatomic() -> Path:
    """Take libatomic.so.1 out of Debian's or Ubuntu's own package; return the folder.

    apt-get downloads it with private lists, which needs no root and changes nothing in the system.

    Raises:
        BackendError: the system has no apt-get, or the download failed.
    """
    if not (shutil.which("apt-get") and shutil.which("dpkg-deb")):
        raise BackendError("this system has no apt-get to fetch libatomic.so.1")
    folder = _private_folder()
    print(f"djpt: fetching a private libatomic.so.1 into {folder} with apt-get", flush=True)
    with tempfile.TemporaryDirectory(dir=folder) as name:
        temporary = Path(name)
        for part in ("lists/partial", "cache/archives/partial", "root"):
            (temporary / part).mkdir(parents=True)
        # A user's apt-get can't write to the system's lists; root's drops its rights and then can't read ours.
        options = [
            f"Dir::State::Lists={name}/lists",
            f"Dir::Cache={name}/cache",
            "APT::Sandbox::User=root",
            "Acquire::Languages=none",
        ]
        apt = ["apt-get", "-qq", *(part for option in options for part in ("-o", option))]
        _run([*apt, "update"], "read the distribution's package lists")
        _run(["sh", "-c", 'cd "$0" && exec "$@"', name, *apt, "download", "libatomic1"], "download libatomic1")
        package = next(temporary.glob("libatomic1_*.deb"))
        _run(["dpkg-deb", "-x", str(package), f"{name}/root"], "unpack libatomic1")
        found = glob.glob(f"{glob.escape(name)}/root/usr/lib/**/libatomic.so.1", recursive=True)
        if not found:
            raise BackendError(f"{package.name} has no libatomic.so.1")
        _put(Path(found[0]).resolve(), folder / "libatomic.so.1")
    return folder


def _check() -> str:
    """Test the backend in a new process, as a user will run it; return the problem, or an empty string."""
    done = subprocess.run([sys.executable, "-c", _TRY_BACKEND], capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return ""
    return done.stderr.strip() or f"a trial of the CPU backend ended with status {done.returncode}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m djpt.jit.llvm [--if-needed]``: return 0 if djpt can run on the CPU afterwards, else 3."""
    parser = argparse.ArgumentParser(
        prog="python -m djpt.jit.llvm",
        description="Put a private libLLVM (and libatomic, where it is missing) into this Python environment.",
    )
    parser.add_argument("--if-needed", action="store_true", help="do nothing if a usable LLVM is there already")
    options = parser.parse_args(arguments)
    try:
        found = prepare()
        if not options.if_needed or (found.chosen is None and not found.from_user):
            install_llvm()
        if libatomic_missing():
            install_libatomic()
    except BackendError as error:
        print(f"djpt: {error}", file=sys.stderr)
    problem = _check()
    if problem:
        print(f"djpt: {problem}", file=sys.stderr)
        return 3
    print(f"djpt: the CPU backend works, with {search().chosen}")
    return 0

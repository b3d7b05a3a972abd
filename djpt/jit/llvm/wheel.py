"""LLVM 17 out of a wheel of the Python package index, for Linux on x86-64.

The index has no package of libLLVM, but one wheel bundles AlmaLinux' build of LLVM 17 with all of its C interface. It
is pinned by its checksum. Three of its files are kept, and nothing of it is executed.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

from djpt.errors import BackendError
from djpt.jit.llvm.private_copy import output_of, put

__all__ = ["SHA256", "WHEEL", "fetch"]

WHEEL = "lavavu-osmesa==1.9.10"
SHA256 = "9c39696ae876dbbcaf2bfce52533a8bd59dd891d3f97925944e1a5c9ff82bf37"
TAGS = ("--platform=manylinux_2_28_x86_64", "--python-version=3.12", "--implementation=cp", "--abi=cp312")
KEPT = ("libffi-", "libtinfo-", "libLLVM-")
"""The files of the wheel that are kept, in the order of writing: the library last, when it can be opened."""


def fetch(folder: Path, say: Callable[[str], None]) -> None:
    """Download the wheel, and put its libLLVM into a folder. `say` prints a line before the download.

    Raises:
        BackendError: Not Linux on x86-64, no pip, no network, no space, or a wheel with another checksum.
    """
    if (sys.platform, platform.machine()) != ("linux", "x86_64"):
        raise BackendError(f"the wheel is for Linux on x86_64, not for {sys.platform} on {platform.machine()}")
    say(f"LLVM 17 from the wheel {WHEEL} of the Python package index, 84 MB, SHA-256 {SHA256}")
    # Beside the target, since /tmp may be small, or on another disk.
    with tempfile.TemporaryDirectory(dir=folder) as name:
        temporary = Path(name)
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
        options = ["--quiet", "--retries=1", "--no-deps", "--only-binary=:all:", "--dest", name, *TAGS]
        output_of([*pip, "download", *options, WHEEL], f"download {WHEEL} from the package index")
        wheel = next(temporary.glob("*.whl"))
        if sha256(wheel) != SHA256:
            raise BackendError(f"{wheel.name} isn't the expected file (its SHA-256 differs); it was discarded")
        with zipfile.ZipFile(wheel) as archive:
            members = [member for member in archive.namelist() if ".libs/" in member]
            for prefix in KEPT:
                for member in members:
                    if os.path.basename(member).startswith(prefix):
                        put(Path(archive.extract(member, temporary)), folder / os.path.basename(member))


def sha256(path: Path) -> str:
    """The checksum of a file, as hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()

"""LLVM and libatomic out of packages of Debian and Ubuntu, unpacked into a private folder.

apt-get reads the distribution's lists into a temporary folder, works out which packages the system lacks, and downloads
them; it checks the signatures of the lists and the checksums of the packages. That takes no root, and changes nothing
in the system.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from djpt.errors import BackendError
from djpt.jit.llvm.finder import libatomic_missing
from djpt.jit.llvm.private_copy import output_of, put

__all__ = ["fetch", "fetch_libatomic"]

VERSIONS = (19, 22, 21, 20, 18, 17)
"""The versions of LLVM in the order in which they are asked for: first the one that the tests run with."""

NAMES = tuple(f"libllvm{version}{suffix}" for version in VERSIONS for suffix in ("", "t64"))

NEVER = ("libc6", "libc-bin")
"""Packages that can't be mixed with those of the running system."""

LINE = re.compile(r"^'([^']+)' (\S+) (\d+) SHA256:([0-9a-f]{64})$", re.MULTILINE)


@dataclass(frozen=True)
class Package:
    """A package that can be downloaded from a host: its size in bytes, and the checksum that signed lists give."""

    name: str
    version: str
    host: str
    size: int
    sha256: str


class Apt:
    """apt-get with lists of its own in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        for part in ("lists/partial", "cache/archives/partial", "packages"):
            (folder / part).mkdir(parents=True)
        # A user's apt-get can't write to the system's lists; root's drops its rights and then can't read ours.
        options = (
            f"Dir::State::Lists={folder}/lists",
            f"Dir::Cache={folder}/cache",
            "APT::Sandbox::User=root",
            "APT::Update::Error-Mode=any",  # else lists that can't be read are only a warning
            "Acquire::Languages=none",
            "Acquire::Retries=1",
            "Acquire::http::Timeout=15",
            "Debug::NoLocking=1",
        )
        self._options = [part for option in options for part in ("-o", option)]
        self("get", "update", what="read the distribution's package lists")

    def __call__(self, tool: str, *arguments: str, what: str) -> str:
        """Run apt-get or apt-cache."""
        return output_of([f"apt-{tool}", "-qq", *self._options, *arguments], what, self._folder / "packages")

    def first_of(self, names: Sequence[str]) -> str | None:
        """The first of some packages that the distribution has."""
        answer = self("cache", "policy", *names, what="look for LLVM in the package lists")
        found = set(re.findall(r"^(\S+):\n(?:  Installed: .*\n)?  Candidate: (?!\(none\))", answer, re.MULTILINE))
        return next((name for name in names if name in found), None)

    def lacking(self, *names: str) -> list[Package]:
        """The packages that an installation of some would bring: what is there isn't among them."""
        what = f"work out what {' '.join(names)} needs"
        answer = self("get", "--print-uris", "--no-install-recommends", "install", *names, what=what)
        files = [unquote(file).split("_") for file in re.findall(r"^'[^']+' (\S+\.deb) ", answer, re.MULTILINE)]
        if not files:
            return []
        versions = {name: version for name, version, _ in files}
        wanted = [f"{name}={version}" for name, version in versions.items()]
        # Of what it would install apt-get doesn't print the SHA-256, of what it would download it does.
        answer = self("get", "--print-uris", "download", *wanted, what=what)
        return [
            Package(name, versions[name], urlsplit(url).netloc, int(size), checksum)
            for url, file, size, checksum in LINE.findall(answer)
            for name in [file.split("_")[0]]
        ]

    def unpacked(self, packages: Sequence[Package]) -> Path:
        """Download packages, and return a folder with their files."""
        names = [f"{package.name}={package.version}" for package in packages]
        self("get", "download", *names, what=f"download {' '.join(names)}")
        root = self._folder / "root"
        for file in (self._folder / "packages").glob("*.deb"):
            output_of(["dpkg-deb", "-x", str(file), str(root)], f"unpack {file.name}")
        return root


def fetch(folder: Path, say: Callable[[str], None]) -> None:
    """Put the LLVM of the distribution into a folder, with all libraries that it needs and the system lacks.

    Also the libatomic of Dr.Jit. `say` prints a line before the download.

    Raises:
        BackendError: No apt-get, no LLVM that is new enough, no network or no space.
    """
    _fetch(folder, NAMES, say, ("libatomic1",) if libatomic_missing() else ())


def fetch_libatomic(folder: Path, say: Callable[[str], None]) -> None:
    """Put libatomic.so.1 into a folder; as `fetch`."""
    _fetch(folder, ("libatomic1",), say)


def _fetch(folder: Path, names: Sequence[str], say: Callable[[str], None], others: Sequence[str] = ()) -> None:
    if not (shutil.which("apt-get") and shutil.which("dpkg-deb")):
        raise BackendError("this system has no apt-get")
    # Beside the target, since /tmp may be small, or on another disk.
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        apt = Apt(Path(temporary))
        name = apt.first_of(names)
        if name is None:
            raise BackendError(f"the distribution has none of {', '.join(names)}")
        packages = apt.lacking(name, *others)
        if not packages:
            raise BackendError(f"{name} is installed already")
        if any(package.name in NEVER for package in packages):
            raise BackendError(f"{name} needs another libc6 than the system's")
        for package in packages:
            size, host = f"{package.size / 1e6:.1f} MB", package.host or "a local folder"
            say(f"{package.name} {package.version} from {host}, {size}, SHA-256 {package.sha256}")
        root = apt.unpacked(packages)
        found = [path for path in root.glob("**/*-linux-gnu/*.so.*") if _belongs(path)]
        for path in sorted(found, key=lambda path: "LLVM" in path.name):  # LLVM last, when it can be opened
            put(path, folder / path.name)


def _belongs(path: Path) -> bool:
    """True for a file, and for a link to a file beside it."""
    return path.is_file() and (not path.is_symlink() or path.resolve().parent == path.parent.resolve())

"""The choice of a libLLVM that Dr.Jit can use, made before Dr.Jit is imported.

Dr.Jit's own search takes the newest-looking library without testing it: LLVM 15
and 16 load, then abort the process at the first float minimum, because on x86-64 they
can't select ``llvm.minimum``. Dr.Jit reads ``DRJIT_LIBLLVM_PATH`` once, when it is first
imported. So djpt makes its own choice, sets that variable, and, where nothing fits, sets
it to a name that doesn't exist: Dr.Jit then can't fall back to a library that crashes.
"""

from __future__ import annotations

import ctypes
import functools
import os
import re
import sys
from dataclasses import dataclass, replace

__all__ = [
    "MINIMUM",
    "NEWEST_TESTED",
    "PATH_VARIABLE",
    "SEARCH_VARIABLE",
    "Candidate",
    "Search",
    "libatomic_missing",
    "prepare",
    "private_folders",
    "remedies",
    "search",
]

MINIMUM = 17
"""The oldest usable major version: Dr.Jit refuses 14, and 15 and 16 abort."""

NEWEST_TESTED = 22
"""The newest version that was tested; newer ones are tried after the tested ones."""

PATH_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Dr.Jit's variable: the library to open. Used if the user has set it and the library is usable."""

SEARCH_VARIABLE = "DJPT_LLVM_DIRS"
"""djpt's variable: folders to search **instead of** the usual ones, separated as in ``PATH``."""

_NOTHING_USABLE = "no-usable-libLLVM-found-by-djpt"

_MARK = "DJPT_LLVM_CHOSEN"
"""Repeats the value that djpt gave `PATH_VARIABLE`, so that a child process doesn't take it for the user's."""

_LIBRARY_NAME = re.compile(r"(libLLVM(-\d+)?[-.\w]*\.(so[.\d]*|dylib)|LLVM-C\.dll)$")
_VERSION_IN_NAME = re.compile(r"libLLVM(?:-|\.so\.|\.)(\d+)|[/\\]llvm[@/\\-](\d+)")

_ASK_VERSION = """
import ctypes, sys
numbers = [ctypes.c_uint() for _ in range(3)]
ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*map(ctypes.byref, numbers))
print(numbers[0].value)
"""


@dataclass(frozen=True)
class Candidate:
    """A library that was examined. `problem` is empty if it is usable; `version` 0 means unknown."""

    path: str
    version: int
    problem: str = ""

    def __str__(self) -> str:
        text = f"{self.path}  (LLVM {self.version or '?'}"
        return f"{text}: {self.problem})" if self.problem else f"{text})"


@dataclass(frozen=True)
class Search:
    """The libraries that were found, and the choice.

    Attributes:
        chosen: the library that Dr.Jit will open, or None.
        rejected: libraries that were examined before the choice was made, best first.
        spare: libraries that were not needed and not opened, best first.
        from_user: `DRJIT_LIBLLVM_PATH` was set by the user, so nothing else was considered.
        folders: the folders of `DJPT_LLVM_DIRS`, if it is set.
        too_late: Dr.Jit had been imported already, and has made its own choice.
    """

    chosen: Candidate | None
    rejected: tuple[Candidate, ...] = ()
    spare: tuple[Candidate, ...] = ()
    from_user: bool = False
    folders: tuple[str, ...] = ()
    too_late: bool = False

    def explain(self) -> str:
        """The text for the user if nothing is usable: what is needed, how to get it, what was found."""
        lines = []
        if self.from_user:
            lines.append(f"{PATH_VARIABLE} is set to a library that the CPU backend of Dr.Jit can't use:")
            lines += [f"    {candidate}" for candidate in self.rejected]
            if self.spare:
                lines.append(f"Unset it, and djpt will use {self.spare[0]}.")
                return "\n".join(lines)
            lines.append(f"Set it to a libLLVM of version {MINIMUM} or newer, or unset it and install one:")
        else:
            lines.append(f"The CPU backend of Dr.Jit needs a shared LLVM library, version {MINIMUM} or newer.")
            lines.append("Any one of these installs it:")
        lines += remedies()
        if not self.from_user:
            where = f" ({SEARCH_VARIABLE}={os.pathsep.join(self.folders)})" if self.folders else ""
            if self.rejected:
                lines.append(f"Looked at{where}:")
                lines += [f"    {candidate}" for candidate in self.rejected]
            else:
                lines.append(f"No libLLVM was found on this machine{where}.")
        return "\n".join(lines)


def remedies(private: bool = True) -> list[str]:
    """The commands that install a usable LLVM on this platform, one per line; `private`: also the one of djpt."""
    if sys.platform == "darwin":
        table = [("brew install llvm", "Homebrew"), ("conda install -c conda-forge libllvm19", "conda")]
        names = "libLLVM.dylib"
    elif sys.platform == "win32":
        table = [("winget install LLVM.LLVM", "Windows"), ("conda install -c conda-forge libllvm19", "conda")]
        names = "LLVM-C.dll"
    else:
        table = [
            ("sudo apt-get install -y libllvm19 libatomic1", "Debian 12+, Ubuntu 24.04+"),
            ("sudo dnf install -y llvm-libs libatomic", "Fedora"),
            ("conda install -c conda-forge libllvm19", "conda"),
        ]
        if private:
            table.insert(0, ("python -m djpt.jit.llvm", "into this Python environment, without root"))
        names = "libLLVM.so"
    width = max(len(command) for command, _ in table) + 2
    lines = [f"    {command:<{width}}{note}" for command, note in table]
    return [*lines, f"or set {PATH_VARIABLE} to the file ({names})."]


def private_folders() -> list[str]:
    """The folders for the copy of `python -m djpt.jit.llvm`: in the Python environment, or the user's data."""
    data = os.environ.get("XDG_DATA_HOME") or os.path.join(os.path.expanduser("~"), ".local", "share")
    return [os.path.join(sys.prefix, "llvm"), os.path.join(data, "djpt", "llvm")]


def _folders() -> list[str]:
    """The folders where LLVM is usually installed."""
    prefixes = {sys.prefix, os.environ.get("CONDA_PREFIX") or sys.prefix}
    folders = [os.path.join(prefix, "lib") for prefix in prefixes] + private_folders()
    if sys.platform == "win32":
        searched = os.environ.get("PATH", "").split(";")
        return [*folders, *searched, r"C:\Program Files\LLVM\bin", rf"{sys.prefix}\Library\bin"]
    if sys.platform == "darwin":
        of_homebrew = [f"{path}/lib" for path in _entries("/opt/homebrew/opt", "llvm")]
        of_macports = [f"{path}/lib" for path in _entries("/opt/local/libexec", "llvm-")]
        return [*folders, *of_homebrew, "/usr/local/opt/llvm/lib", *of_macports]
    folders += ["/usr/lib", "/usr/lib64", *_entries("/usr/lib", "-linux-gnu"), "/usr/local/lib"]
    return folders + [f"{path}/lib" for parent in ("/usr/lib", "/usr/lib64") for path in _entries(parent, "llvm")]


def _entries(folder: str, part: str) -> list[str]:
    """The paths in a folder whose names have `part` in them; none if it can't be read."""
    try:
        return [os.path.join(folder, name) for name in os.listdir(folder or os.curdir) if part in name]
    except OSError:
        return []


def _known_to_loader() -> list[str]:
    """The LLVM libraries in the cache of the dynamic loader (Linux), whose texts end in zeros."""
    try:
        with open("/etc/ld.so.cache", "rb") as file:
            texts = file.read().split(b"\0")
    except OSError:
        return []
    return [os.fsdecode(text) for text in texts if b"libLLVM" in text and text.startswith(b"/")]


def _version_in_name(path: str) -> int:
    match = _VERSION_IN_NAME.search(os.path.realpath(path))
    return int(match[1] or match[2]) if match else 0


def _version(path: str) -> int:
    """The major version by the file's name, else by a call of the library in another process; 0 is unknown."""
    version = _version_in_name(path)
    if version:
        return version
    import subprocess  # takes longer than the rest of the search

    try:
        answer = subprocess.run(
            [sys.executable, "-c", _ASK_VERSION, path], capture_output=True, text=True, timeout=30, check=False
        )
        return int(answer.stdout or 0)
    except (OSError, ValueError, subprocess.SubprocessError):
        return 0


def _judged(path: str, version: int) -> Candidate:
    """Make a candidate without opening the library; its version alone may rule it out."""
    return Candidate(path, version, f"too old, {MINIMUM} is needed" if 0 < version < MINIMUM else "")


def _candidates(folders: tuple[str, ...]) -> list[Candidate]:
    """All libraries found, best first: tested versions, newest first, then newer ones, then too old ones."""
    paths = [path for folder in folders or _folders() for path in _entries(folder, "LLVM")]
    if not folders:
        paths += _known_to_loader()
    files = {os.path.realpath(path) for path in paths if _LIBRARY_NAME.search(os.path.basename(path))}
    found = [_judged(path, _version(path)) for path in sorted(files)]

    def rank(candidate: Candidate) -> tuple[bool, int, str]:
        return MINIMUM <= candidate.version <= NEWEST_TESTED, candidate.version, candidate.path

    return sorted(found, key=rank, reverse=True)


def _examine(candidate: Candidate) -> Candidate:
    """Open the library as Dr.Jit will, and fill in `problem` if it isn't usable."""
    if candidate.problem:
        return candidate
    library, problem = _open(candidate.path)
    if library is None:
        return Candidate(candidate.path, candidate.version, problem)
    try:
        numbers = [ctypes.c_uint() for _ in range(3)]
        library.LLVMGetVersion(*map(ctypes.byref, numbers))
    except AttributeError:  # new in LLVM 16
        return Candidate(candidate.path, 0, f"not LLVM, or older than {MINIMUM}")
    return _judged(candidate.path, numbers[0].value)  # the library's own version: a file's name can be wrong


def _open(path: str) -> tuple[ctypes.CDLL | None, str]:
    """Open a library; in a private folder open its neighbours first, which nothing else would find."""
    folder = os.path.dirname(path)
    private = folder in {os.path.realpath(f) for f in private_folders()}
    waiting = [f for f in _entries(folder, ".so") if "LLVM" not in f] if private else []
    while True:
        try:
            return ctypes.CDLL(path), ""
        except OSError as error:
            problem = str(error)
        # The neighbours depend on each other as well: open what can be opened, and try again.
        left = [f for f in waiting if not _opens(f)]
        if len(left) == len(waiting):
            return None, problem
        waiting = left


def _opens(path: str) -> bool:
    try:
        ctypes.CDLL(path)
    except OSError:
        return False
    return True


def _open_private_libatomic() -> None:
    """Open a private libatomic.so.1: Dr.Jit's wheel needs one, and uses a copy that is open already."""
    for folder in private_folders():
        path = os.path.join(folder, "libatomic.so.1")
        if os.path.exists(path) and _opens(path):
            return


def libatomic_missing() -> bool:
    """True if Dr.Jit can't be imported because libatomic.so.1 is missing (its Linux wheels link it)."""
    if sys.platform != "linux":
        return False
    return not any(map(_opens, ["libatomic.so.1", *(f"{folder}/libatomic.so.1" for folder in private_folders())]))


def search() -> Search:
    """Look for LLVM as a fresh process would, changing nothing in the environment."""
    folders = tuple(f for f in os.environ.get(SEARCH_VARIABLE, "").split(os.pathsep) if f)
    wanted = os.environ.get(PATH_VARIABLE, "")
    if wanted and wanted != os.environ.get(_MARK):
        if os.sep in wanted and not os.path.exists(wanted):
            examined = Candidate(wanted, 0, "no such file")
        else:
            examined = _examine(_judged(wanted, _version_in_name(wanted)))
        if not examined.problem:
            return Search(examined, from_user=True, folders=folders)
        others = tuple(c for c in _candidates(folders) if c.version >= MINIMUM)
        return Search(None, (examined,), others, from_user=True, folders=folders)
    rejected: list[Candidate] = []
    found = _candidates(folders)
    for index, candidate in enumerate(found):
        examined = _examine(candidate)
        if not examined.problem:
            return Search(examined, tuple(rejected), tuple(found[index + 1 :]), folders=folders)
        rejected.append(examined)
    return Search(None, tuple(rejected), folders=folders)


@functools.cache
def prepare() -> Search:
    """Search once, and tell Dr.Jit the outcome through `DRJIT_LIBLLVM_PATH`.

    Takes effect only before the first ``import drjit`` or ``import mitsuba`` of the
    process. A variable that the user has set is left alone, even if it is useless: child
    processes must come to the same result. Never raises: code that needs the CPU
    backend reads `Search.chosen`.
    """
    found = replace(search(), too_late="drjit" in sys.modules)
    _open_private_libatomic()
    if not found.from_user:
        os.environ[PATH_VARIABLE] = os.environ[_MARK] = found.chosen.path if found.chosen else _NOTHING_USABLE
    return found

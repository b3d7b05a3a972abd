"""The installation of a private libLLVM, without root: by commands that need it, and by ``python -m djpt.jit.llvm``.

`SOURCES` are tried in order until the CPU backend has a library that it can open: the distribution's own package, then
a wheel. Where libatomic.so.1 is missing, as on bare images, it is fetched as well.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence

from djpt.errors import BackendError, near_miss
from djpt.jit.llvm import debian, wheel
from djpt.jit.llvm.finder import libatomic_missing, prepare, remedies, search
from djpt.jit.llvm.private_copy import private_folder

__all__ = ["FORBIDDEN", "SOURCES", "SOURCES_VARIABLE", "fetch_llvm", "main", "provide"]

SOURCES = {"debian": debian.fetch, "wheel": wheel.fetch}
"""The sources of a private LLVM, in the order in which they are tried."""

SOURCES_VARIABLE = "DJPT_LLVM_SOURCES"
"""djpt's variable: the sources to try, separated by commas, or `FORBIDDEN`."""

FORBIDDEN = "none"

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


def sources() -> list[str]:
    """The sources that may be used; empty if fetching is forbidden.

    Raises:
        BackendError: ``DJPT_LLVM_SOURCES`` names an unknown one.
    """
    names = [name.strip() for name in os.environ.get(SOURCES_VARIABLE, "").split(",") if name.strip()]
    for name in names:
        if name not in SOURCES and name != FORBIDDEN:
            known = (*SOURCES, FORBIDDEN)
            raise BackendError(f"{SOURCES_VARIABLE}: unknown source {name!r}{near_miss(name, known)}")
    return [] if FORBIDDEN in names else names or list(SOURCES)


def say(line: str) -> None:
    """Print a line of progress."""
    print(f"djpt: {line}", file=sys.stderr, flush=True)


def provide() -> None:
    """Fetch what the CPU backend lacks on this machine; does nothing where it lacks nothing.

    Nothing is fetched either where the user has chosen a library or folders, where ``DJPT_LLVM_SOURCES`` is ``none``,
    or once Dr.Jit is imported: using the backend then raises an error that says what to do.

    Raises:
        BackendError: All sources failed; the message has their reasons, and what else can be done.
    """
    found, allowed = prepare(), sources()
    if found.from_user or found.folders or found.too_late or not allowed or "drjit" in sys.modules:
        return
    if found.chosen is None:
        say(f"this machine has no LLVM that Dr.Jit can use; fetching one, once ({SOURCES_VARIABLE}=none forbids it)")
        fetch_llvm(allowed)
    if libatomic_missing():
        fetch_libatomic()
    prepare.cache_clear()
    prepare()


def fetch_llvm(names: Sequence[str]) -> None:
    """Put a libLLVM into the private folder, from the first of some sources that has one which can be opened.

    Raises:
        BackendError: None has.
    """
    folder, reasons = private_folder(), []
    for name in names:
        try:
            SOURCES[name](folder, say)
            if search().chosen is None:
                raise BackendError("its library can't be opened on this machine")
        except BackendError as error:
            reasons.append(f"    {name}: {error}")
            say(f"that failed: {str(error).splitlines()[-1].strip()}")
        else:
            say(f"LLVM is in {folder}")
            return
    raise BackendError(
        "\n".join(["LLVM can't be fetched:", *reasons, "Any one of these installs it:", *remedies(private=False)])
    )


def fetch_libatomic() -> None:
    """Put libatomic.so.1 into the private folder.

    Raises:
        BackendError: The distribution's package can't be fetched.
    """
    say("this machine has no libatomic.so.1, which Dr.Jit needs; fetching it, once")
    try:
        debian.fetch_libatomic(private_folder(), say)
    except BackendError as error:
        raise BackendError(
            f"libatomic.so.1 can't be fetched: {error}\nInstall the package libatomic1 (Debian, Ubuntu) or libatomic "
            "(Fedora)."
        ) from None


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
    parser.add_argument("--source", choices=SOURCES, action="append", help="where to get it; default: each in turn")
    options = parser.parse_args(arguments)
    try:
        found = prepare()
        if not options.if_needed or (found.chosen is None and not found.from_user):
            fetch_llvm(options.source or sources() or list(SOURCES))
        if libatomic_missing():
            fetch_libatomic()
    except BackendError as error:
        print(f"djpt: {error}", file=sys.stderr)
    problem = _check()
    if problem:
        print(f"djpt: {problem}", file=sys.stderr)
        return 3
    print(f"djpt: the CPU backend works, with {search().chosen}")
    return 0

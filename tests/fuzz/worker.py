"""The process that runs cases, one after the other, and may die of one."""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import resource
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from tests.fuzz.cases import HEADER, Case

__all__ = ["Verdict"]

GOOD = ("fine", "refused")
"""Outcomes as they should be: it works, or a `DjptError` says why it doesn't."""

MOST_GROWTH = 2 << 30
"""Bytes that the process may grow by in one case."""

MOST_WRITTEN = 1 << 28
"""The bytes of the largest file that a program can write."""


@dataclass
class Verdict:
    """What became of a case."""

    outcome: str
    """``fine``, ``refused`` or, as findings, ``foreign`` (an error that isn't a `DjptError`), ``nameless`` (one that
    doesn't name its cause), ``not finite`` (an image of NaN), ``outside`` (it opens a file outside of its folder),
    ``memory``, ``died`` or ``hung``."""
    error: str = ""
    """The type of the error."""
    place: str = ""
    """The function that raised it."""
    text: str = ""
    """Its message, or the end of what the process has written."""

    @property
    def is_finding(self) -> bool:
        """Whether something must be mended."""
        return self.outcome not in GOOD

    @property
    def signature(self) -> tuple[str, ...]:
        """Equal for two cases that probably show the same mistake."""
        return self.outcome, self.error, self.place


def main(memory: int, seconds: float) -> None:
    """Answer cases from the standard input, pickled, with verdicts at the standard output, until the input ends.

    A case that takes more than `seconds` of processor time, in all threads, ends the process by SIGXCPU.
    """
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a case prints
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    sys.setrecursionlimit(1000)
    import djpt  # noqa: F401 isort: skip
    import drjit as dr

    dr.set_thread_count(1)
    sys.addaudithook(watch)
    home = os.getcwd()
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            case: Case = pickle.load(sys.stdin.buffer)
            with tempfile.TemporaryDirectory(prefix="djpt-fuzz-") as folder:
                os.chdir(folder)
                limit_time(seconds)
                try:
                    answer(answers, tried(case))
                finally:
                    os.chdir(home)


def limit_time(seconds: float) -> None:
    """Let the process use so much more processor time: the clock of a busy machine says nothing about a case."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(used.ru_utime + used.ru_stime + seconds), hard))


@contextlib.contextmanager
def small_files() -> Iterator[None]:
    """Bound what is written to a file within a ``with`` block. Files of cases and answers aren't bounded."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_WRITTEN, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


OWN = tuple({os.path.realpath(path) for path in (sys.prefix, sys.base_prefix, *sys.path, "/usr", "/proc") if path})
"""Where programs and their libraries lie, which Python and djpt open themselves."""
WATCHES: list[list[str]] = []
"""The files that were opened elsewhere, for each `opened_outside` that is entered."""


@contextlib.contextmanager
def opened_outside() -> Iterator[list[str]]:
    """The files that Python opens outside of the working directory within a ``with`` block."""
    WATCHES.append([])
    try:
        yield WATCHES[-1]
    finally:
        WATCHES.pop()


def watch(event: str, arguments: tuple[Any, ...]) -> None:
    """Note an opened file; for `sys.addaudithook`."""
    if event != "open" or not WATCHES or not isinstance(arguments[0], (str, bytes, os.PathLike)):
        return
    path = os.path.realpath(os.fsdecode(arguments[0]))
    kernels = (os.path.join(os.path.expanduser("~"), ".drjit"), os.path.join(tempfile.gettempdir(), "djpt"))
    if not path.startswith((os.path.realpath("."), *kernels, *OWN)) and path not in ("/dev/null", "/dev/urandom"):
        WATCHES[-1].append(path)


def answer(answers: BinaryIO, verdict: Verdict) -> None:
    """Send a verdict."""
    pickle.dump((verdict.outcome, verdict.error, verdict.place, verdict.text), answers)
    answers.flush()


def tried(case: Case) -> Verdict:
    """Run a case in the working directory."""
    import djpt

    for name, content in case.files.items():
        Path(name).write_bytes(content)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    try:
        with small_files(), opened_outside() as outside:
            found = run(case)
    except djpt.DjptError as error:
        text = str(error)
        named = not is_loading(error) or any(name in text for name in case.names)
        found = Verdict("refused" if named and text else "nameless", type(error).__name__, place_of(error), text)
    except Exception as error:
        found = Verdict("foreign", type(error).__name__, place_of(error), "".join(traceback.format_exception(error)))
    if case.alone and outside:
        return Verdict("outside", found.outcome, found.place, ", ".join(outside))
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10) - before
    return Verdict("memory", found.outcome, found.place, f"{grown >> 20} MiB") if grown > MOST_GROWTH else found


def run(case: Case) -> Verdict:
    """Run a program, and look at its image."""
    import numpy as np

    names: dict[str, Any] = {"__name__": "case"}
    exec(compile(HEADER + case.code, "case.py", "exec"), names)
    image = names.get("image")
    if case.finite and image is not None and not np.isfinite(np.array(image)).all():
        return Verdict("not finite", "", "", f"{int((~np.isfinite(np.array(image))).sum())} numbers")
    return Verdict("fine")


def is_loading(error: BaseException) -> bool:
    """Whether the program was loading a description, and not making what to put into it."""
    frames = traceback.extract_tb(error.__traceback__)
    return any(frame.name in ("load_dict", "load_file", "load_string") for frame in frames)


def place_of(error: BaseException) -> str:
    """The innermost function of djpt that an error came through."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "site-packages" not in f.filename]
    frames = [f for f in frames if f.filename != "case.py"] or frames
    return f"{Path(frames[-1].filename).name}:{frames[-1].name}" if frames else ""


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]))

"""A worker process with limits, started again when it has died."""

from __future__ import annotations

import os
import pickle
import select
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from tests.fuzz.cases import Case
from tests.fuzz.worker import Verdict

__all__ = ["Pool"]

ROOT = Path(__file__).resolve().parents[2]


class Pool:
    """One worker process; cases are run one after the other.

    Args:
        seconds: a case that takes more processor time hangs.
        wall: a case that takes so many seconds hangs, too: it waits for something. Many, since a busy machine is slow.
        memory: the bytes that the process can address.
        cases: after so many a fresh process goes on.
    """

    def __init__(self, seconds: float = 20, wall: float = 300, memory: int = 6 << 30, cases: int = 2000) -> None:
        self.seconds, self.wall, self.memory, self.cases = seconds, wall, memory, cases
        self._process: subprocess.Popen[bytes] | None = None
        self._ran = 0
        self._folder = tempfile.TemporaryDirectory(prefix="djpt-fuzz-")

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.stop()
        self._folder.cleanup()

    def run(self, case: Case) -> Verdict:
        """What becomes of a case."""
        if self._process is None or self._ran >= self.cases:
            self.stop()
            self._start()
        assert self._process is not None and self._process.stdin is not None and self._process.stdout is not None
        self._ran += 1
        try:
            pickle.dump(case, self._process.stdin)
            self._process.stdin.flush()
            verdict = Verdict(*receive(self._process.stdout, self.wall))
        except TimeoutError:
            verdict = Verdict("hung", "by the clock", text=f"{self.wall:g} seconds")
            self.stop()
        except (EOFError, BrokenPipeError):
            verdict = self._end(self._process.wait())
            self.stop()
        return verdict

    def _end(self, code: int) -> Verdict:
        """Why the process has ended."""
        if code == -signal.SIGXCPU:
            return Verdict("hung", text=f"{self.seconds:g} seconds of processor time")
        name = signal.Signals(-code).name if code < 0 else f"exit status {code}"
        return Verdict("died", name, text=self._log.read_text(errors="replace")[-2000:])

    def _start(self) -> None:
        self._log = Path(self._folder.name) / "log.txt"
        environment = {**os.environ, "DRJIT_CACHE_DIR": self._folder.name, "PYTHONPATH": str(ROOT)}
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.fuzz.worker", str(self.memory), str(self.seconds)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, env=environment, cwd=ROOT,
            )  # fmt: skip
        self._ran = 0

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def receive(stream: IO[bytes], seconds: float) -> Any:
    """The next pickled object; raises `TimeoutError` or `EOFError`."""
    ready, _, _ = select.select([stream], [], [], seconds)
    if not ready:
        raise TimeoutError
    try:
        return pickle.load(stream)
    except pickle.UnpicklingError as error:
        raise EOFError from error

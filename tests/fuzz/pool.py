"""A worker process with limits, started again when it has died."""

from __future__ import annotations

import os
import pickle
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
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
        seconds: a case that takes longer hangs. The first one of a process has 30 more, to import djpt.
        memory: the bytes that the process can address.
        cases: after so many a fresh process goes on.
    """

    def __init__(self, seconds: float = 20, memory: int = 6 << 30, cases: int = 2000) -> None:
        self.seconds, self.memory, self.cases = seconds, memory, cases
        self.counts: Counter[str] = Counter()
        """How many cases had which outcome."""
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
        patience = self.seconds + (30 if self._ran == 0 else 0)
        self._ran += 1
        try:
            pickle.dump(case, self._process.stdin)
            self._process.stdin.flush()
            verdict = Verdict(*receive(self._process.stdout, patience))
        except TimeoutError:
            verdict = Verdict("hung", text=f"{patience:g} seconds")
            self.stop()
        except (EOFError, BrokenPipeError):
            code = self._process.wait()
            name = signal.Signals(-code).name if code < 0 else f"exit status {code}"
            verdict = Verdict("died", name, text=self._log.read_text(errors="replace")[-2000:])
            self.stop()
        self.counts[verdict.outcome] += 1
        return verdict

    def _start(self) -> None:
        self._log = Path(self._folder.name) / "log.txt"
        environment = {**os.environ, "DRJIT_CACHE_DIR": self._folder.name, "PYTHONPATH": str(ROOT)}
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.fuzz.worker", str(self.memory)],
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
    end = time.monotonic() + seconds
    ready, _, _ = select.select([stream], [], [], max(0.0, end - time.monotonic()))
    if not ready:
        raise TimeoutError
    try:
        return pickle.load(stream)
    except pickle.UnpicklingError as error:
        raise EOFError from error

"""Signals that end a long render: after the pass at hand, with everything in order.

A first SIGINT (Ctrl-C) or SIGTERM is noted; the pass that is being computed ends, what exists is kept if that was asked
for, temporary files are removed, and then `KeyboardInterrupt` or `Terminated` is raised. A second SIGINT ends at once.
Handlers are only replaced in the main thread, where the default ones are in place, and come back in the end.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any, NoReturn

from djpt.core.files import remove_unfinished

__all__ = ["Interruption", "Terminated", "end_at_once", "ending_at_once", "interruptible", "noticing"]


class Terminated(SystemExit):
    """SIGTERM has ended a render. Uncaught, it ends the process with the status 143, as a shell shows the signal."""

    def __init__(self, message: str) -> None:
        super().__init__(128 + signal.SIGTERM)
        self.message = message

    def __str__(self) -> str:
        return self.message


class Interruption:
    """The signals that have come while something is rendered, and what is to be done about them."""

    def __init__(self, keeps: bool = False) -> None:
        self.keeps = keeps
        """True if what exists is kept."""
        self.signal: int | None = None
        """The signal that has come."""
        self.done, self.total = 0, 0
        """Samples that are computed, and all of them: those of a part, if the render has several."""
        self._before: float | None = 0.0
        self._part = 1.0
        """The share of all samples that earlier parts have taken, None: nobody knows; and that of the part at hand."""
        self._waits = False

    @property
    def requested(self) -> bool:
        """True if the render is to end."""
        return self.signal is not None

    @property
    def ends_kept(self) -> bool:
        """True if the render is to end with what exists."""
        return self.keeps and self.requested

    @property
    def share(self) -> float | None:
        """The fraction of the samples that are computed; None if nobody knows."""
        if self._before is None or not (self._before or self.total):
            return None
        # Samplers may round up.
        return min(1.0, self._before + (self._part * self.done / self.total if self.total else 0))

    def begin_part(self, before: float | None, part: float) -> None:
        """Begin a part of a render: `part` is its share of all samples, after a share `before`; None: nobody knows."""
        self.done, self.total = 0, 0
        self._before, self._part = before, part

    def note(self, number: int) -> None:
        """Note a signal. A second SIGINT raises `KeyboardInterrupt`, and within `waiting` any signal its exception."""
        if self.requested and number == signal.SIGINT:
            raise KeyboardInterrupt("interrupted twice")
        self.signal = self.signal or number
        if self._waits:
            self.leave("nothing is kept")

    @contextlib.contextmanager
    def waiting(self) -> Iterator[None]:
        """Let signals raise their exceptions at once: where other machines are waited for, no pass has to end."""
        self._waits = True
        try:
            if self.signal is not None:
                self.leave("nothing is kept")
            yield
        finally:
            self._waits = False

    def check(self) -> None:
        """Raise the exception of the signal that has come, unless what exists is to be kept."""
        if self.requested and not self.keeps:
            self.leave("nothing is kept")

    def leave(self, what: str) -> None:
        """Raise the exception of the signal that has come, if one has; `what` is kept, for its message."""
        if self.signal is None:
            return
        share = "" if self.share is None else f" after {100 * self.share:.3g} % of the samples"
        if self.signal == signal.SIGINT:
            raise KeyboardInterrupt(f"interrupted{share}: {what}")
        raise Terminated(f"terminated{share}: {what}")


@contextlib.contextmanager
def interruptible(keeps: bool) -> Iterator[Interruption]:
    """Note signals while something is rendered."""
    interruption = Interruption(keeps)
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return

    def handle(number: int, frame: FrameType | None) -> None:
        interruption.note(number)

    before: dict[int, Any] = {}
    try:
        for caught, default in ((signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, signal.SIG_DFL)):
            if signal.getsignal(caught) is default:
                before[caught] = signal.signal(caught, handle)
        yield interruption
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# ---- at once ---------------------------------------------------------------------------------


@contextlib.contextmanager
def ending_at_once() -> Iterator[None]:
    """Let a second SIGINT end the process even while kernels run, when Python's own handlers have to wait.

    For the command line: the whole process ends, with the status 130.
    """
    if sys.platform == "win32" or threading.current_thread() is not threading.main_thread():
        yield
        return
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    listener = threading.Thread(target=listen, args=(reading,), daemon=True)
    listener.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(writing)
        listener.join()
        os.close(reading)


def listen(descriptor: int) -> None:
    """Read the numbers of signals from a pipe until it is closed, or until the second SIGINT."""
    interrupts = 0
    while number := os.read(descriptor, 1):
        interrupts += number[0] == signal.SIGINT
        if interrupts == 2:
            end_at_once()


def end_at_once() -> NoReturn:
    """End the process, leaving no temporary file."""
    remove_unfinished()
    print("djpt: error: interrupted at once", file=sys.stderr, flush=True)
    os._exit(128 + signal.SIGINT)


def noticing(keep_partial: bool) -> contextlib.AbstractContextManager[Interruption | None]:
    """Notice signals if something is to be kept then; otherwise they do what they do to any script."""
    return interruptible(keeps=True) if keep_partial else contextlib.nullcontext()

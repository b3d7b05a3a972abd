"""Daemon threads that render when the process ends.

Python stops such a thread where it next asks for the interpreter. If it is in C++ code then, as when it waits for a
kernel, the process aborts. So these threads are ended before, by an exception, as soon as the main thread has ended.
"""

from __future__ import annotations

import atexit
import ctypes
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Any
from weakref import WeakSet

__all__ = ["note_thread"]

LONGEST = 60.0
"""Seconds that the end of the process waits for daemon threads."""

IDLE = 0.5
"""Seconds in which the process computes nothing, after which its threads are taken for ones that wait."""

IDLE_INSIDE = 10.0
"""The time to wait if a thread is within djpt or Dr.Jit: other processes may need the processor."""

PACKAGES = frozenset({"djpt", "drjit"})

noted: WeakSet[threading.Thread] = WeakSet()
"""The daemon threads that have rendered."""

ending = threading.Event()
"""Set when the process ends."""


def note_thread() -> None:
    """Note that the current thread is about to use Dr.Jit.

    Raises:
        SystemExit: It is a daemon thread, and the process ends.
    """
    thread = threading.current_thread()
    if not thread.daemon:
        return
    if ending.is_set():
        raise SystemExit
    if not noted:
        # Later than Dr.Jit's own clean-up, and so called before it.
        atexit.register(end_daemons)
    noted.add(thread)


def end_daemons() -> None:
    """End the daemon threads that render, and wait until they have."""
    ending.set()
    threading.excepthook = without_noted(threading.excepthook)
    threads = [thread.ident for thread in list(noted) if thread.ident is not None]
    for number in threads:
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(number), ctypes.py_object(SystemExit))
    end = time.monotonic() + LONGEST
    used, busy = time.process_time(), time.monotonic()
    while time.monotonic() < end:
        time.sleep(0.01)
        frames = [frame for number, frame in sys._current_frames().items() if number in threads]
        if time.process_time() - used > 0.02:
            used, busy = time.process_time(), time.monotonic()
        left = [frame for frame in frames if not waits(frame)]
        patience = IDLE_INSIDE if any(map(computes, left)) else IDLE
        if not left or time.monotonic() - busy > patience:
            return


def without_noted(report: Callable[[threading.ExceptHookArgs], Any]) -> Callable[[threading.ExceptHookArgs], Any]:
    """A hook that reports the exceptions of all other threads: Dr.Jit makes its own ones of what ends a trace."""

    def hook(arguments: threading.ExceptHookArgs) -> None:
        if arguments.thread not in noted:
            report(arguments)

    return hook


def computes(frame: FrameType | None) -> bool:
    """True if a thread is within djpt or Dr.Jit."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] in PACKAGES:
            return True
        frame = frame.f_back
    return False


def waits(frame: FrameType) -> bool:
    """True if a thread waits for another one."""
    return frame.f_globals.get("__name__") == "threading"

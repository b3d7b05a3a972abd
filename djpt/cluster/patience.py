"""Waiting for others, but not for ever, as `distributed` waits for a scheduler that is there and says nothing."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

__all__ = ["within"]

T = TypeVar("T")


def within(seconds: float, ask: Callable[[], T]) -> T:
    """What `ask` gives, which runs in a thread of its own; it is left alone if it takes too long.

    Raises:
        TimeoutError: It takes longer than `seconds`.
        Exception: What `ask` raises.
    """
    found: list[T] = []
    raised: list[Exception] = []

    def answer() -> None:
        try:
            found.append(ask())
        except Exception as error:  # handed on
            raised.append(error)

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    thread.join(seconds)
    if raised:
        raise raised[0]
    if not found:
        raise TimeoutError(f"no answer in {seconds:g} s")
    return found[0]

"""Waiting with a time limit: `distributed` itself waits forever for a peer that is connected but silent."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["Question", "within"]

T = TypeVar("T")


class Question(Generic[T]):
    """A call that runs in a thread of its own and is abandoned there if it takes too long."""

    def __init__(self, ask: Callable[[], T]) -> None:
        self._ask = ask
        self._found: list[T] = []
        self._raised: list[Exception] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._found.append(self._ask())
        except Exception as error:  # handed on
            self._raised.append(error)

    def ended(self, seconds: float) -> bool:
        """Wait for the answer for at most `seconds`; True if it has arrived."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def answer(self) -> T:
        """The result of the call, or the exception that it raised, once it has ended."""
        if self._raised:
            raise self._raised[0]
        return self._found[0]


def within(seconds: float, ask: Callable[[], T]) -> T:
    """The result of a call; raises `TimeoutError` if it takes longer than `seconds`."""
    question = Question(ask)
    if not question.ended(seconds):
        raise TimeoutError(f"no answer in {seconds:g} s")
    return question.answer()

"""The threads that build and fit a tree."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import drjit as dr

__all__ = ["Workers", "workers"]

T = TypeVar("T")
R = TypeVar("R")

FEW = 20_000
"""With fewer primitives, threads aren't worth their start."""


class Workers:
    """Threads that work through lists of tasks; or just the calling one."""

    def __init__(self, pool: ThreadPoolExecutor | None) -> None:
        self._pool = pool
        self._futures: list[Future[None]] = []

    def map(self, function: Callable[[T], R], tasks: Sequence[T]) -> list[R]:
        """The results of a function for all tasks."""
        if self._pool is None or len(tasks) < 2:
            return [function(task) for task in tasks]
        return list(self._pool.map(function, tasks))

    def begin(self, function: Callable[[T], None], task: T) -> None:
        """Do a task soon, which may begin others."""
        if self._pool is None:
            function(task)
        else:
            self._futures.append(self._pool.submit(function, task))

    def finish(self) -> None:
        """Wait for all tasks that were begun."""
        # A task that begins another one does so before it ends: the list is complete when its end is reached.
        for future in self._futures:
            future.result()
        self._futures.clear()


@contextmanager
def workers(primitives: int, threads: int | None) -> Iterator[Workers]:
    """Threads for a tree over some primitives: as many as Dr.Jit has, unless a number is given."""
    count = dr.thread_count() if threads is None else threads
    if primitives < FEW or count < 2:
        yield Workers(None)
    else:
        with ThreadPoolExecutor(count) as pool:
            yield Workers(pool)

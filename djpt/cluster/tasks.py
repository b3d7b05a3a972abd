"""Tasks whose results are taken in order, while workers come and go."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from typing import Any

from djpt.cluster.bundle import Bundle
from djpt.cluster.work import Answer, software
from djpt.errors import BackendError, DjptError, RenderError

__all__ = ["InOrder", "require_client"]

AHEAD = 2
"""Tasks for each worker that are begun before their turn."""

ATTEMPTS = 10
"""How often a task is given to workers that die before it is taken for deadly."""


class InOrder:
    """Runs numbered tasks on the workers of a client, and gives their results in the order of the numbers.

    A task that is lost with its worker is run again, by the scheduler, or from here if it has given up. There are as
    many results ahead of their turn as `AHEAD` allows, so that memory doesn't grow with the number of tasks.

    Args:
        client: a `distributed.Client`.
        bundle: the scene.
        work: called on workers with (bundle, *arguments).
        arguments: those of the task with a number.
    """

    def __init__(
        self,
        client: Any,
        bundle: Bundle,
        work: Callable[..., Answer],
        arguments: Callable[[int], tuple[Any, ...]],
    ) -> None:
        self._client, self._work, self._arguments = client, work, arguments
        self._name = f"djpt-{bundle.key[:8]}-{uuid.uuid4().hex[:8]}"
        # Part of a task, and not scattered: what only workers hold is gone with them.
        self._scene = client.submit(identity, bundle, key=f"{self._name}-scene")
        self._futures: dict[int, Any] = {}
        self._software = software()

    def results(self, first: int, end: int | None) -> Iterator[Any]:
        """The results of the tasks from `first` up to `end`, or without end. Closing the iterator cancels the rest."""
        number = first
        try:
            while end is None or number < end:
                workers = max(1, len(self._client.scheduler_info(n_workers=-1)["workers"]))
                last = number + AHEAD * workers
                for ahead in range(number, last if end is None else min(last, end)):
                    if ahead not in self._futures:
                        self._futures[ahead] = self._submitted(ahead, 0)
                yield self._result(number)
                number += 1
        finally:
            self._client.cancel(list(self._futures.values()))
            self._futures.clear()

    def _submitted(self, number: int, attempt: int) -> Any:
        # Earlier tasks first: their results are waited for.
        return self._client.submit(
            self._work,
            self._scene,
            *self._arguments(number),
            key=f"{self._name}-{number}-{attempt}",
            priority=-number,
            pure=False,
        )

    def _result(self, number: int) -> Any:
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        for attempt in range(1, ATTEMPTS + 1):
            future = self._futures.pop(number)
            try:
                answer: Answer = future.result()
            except (KilledWorker, FutureCancelledError) as error:
                if attempt == ATTEMPTS:
                    raise RenderError(f"a task has ended {ATTEMPTS} workers, the last time with: {error}") from None
                self._futures[number] = self._submitted(number, attempt)
                continue
            except DjptError as error:
                raise type(error)(f"on a worker: {error}") from None
            if answer.software != self._software:
                raise BackendError(f"a worker has {answer.software}, here is {self._software}: results would differ")
            return answer.value
        raise AssertionError("unreachable")


def identity(bundle: Bundle) -> Bundle:
    """The bundle itself, as a result that lives on workers and can be computed again."""
    return bundle


def require_client(client: Any) -> None:
    """Raise `BackendError` unless `client` is a `distributed.Client`."""
    try:
        from distributed import Client
    except ImportError:
        raise BackendError("clusters need the package 'distributed': pip install 'dask[distributed]'") from None
    if not isinstance(client, Client):
        raise BackendError(f"'client' must be a distributed.Client, found {type(client).__name__}")

"""Tasks whose results are taken in order, while workers join, leave and stop."""

from __future__ import annotations

import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterator
from typing import Any, Generic, NamedTuple, TypeVar

from djpt.apps.cluster.work import Answer, Bundle, software
from djpt.errors import BackendError, DjptError, RenderError

__all__ = ["InOrder", "require_client", "warn", "within"]

AHEAD = 2
"""The number of tasks per worker that are started ahead of their turn."""

ATTEMPTS = 10
"""The number of workers that may die from a task before it is considered fatal."""

LOOK_SECONDS = 1.0
"""The time between two checks of the workers while no result arrives."""

PATIENCE = 5.0
"""Seconds without a worker or a scheduler after which this is reported."""

SILENCE = 10.0
"""Seconds without a heartbeat after which a worker counts as stopped. Workers send one every few seconds."""


GONE = "the scheduler of the cluster is gone"


class Attempt(NamedTuple):
    """A task that has been submitted to workers."""

    future: Any
    allowed: frozenset[str] | None
    """The addresses of the workers that may run it; None: any."""


class InOrder:
    """Runs numbered tasks on the workers of a client, and yields their results in the order of the numbers.

    A task that is lost with its worker is run again, by the scheduler, or by this class if the scheduler has given up.
    The tasks of a worker that sends no heartbeat, because it is stopped or hangs, are also submitted to the others;
    the first result counts, as all are equal. At most `AHEAD` results per worker are computed ahead of their turn, so
    that memory doesn't grow with the number of tasks.

    Args:
        client: a `distributed.Client`.
        bundle: the scene.
        work: called on workers with (bundle, *arguments).
        arguments: those of the task with a number.
        on_wait: called once with the reason for waiting, if there are no workers or the scheduler doesn't answer.
    """

    def __init__(
        self,
        client: Any,
        bundle: Bundle,
        work: Callable[..., Answer],
        arguments: Callable[[int], tuple[Any, ...]],
        on_wait: Callable[[str], None],
    ) -> None:
        self._client, self._bundle, self._work, self._arguments = client, bundle, work, arguments
        self._on_wait = on_wait
        self._name = f"djpt-{bundle.key[:8]}-{uuid.uuid4().hex[:8]}"
        # Part of a task, and not scattered: what only workers hold is gone with them.
        self._scenes: dict[frozenset[str] | None, Any] = {}
        self._attempts: dict[int, list[Attempt]] = {}
        self._submissions = 0
        self._watch = Watch()
        self._silent = False
        """True if the scheduler doesn't answer."""
        self._came = threading.Event()
        """Set when a task has ended."""
        self._software = software()

    def results(self, first: int, end: int | None) -> Iterator[Any]:
        """The results of the tasks from `first` up to `end`, or without end. Closing the iterator cancels the rest."""
        number = first
        try:
            while end is None or number < end:
                last = number + AHEAD * max(1, len(self._look()))
                for ahead in range(number, last if end is None else min(last, end)):
                    if ahead not in self._attempts:
                        self._submit(ahead)
                yield self._result(number)
                number += 1
        except DjptError:
            raise
        except RuntimeError as error:  # distributed's, of a client that has been closed meanwhile
            if self._client.status == "running":
                raise
            raise RenderError(GONE) from error
        finally:
            # Without waiting for the scheduler, which may be gone.
            left = [attempt.future for attempts in self._attempts.values() for attempt in attempts]
            for future in (*self._scenes.values(), *left):
                future.release()
            self._attempts.clear()
            self._scenes.clear()

    def _look(self) -> frozenset[str]:
        """The current workers, noted by the watch; if the scheduler doesn't answer, those that it knew last."""
        self._require_scheduler()
        try:
            found = within(SILENCE, lambda: self._client.scheduler_info(n_workers=-1))
        except TimeoutError:
            if not self._silent:
                self._silent = True
                self._on_wait(f"the scheduler at {self._client.scheduler.address} doesn't answer: waiting for it")
        else:
            self._silent = False
            self._watch.look(found["workers"])
        return self._watch.live | self._watch.stopped

    # ---- giving ------------------------------------------------------------------------------

    def _submit(self, number: int) -> None:
        """Submit a task to any worker, or if some have stopped, to the others."""
        allowed = self._watch.live if self._watch.stopped else None
        self._submissions += 1
        options = {} if allowed is None else {"workers": sorted(allowed)}
        if allowed not in self._scenes:
            # Of their own: a worker that gets the scene from a stopped one would wait for ever.
            name = f"{self._name}-scene-{len(self._scenes)}"
            self._scenes[allowed] = self._client.submit(identity, self._bundle, key=name, **options)
        future = self._client.submit(
            self._work,
            self._scenes[allowed],
            *self._arguments(number),
            key=f"{self._name}-{number}-{self._submissions}",
            priority=-number,  # earlier tasks first: their results are waited for
            pure=False,
            **options,
        )
        future.add_done_callback(lambda _: self._came.set())
        self._attempts.setdefault(number, []).append(Attempt(future, allowed))

    def _give_again(self) -> None:
        """Resubmit the tasks that stopped workers may hold to the others."""
        if not self._watch.live:
            return
        for number, attempts in list(self._attempts.items()):
            if not any(attempt.future.done() or self._watch.trusts(attempt.allowed) for attempt in attempts):
                self._submit(number)

    # ---- taking ------------------------------------------------------------------------------

    def _result(self, number: int) -> Any:
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        killed = 0
        while True:
            attempt = self._ended(number)
            question: Question[Answer] = Question(attempt.future.result)
            if not self._fetched(question, attempt):
                self._retry(number, attempt)
                continue
            try:
                answer = question.answer()
            except (KilledWorker, FutureCancelledError) as error:
                self._require_scheduler()
                killed += 1
                if killed == ATTEMPTS:
                    raise RenderError(f"a task has killed {ATTEMPTS} workers, the last one with: {error}") from None
                self._retry(number, attempt)
                continue
            except DjptError as error:
                raise type(error)(f"on a worker: {error}") from None
            if answer.software != self._software:
                raise BackendError(
                    f"a worker runs {answer.software}, this process runs {self._software}: results would differ"
                )
            for ended in self._attempts.pop(number):
                ended.future.release()
            return answer.value

    def _fetched(self, question: Question[Answer], attempt: Attempt) -> bool:
        """Wait for a result to arrive; False if it doesn't, since a stopped worker doesn't send its results."""
        while not question.ended(LOOK_SECONDS):
            self._look()
            if self._watch.live and not self._watch.trusts(attempt.allowed):
                return False
        return True

    def _retry(self, number: int, attempt: Attempt) -> None:
        """Discard an attempt that has failed."""
        self._attempts[number].remove(attempt)
        attempt.future.release()
        if not self._attempts[number]:
            self._submit(number)

    def _ended(self, number: int) -> Attempt:
        """An attempt at a task that has ended, successfully or not; waits for one."""
        start, told = time.monotonic(), False
        while True:
            self._came.clear()
            for attempt in self._attempts[number]:
                if attempt.future.done():
                    return attempt
            if self._came.wait(LOOK_SECONDS):
                continue
            self._look()
            self._give_again()
            if not self._watch.live and not told and time.monotonic() - start >= PATIENCE:
                told = True
                address = self._client.scheduler.address
                missing = "all workers have stopped" if self._watch.stopped else "there are no workers"
                self._on_wait(f"{missing} at {address}: waiting for some ('djpt worker {address}' starts one)")

    def _require_scheduler(self) -> None:
        """Raise `RenderError` if the scheduler has been gone for a while."""
        deadline = time.monotonic() + PATIENCE
        while self._client.status != "running":
            if self._client.status == "closed" or time.monotonic() >= deadline:
                raise RenderError(GONE)
            time.sleep(0.1)


class Watch:
    """The sets of live and of stopped workers, by the times of their last heartbeats.

    These are the scheduler's: only whether they change counts here, as clocks of machines differ.
    """

    def __init__(self) -> None:
        self.live: frozenset[str] = frozenset()
        """The addresses of workers that send heartbeats."""
        self.stopped: frozenset[str] = frozenset()
        """Those of workers that the scheduler lists, but that send none."""
        self._signs: dict[str, tuple[float, float]] = {}
        """By address: the last heartbeat, and when it was first seen."""

    def look(self, workers: dict[str, Any]) -> None:
        """Record what the scheduler knows about its workers."""
        now = time.monotonic()
        signs = {address: float(worker["last_seen"]) for address, worker in workers.items()}
        old = self._signs
        self._signs = {
            address: old[address] if address in old and old[address][0] == sign else (sign, now)
            for address, sign in signs.items()
        }
        self.stopped = frozenset(address for address, (_, since) in self._signs.items() if now - since > SILENCE)
        self.live = frozenset(signs) - self.stopped

    def trusts(self, allowed: frozenset[str] | None) -> bool:
        """True if a task restricted to some workers may run on a live one; None: any worker may run it."""
        if allowed is None:
            return not self.stopped
        return bool(allowed & self.live) and not allowed & self.stopped


def warn(message: str) -> None:
    """Issue a Python warning, attributed to the caller of djpt."""
    warnings.warn(message, RuntimeWarning, stacklevel=2)


def identity(bundle: Bundle) -> Bundle:
    """The bundle itself, as a result that is kept on workers and can be recomputed."""
    return bundle


def require_client(client: Any) -> None:
    """Raise `BackendError` unless `client` is a `distributed.Client`."""
    try:
        from distributed import Client
    except ImportError:
        raise BackendError("clusters need the package 'distributed': pip install 'dask[distributed]'") from None
    if not isinstance(client, Client):
        raise BackendError(f"'client' must be a distributed.Client, found {type(client).__name__}")


# ---- waiting with a time limit ---------------------------------------------------------------


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

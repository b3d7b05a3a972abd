"""Renders in rounds, and gradients, on many machines."""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from djpt.apps.cluster.work import Answer, Bundle, differentiated, distributed, rendered, software
from djpt.core.numeric import whole
from djpt.errors import BackendError, DjptError, ParameterError, RenderError
from djpt.rendering.progressive.accumulation import Accumulation, EvenAccumulation
from djpt.rendering.progressive.passes import EvenImage, Goal, begun, rounds
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.settings import RenderSettings, check_count, check_seed

__all__ = ["gradient", "render_passes", "warn", "within"]

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
            coming: Future[Answer] = asked(attempt.future.result)
            if not self._fetched(coming, attempt):
                self._retry(number, attempt)
                continue
            try:
                answer = coming.result()
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

    def _fetched(self, coming: Future[Answer], attempt: Attempt) -> bool:
        """Wait for a result to arrive; False if it doesn't, since a stopped worker doesn't send its results."""
        while not wait([coming], LOOK_SECONDS).done:
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
    if not isinstance(client, distributed().Client):
        raise BackendError(f"'client' must be a distributed.Client, found {type(client).__name__}")


# ---- waiting with a time limit ---------------------------------------------------------------


T = TypeVar("T")


def asked(ask: Callable[[], T]) -> Future[T]:
    """The result to come of a call that runs in a thread of its own, where it is abandoned if it takes too long."""
    answer: Future[T] = Future()

    def run() -> None:
        try:
            answer.set_result(ask())
        except BaseException as error:  # handed on
            answer.set_exception(error)

    threading.Thread(target=run, daemon=True).start()  # those of executors would be waited for at the end
    return answer


def within(seconds: float, ask: Callable[[], T]) -> T:
    """The result of a call; raises `TimeoutError` if it takes longer than `seconds`."""
    answer = asked(ask)
    if not wait([answer], seconds).done:
        raise TimeoutError(f"no answer in {seconds:g} s")
    return answer.result()


# ---- renders in rounds -----------------------------------------------------------------------


def render_passes(
    client: Any,
    description: Mapping[str, Any],
    *,
    sensor: int = 0,
    seed: int = 0,
    spp: int = 0,
    round_spp: int = 0,
    target_error: float | None = None,
    time_budget: float | None = None,
    resume_from: Accumulation | None = None,
    schedule: str = "auto",
    on_wait: Callable[[str], None] = warn,
) -> Iterator[Accumulation]:
    """Render in rounds on the workers of a cluster, yielding the image so far after each, as `djpt.render_passes` does.

    Rounds are tasks, added up in the order of their numbers: the image has the bits of `djpt.render_passes` on one
    machine, with any number of workers that have its processor's vector width. A worker that dies, stops, hangs or
    joins late changes only the time taken. The scene is sent once to each worker, with the files that it names.

    Args:
        client: A `distributed.Client`.
        description: The scene's dict, or what `djpt.scenes.overrides.described` makes of a file. It is loaded
            here as well. Edits by `djpt.traverse` aren't sent.
        sensor: The number of the scene's sensor.
        seed: As for `djpt.render_passes`, and so are the arguments that follow.
        spp: Samples per pixel.
        round_spp: Samples per pixel of a round. Rounds are distributed over the workers: use at least as many.
        target_error: Stop at this relative RMSE.
        time_budget: Stop after this many seconds.
        resume_from: The accumulation to continue from.
        schedule: How lanes are filled.
        on_wait: Called with a message if there are no workers for five seconds, or the scheduler doesn't answer for
            ten; the render continues once they return. Default: a `RuntimeWarning`.

    Raises:
        BackendError: `distributed` is missing, or a worker has another version of djpt or Dr.Jit.
        RenderError: Arguments are out of range, a task repeatedly kills its workers, or the scheduler is gone.
        SceneError: The scene is wrong, or holds objects that can't be sent.
    """
    require_client(client)
    bundle = Bundle.of(description)
    scene = bundle.loaded()
    number = whole(sensor)
    if number is None:
        raise RenderError(f"'sensor' must be the number of a sensor of the scene, found {sensor!r}")
    settings = RenderSettings.of(scene, number, seed=seed, spp=spp, schedule=schedule)
    if resume_from is not None:
        round_spp = round_spp or resume_from.round_spp
    goal = Goal.of(settings, round_spp, target_error, time_budget)
    image = SharedImage(scene, settings, goal)
    first = begun(image, resume_from)

    def arguments(number_of_round: int) -> tuple[Any, ...]:
        return number, image.count(number_of_round), schedule, round_seed(settings.seed, number_of_round)

    found = InOrder(client, bundle, rendered, arguments, on_wait)
    image.results = found.results(first.whole.rounds, goal.rounds)
    return closing(rounds(first, goal, image), image.results)


class SharedImage(EvenImage):
    """An image whose rounds come from workers, in order."""

    results: Iterator[Any]

    def begin(self, found: EvenAccumulation, number: int, watched: bool) -> Callable[[Any], Accumulation]:
        seed, count = round_seed(self.settings.seed, number), self.count(number)
        return lambda found: found.with_round(seed, count, next(self.results))

    def overlaps(self, number: int) -> bool:
        # Workers are ahead anyway.
        return False


def closing(images: Iterator[Accumulation], results: Any) -> Iterator[Accumulation]:
    """The images; tasks that are no longer needed are cancelled at the end."""
    with contextlib.closing(results):
        yield from images


# ---- gradients, summed over the workers ------------------------------------------------------


def gradient(
    client: Any,
    description: Mapping[str, Any],
    parameters: Mapping[str, Any],
    loss: Callable[[Any, int], Any],
    views: Sequence[int],
    *,
    spp: int = 0,
    seed: int = 0,
) -> tuple[float, dict[str, npt.NDArray[np.float64]]]:
    """The sum of a loss over views, and its derivatives, by reverse mode; each view is a task.

    Sums are of 64 bits, in the order of `views`: they don't depend on how many workers there are.

    Args:
        client: A `distributed.Client`.
        description: The scene's dict. It travels to a worker once; later calls with the same dict reuse it.
        parameters: The values of some parameters of `djpt.traverse`, by name, in place of the scene's: arrays.
        loss: Called on workers with an image (attached to the parameters) and the number of its view; gives a number
            on Dr.Jit's side, such as ``dr.mean(dr.square(image - targets[view]), axis=None)``. It travels with what
            it refers to, so keep target images small, or load them in it.
        views: The numbers of sensors: a minibatch.
        spp: As for `djpt.render`.
        seed: View number v is rendered with the seed of `djpt.rendering.progressive.rounds.round_seed` for v.

    Returns:
        The loss, and the derivatives by parameter, as float64 of the parameter's shape.

    Raises:
        BackendError: `distributed` is missing, or a worker has another version of djpt or Dr.Jit.
        ParameterError: `parameters` is empty, or one doesn't exist or can't have its value.
        RenderError: Arguments are out of range.
    """
    require_client(client)
    if not parameters:
        raise ParameterError("'parameters' must hold the parameters to differentiate with respect to, found none")
    if not views:
        raise RenderError("'views' must hold the number of at least one sensor, found none")
    spp, seed = check_count("spp", spp), check_seed("seed", seed)
    values = {key: np.array(value) for key, value in parameters.items()}

    def arguments(place: int) -> tuple[Any, ...]:
        view = int(views[place])
        return values, loss, view, spp, round_seed(seed, view)

    total = 0.0
    sums: dict[str, Any] = dict.fromkeys(values, 0.0)
    tasks = InOrder(client, Bundle.of(description), differentiated, arguments, warn)
    for value, derivatives in tasks.results(0, len(views)):
        total += value
        for key, derivative in derivatives.items():
            sums[key] = sums[key] + derivative.astype(np.float64)
    return total, sums

"""`render_passes`: renders that show what exists, stop when it is good, and go on later."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

from djpt.core.process.interruption import Interruption
from djpt.errors import RenderError
from djpt.integrators.base import Integrator
from djpt.rendering.arguments import check_count, check_seed, find_integrator
from djpt.rendering.image import channel_names
from djpt.rendering.progress import Progress
from djpt.rendering.progressive.accumulation import Accumulation, versions
from djpt.rendering.progressive.adaptive import AdaptiveAccumulation
from djpt.rendering.progressive.adaptive_rounds import AdaptiveRounds
from djpt.rendering.progressive.allocation import FIRST, is_survey
from djpt.rendering.progressive.even import EvenAccumulation
from djpt.rendering.progressive.fingerprint import fingerprint
from djpt.rendering.progressive.rounds import Rounds, round_seed
from djpt.scene.arguments import find_sensor
from djpt.scene.scene import Scene
from djpt.sensors import Sensor

__all__ = ["ROUND_SPP", "Goal", "render_passes"]

ROUND_SPP = 64
"""Samples per pixel of a round, unless fewer are asked for."""

ADAPTIVE_ROUNDS = 16
"""The rounds that an adaptive render of few samples is divided into."""

ADAPTIVE_SPP = 4
"""The samples per pixel of such a round at least."""

LEAST_ROUNDS = 4
"""The rounds that an error must come from to stop a render."""

SLOW = 2.0
"""Seconds of a round from which on it is watched pass by pass; quicker ones overlap with what Python does."""


@dataclass(frozen=True)
class Goal:
    """When a render stops: at whatever is reached first."""

    spp: int
    """Samples per pixel, those of an earlier render included; 0: no limit."""
    of_round: int
    """Samples per pixel of a whole round."""
    error: float | None
    """The relative RMSE: see `djpt.rendering.progressive.accumulation.Error`."""
    seconds: float | None
    """The time from the start of this render."""

    @property
    def rounds(self) -> int | None:
        """The number of rounds, a smaller one included; None: no limit."""
        return -(-self.spp // self.of_round) if self.spp else None

    def is_reached(self, found: Accumulation, elapsed: float, of_round: float) -> bool:
        """Whether a render is to stop after a round, when the next one takes about `of_round` seconds."""
        if self.spp and found.spp >= self.spp:
            return True
        if self.seconds is not None and elapsed + of_round > self.seconds:
            return True
        return self.error is not None and found.rounds >= LEAST_ROUNDS and found.error().overall <= self.error


def render_passes(
    scene: Scene,
    *,
    sensor: Any = 0,
    integrator: Any = None,
    seed: int = 0,
    spp: int = 0,
    round_spp: int = 0,
    target_error: float | None = None,
    time_budget: float | None = None,
    adaptive: bool = False,
    resume_from: Accumulation | None = None,
    schedule: str = "auto",
    progress: Progress | None = None,
    interruption: Interruption | None = None,
) -> Iterator[Accumulation]:
    """Render in rounds, and give what exists after each: a `djpt.Accumulation`. The last one is the result.

    Round r is the image of ``render(scene, spp=n, seed=s)`` with n = `round_spp`, in a last round what is left of
    `spp`, and with the seed s of `djpt.rendering.progressive.rounds.round_seed`; round 0 has the seed itself. So the
    image is a function of (scene, spp, seed, round_spp). Up to one round it is that of `render`, bit for bit; beyond,
    it has other samples than ``render(scene, spp=spp, seed=seed)``, whose numbers depend on `spp`, as in Mitsuba.

    A render that goes on has the bits of one that was asked for more from the start, for every sampler; a last round
    that is smaller is rendered anew then. Samplers of low discrepancy are stratified within each round, not from round
    to round.

    Args:
        scene: What `load_dict` returned.
        sensor: As for `render`.
        integrator: In place of the scene's.
        seed: Of the image, 0 <= seed < 2^32.
        spp: Samples per pixel; samplers may round up those of the last round. 0: no limit if there is another one,
            else the sampler's `sample_count`.
        round_spp: Samples per pixel of a round; 0 takes those of `resume_from`, else 64, or `spp` if that is less.
            Samplers may round it up.
        target_error: Stop when the relative RMSE is estimated to be less, after 4 rounds at least: 0.01 is 1 %.
        time_budget: Stop when the next round would end later than this many seconds after the start; one round
            is always rendered if none exists.
        adaptive: Take more samples in tiles of 8 x 8 pixels that have more noise, without bias: see
            `djpt.rendering.progressive.allocation`. The numbers of samples are means over the image then; `samples`
            says how many each pixel has. By default a round has a sixteenth of the `spp`; the first four are whole.
            Only integrators that follow paths from the camera can.
        resume_from: What to go on with: of the same scene, seed, sensor, integrator and schedule, by the same versions
            of djpt and Dr.Jit. If nothing is left to be done it is given as it is.
        schedule: As for `render`.
        progress: Called with (samples done, samples of the round) after each pass of rounds that take long.
        interruption: Signals that end a round after the pass at hand.

    Gradients of parameters are left alone. While a round is looked at, the next one may be running.

    Raises:
        RenderError: Arguments are out of range, `resume_from` is another render's, or the render can't be adaptive.
    """
    plan = planned(
        scene, sensor, integrator, seed, spp, round_spp, target_error, time_budget, adaptive, resume_from, schedule
    )
    kind = AdaptiveImage if adaptive else EvenImage
    image = kind(scene, plan.sensor, plan.integrator, plan.seed, plan.goal, schedule, progress, interruption)
    return rounds(begun(image, resume_from), plan.goal, image)


class Plan(NamedTuple):
    """A render in rounds, its arguments checked."""

    sensor: Sensor
    integrator: Integrator
    seed: int
    goal: Goal


def planned(
    scene: Scene,
    sensor: Any,
    integrator: Any,
    seed: int,
    spp: int,
    round_spp: int,
    target_error: float | None,
    time_budget: float | None,
    adaptive: bool,
    resume_from: Accumulation | None,
    schedule: str,
) -> Plan:
    """Check the arguments of `render_passes`, and replace those that were left out."""
    camera, estimator, seed = find_sensor(scene, sensor), find_integrator(scene, integrator), check_seed("seed", seed)
    spp, round_spp = check_count("spp", spp), check_count("round_spp", round_spp)
    for name, limit in (("target_error", target_error), ("time_budget", time_budget)):
        if limit is not None and not (isinstance(limit, (int, float)) and 0 < limit < math.inf):
            raise RenderError(f"'{name}' must be a number above 0, found {limit!r}")
    sampler = camera.sampler()
    if not spp and target_error is None and time_budget is None:
        spp = sampler.sample_count()
    of_round = sampler.round_count(round_spp or usual_spp(spp, adaptive))
    if resume_from is not None:
        current = fingerprint(scene, camera, estimator)
        require_resumable(resume_from, current, seed, round_spp and of_round, adaptive, schedule)
        of_round = resume_from.round_spp
    return Plan(camera, estimator, seed, Goal(spp, of_round, target_error, time_budget))


def usual_spp(spp: int, adaptive: bool) -> int:
    """The samples per pixel of a round, if nobody says how many."""
    if not (spp and adaptive):
        return min(spp or ROUND_SPP, ROUND_SPP)
    # The first rounds of an adaptive render are whole: small numbers must consist of them.
    least = ADAPTIVE_SPP if spp >= ADAPTIVE_SPP * FIRST or spp % ADAPTIVE_SPP == 0 else 1
    return min(max(least, -(-spp // ADAPTIVE_ROUNDS)), ROUND_SPP)


class Image(Protocol):
    """An image that is rendered in rounds."""

    @property
    def is_watched(self) -> bool:
        """Whether somebody waits for the ends of passes."""

    def empty(self) -> Any:
        """The accumulation of no rounds."""

    def begin(self, found: Any, number: int, watched: bool) -> Callable[[Any], Accumulation]:
        """Launch a round; the result waits for it and adds it to an accumulation.

        Args:
            found: What is known when the round begins.
            number: Of the round.
            watched: Whether progress is shown and signals are noticed meanwhile.
        """

    def overlaps(self, number: int) -> bool:
        """Whether the next round may begin before a round has ended."""

    def tell(self, found: Accumulation, number: int | None) -> None:
        """Tell the signals what share of all samples has been taken, and what share of them a round will be."""


@dataclass(frozen=True)
class RoundImage:
    """What all images in rounds consist of."""

    scene: Scene
    sensor: Sensor
    integrator: Integrator
    seed: int
    goal: Goal
    schedule: str
    progress: Progress | None
    interruption: Interruption | None

    @property
    def is_watched(self) -> bool:
        return self.progress is not None or self.interruption is not None

    @property
    def spp(self) -> int:
        """Samples per pixel of a whole round."""
        return self.goal.of_round

    def count(self, number: int) -> int:
        """Samples per pixel of a round: in the last one what is left."""
        return min(self.spp, self.goal.spp - number * self.spp) if self.goal.spp else self.spp

    def tell(self, found: Accumulation, number: int | None) -> None:
        if self.interruption is not None:
            limit = self.goal.spp
            share = found.spp / limit if limit else None
            self.interruption.begin_part(share, self.count(number) / limit if limit and number is not None else 0)

    def watch(self, watched: bool) -> tuple[Progress | None, Interruption | None]:
        """Who is told of passes."""
        return (self.progress, self.interruption) if watched else (None, None)

    def description(self) -> tuple[dict[str, str], tuple[str, ...], int]:
        """The fingerprint, the names of the channels, and how many of them come from the centres of pixels."""
        scene, sensor, integrator = self.scene, self.sensor, self.integrator
        constant = len(integrator.unfiltered_names())
        return fingerprint(scene, sensor, integrator), channel_names(scene, sensor, integrator), constant


class EvenImage(RoundImage):
    """An image whose pixels all have the same number of samples."""

    @cached_property
    def _rounds(self) -> Rounds:
        return Rounds(self.scene, self.sensor, self.integrator, self.spp, self.schedule)

    def empty(self) -> EvenAccumulation:
        width, height = self.sensor.film().crop_size()
        return EvenAccumulation.empty(*self.description(), (int(width), int(height)), self.spp, self.schedule)

    def count(self, number: int) -> int:
        return self.sensor.sampler().round_count(super().count(number))

    def begin(self, found: EvenAccumulation, number: int, watched: bool) -> Callable[[Any], Accumulation]:
        seed, count = round_seed(self.seed, number), self.count(number)
        result = self._rounds.begin(seed, *self.watch(watched), count)
        return lambda found: found.with_round(seed, count, result())

    def overlaps(self, number: int) -> bool:
        # Larger ones would take the memory twice.
        return self._rounds.small


class AdaptiveImage(RoundImage):
    """An image that has more samples where there is more noise."""

    @cached_property
    def _rounds(self) -> AdaptiveRounds:
        return AdaptiveRounds(self.scene, self.sensor, self.integrator, self.spp, self.schedule)

    def empty(self) -> AdaptiveAccumulation:
        return AdaptiveAccumulation.empty(*self.description(), self._rounds.tiles, self.spp, self.schedule)

    def count(self, number: int) -> int:
        # Each half must know all tiles before a round can leave some out.
        return self.spp if number < FIRST else super().count(number)

    def begin(self, found: AdaptiveAccumulation, number: int, watched: bool) -> Callable[[Any], Accumulation]:
        seed, count = round_seed(self.seed, number), self.count(number)
        result = self._rounds.begin(self.seed, number, found.places(number, count), *self.watch(watched))
        return lambda found: found.with_round(seed, count, result())

    def overlaps(self, number: int) -> bool:
        # What the next round samples follows from the surveys, and from the counts of its own half.
        # Large ones would take the memory twice.
        return self._rounds.small and not is_survey(number)


def rounds(found: Accumulation, goal: Goal, image: Image) -> Iterator[Accumulation]:
    """The accumulations after each round until a goal is reached, one at least."""
    start = before = time.perf_counter()
    of_round, waiting = 0.0, None
    # Nobody knows yet how long a round takes. Unless that matters, the second one is traced while the first runs.
    matters = image.is_watched or goal.seconds is not None
    if found.rounds and goal.is_reached(found, 0.0, 0.0):
        yield found
        return
    found = found.whole
    for number in itertools.count(found.rounds):
        image.tell(found, number)
        result = waiting or image.begin(found, number, of_round > SLOW or not of_round)
        waiting = None
        elapsed = time.perf_counter() - start
        quick = of_round <= SLOW and (of_round > 0 or not matters)
        ahead = quick and (goal.rounds is None or number + 1 < goal.rounds)
        if ahead and image.overlaps(number) and (goal.seconds is None or elapsed + 2 * of_round <= goal.seconds):
            waiting = image.begin(found, number + 1, False)
        found = result(found)
        image.tell(found, None)
        now = time.perf_counter()
        of_round, before = max(now - before, 1e-6), now
        yield found
        if goal.is_reached(found, time.perf_counter() - start, of_round):
            return


def begun(image: Image, resume_from: Accumulation | None) -> Any:
    """What an image begins with: no rounds, or those of an earlier render.

    Raises:
        RenderError: Their arrays aren't those of the image, whatever its fingerprint says.
    """
    empty = image.empty()
    if resume_from is None:
        return empty
    for name in ("channels", "size", "layout"):
        if getattr(resume_from, name) != getattr(empty, name):
            expected, stored = getattr(empty, name), getattr(resume_from, name)
            raise RenderError(f"the render can't go on: its {name} is {stored}, not {expected}")
    return resume_from


def require_resumable(
    found: Accumulation, current: dict[str, str], seed: int, round_spp: int, adaptive: bool, schedule: str
) -> None:
    """Raise `RenderError` unless an accumulation is the beginning of a render."""
    problem = "the render can't go on"
    found.require_same(versions(), current, problem)
    if isinstance(found, AdaptiveAccumulation) != adaptive:
        raise RenderError(f"{problem}: it was {'not ' if adaptive else ''}begun with adaptive=True")
    if round_spp and round_spp != found.round_spp:
        raise RenderError(f"{problem}: its rounds have {found.round_spp} spp, 'round_spp' is {round_spp}")
    if found.seeds != tuple(round_seed(seed, number) for number in range(found.rounds)):
        reason = f"its seed is {found.seeds[0]}, not {seed}" if found.seeds[0] != seed else "it has several seeds"
        raise RenderError(f"{problem}: {reason}")
    if any(count != found.round_spp for count in found.whole.counts):
        raise RenderError(f"{problem}: it has rounds of {found.round_spp} spp and of {min(found.counts)} spp")
    if schedule != found.schedule:
        raise RenderError(f"{problem}: its schedule is '{found.schedule}', not '{schedule}'")

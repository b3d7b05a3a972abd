"""`render_passes`: renders that show partial images, stop once these are good enough, and can be continued later."""

from __future__ import annotations

import itertools
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from djpt.core.interruption import Interruption
from djpt.errors import RenderError
from djpt.jit.frozen import recording
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.leaves import attached_parameters
from djpt.rendering.image import channel_names
from djpt.rendering.progress import Progress
from djpt.rendering.progressive.accumulation import Accumulation, AdaptiveAccumulation, EvenAccumulation
from djpt.rendering.progressive.adaptive_rounds import AdaptiveRounds
from djpt.rendering.progressive.checkpoint import fingerprint, versions
from djpt.rendering.progressive.rounds import Rounds, round_seed
from djpt.rendering.progressive.tiles import FIRST, is_survey
from djpt.rendering.settings import RenderSettings, check_count
from djpt.scene.scene import Scene

__all__ = ["ROUND_SPP", "EvenImage", "Goal", "adaptive_image", "begun", "render_passes", "rounds"]

ROUND_SPP = 64
"""Samples per pixel of a round, unless fewer are asked for."""

ADAPTIVE_ROUNDS = 16
"""The rounds that an adaptive render of few samples is divided into."""

ADAPTIVE_SPP = 4
"""The samples per pixel of such a round at least."""

LEAST_ROUNDS = 4
"""The minimum number of rounds behind an error that stops a render."""

SLOW = 2.0
"""Seconds above which a round is watched pass by pass; quicker ones overlap with Python's work."""


@dataclass(frozen=True)
class Goal:
    """The conditions for a render to stop: whichever is reached first."""

    spp: int
    """Samples per pixel, those of an earlier render included; 0: no limit."""
    of_round: int
    """Samples per pixel of a whole round."""
    error: float | None
    """The relative RMSE: see `djpt.rendering.progressive.accumulation.Error`."""
    seconds: float | None
    """The time from the start of this render."""

    @classmethod
    def of(
        cls,
        settings: RenderSettings,
        round_spp: Any = 0,
        target_error: float | None = None,
        time_budget: float | None = None,
        adaptive: bool = False,
    ) -> Goal:
        """The goal of a render with the arguments of `render_passes`.

        Raises:
            RenderError: They are out of range.
        """
        round_spp = check_count("round_spp", round_spp)
        for name, limit in (("target_error", target_error), ("time_budget", time_budget)):
            if limit is not None and not (isinstance(limit, (int, float)) and 0 < limit < math.inf):
                raise RenderError(f"'{name}' must be a number above 0, found {limit!r}")
        spp, sampler = settings.spp, settings.sensor.sampler()
        if not spp and target_error is None and time_budget is None:
            spp = sampler.sample_count()
        return cls(spp, sampler.round_count(round_spp or usual_spp(spp, adaptive)), target_error, time_budget)

    @property
    def rounds(self) -> int | None:
        """The number of rounds, a smaller one included; None: no limit."""
        return -(-self.spp // self.of_round) if self.spp else None

    def is_reached(self, found: Accumulation, elapsed: float, of_round: float) -> bool:
        """True if a render is to stop after a round, if the next one takes about `of_round` seconds."""
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
    """Render in rounds, and yield the result so far after each: a `djpt.Accumulation`. The last one is final.

    Round r is the image of ``render(scene, spp=n, seed=s)`` with n = `round_spp`, in a last round the rest of
    `spp`, and with the seed s of `djpt.rendering.progressive.rounds.round_seed`; round 0 has the seed itself. So the
    image is a function of (scene, spp, seed, round_spp). Up to one round it is that of `render`, bit for bit; beyond,
    it has other samples than ``render(scene, spp=spp, seed=seed)``, whose numbers depend on `spp`, as in Mitsuba.

    A continued render has the bits of one with more samples from the start, for every sampler; a last round that is
    smaller is then rendered again in full. Samplers of low discrepancy are stratified within each round, not from round
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
            `djpt.rendering.progressive.tiles`. The numbers of samples are means over the image then; `samples`
            says how many each pixel has. By default a round has a sixteenth of the `spp`; the first four are whole.
            Only integrators that follow paths from the camera can.
        resume_from: The accumulation to continue from: of the same scene, seed, sensor, integrator and schedule, by the
            same versions of djpt and Dr.Jit. If nothing is left to do, it is yielded as it is.
        schedule: As for `render`.
        progress: Called with (samples done, samples of the round) after each pass of rounds that take long.
        interruption: Signals that end a round after the pass at hand.

    Gradients of parameters are left alone. While a result is being used, the next round may already be running.

    Raises:
        RenderError: Arguments are out of range, `resume_from` is another render's, or the render can't be adaptive.
    """
    settings = replace(
        RenderSettings.of(scene, sensor, integrator, seed=seed, spp=spp, schedule=schedule),
        progress=progress,
        interruption=interruption,
    )
    if resume_from is not None:
        round_spp = round_spp or resume_from.round_spp
    goal = Goal.of(settings, round_spp, target_error, time_budget, adaptive)
    image = (AdaptiveImage if adaptive else EvenImage)(scene, settings, goal)
    return rounds(begun(image, resume_from), goal, image)


def adaptive_image(scene: Scene, settings: RenderSettings) -> TensorXf:
    """The image of `render` with ``adaptive=True``; the film keeps it, too.

    Raises:
        RenderError: Gradients are enabled, a frozen function is recorded, or the integrator can't render adaptively.
    """
    if recording():
        raise RenderError("a frozen function can't render adaptively: the host decides where samples are taken")
    if attached_parameters(scene):
        raise RenderError(
            "adaptive images have no derivatives: render with adaptive=False, or without gradients enabled"
        )
    film = settings.sensor.film()
    names = channel_names(scene, settings.sensor, settings.integrator)
    goal = Goal.of(settings, adaptive=True)
    progress, interruption = settings.progress, settings.interruption
    # Rounds are short: nobody is told of their passes.
    image = AdaptiveImage(scene, replace(settings, progress=None, pass_spp=0), goal)
    width, height = film.crop_size()
    for found in rounds(begun(image, None), goal, image):
        if progress is not None:
            progress(min(found.spp, goal.spp) * width * height, goal.spp * width * height)
        if interruption is not None and interruption.requested:
            break
    result = found.image()
    film.keep(result, names)
    return result


def usual_spp(spp: int, adaptive: bool) -> int:
    """The default samples per pixel of a round."""
    if not (spp and adaptive):
        return min(spp or ROUND_SPP, ROUND_SPP)
    # The first rounds of an adaptive render are whole: small numbers must consist of them.
    least = ADAPTIVE_SPP if spp >= ADAPTIVE_SPP * FIRST or spp % ADAPTIVE_SPP == 0 else 1
    return min(max(least, -(-spp // ADAPTIVE_ROUNDS)), ROUND_SPP)


@dataclass(frozen=True)
class RoundImage(ABC):
    """An image that is rendered in rounds."""

    scene: Scene
    settings: RenderSettings
    goal: Goal

    kind: ClassVar[type[Accumulation]]
    """The class of its accumulations."""

    @abstractmethod
    def empty(self) -> Any:
        """The accumulation of no rounds."""

    @abstractmethod
    def begin(self, found: Any, number: int, watched: bool) -> Callable[[Any], Accumulation]:
        """Launch a round; the result waits for it and adds it to an accumulation.

        Args:
            found: The accumulation when the round begins.
            number: Of the round.
            watched: True if progress is shown and signals are noticed meanwhile.
        """

    @abstractmethod
    def overlaps(self, number: int) -> bool:
        """True if the next round may begin before a round has ended."""

    @cached_property
    def fingerprint(self) -> dict[str, str]:
        """The fingerprint: see `djpt.rendering.progressive.checkpoint`."""
        return fingerprint(self.scene, self.settings.sensor, self.settings.integrator)

    @property
    def of_rounds(self) -> RenderSettings:
        """The settings of whole rounds."""
        return replace(self.settings, spp=self.goal.of_round)

    def count(self, number: int) -> int:
        """Samples per pixel of a round: in the last one the rest."""
        whole, limit = self.goal.of_round, self.goal.spp
        return min(whole, limit - number * whole) if limit else whole

    def tell(self, found: Accumulation, number: int | None) -> None:
        """Tell the signals what fraction of all samples has been taken, and what fraction of them a round will be."""
        interruption, limit = self.settings.interruption, self.goal.spp
        if interruption is not None:
            share = found.spp / limit if limit else None
            interruption.begin_part(share, self.count(number) / limit if limit and number is not None else 0)

    def description(self) -> tuple[dict[str, str], tuple[str, ...], int]:
        """The fingerprint, the names of the channels, and how many of them come from the centres of pixels."""
        sensor, integrator = self.settings.sensor, self.settings.integrator
        return self.fingerprint, channel_names(self.scene, sensor, integrator), len(integrator.unfiltered_names())


class EvenImage(RoundImage):
    """An image whose pixels all have the same number of samples."""

    kind = EvenAccumulation

    @cached_property
    def _rounds(self) -> Rounds:
        return Rounds(self.scene, self.of_rounds)

    def empty(self) -> EvenAccumulation:
        (width, height), of_round = self.settings.sensor.film().crop_size(), self.goal.of_round
        size = int(width), int(height)
        return EvenAccumulation.empty(*self.description(), size, of_round, self.settings.schedule)

    def count(self, number: int) -> int:
        return self.settings.sensor.sampler().round_count(super().count(number))

    def begin(self, found: EvenAccumulation, number: int, watched: bool) -> Callable[[Any], Accumulation]:
        seed, count = round_seed(self.settings.seed, number), self.count(number)
        result = self._rounds.begin(seed, count, watched)
        return lambda found: found.with_round(seed, count, result())

    def overlaps(self, number: int) -> bool:
        # Larger ones would take the memory twice.
        return self._rounds.small


class AdaptiveImage(RoundImage):
    """An image that has more samples where there is more noise."""

    kind = AdaptiveAccumulation

    @cached_property
    def _rounds(self) -> AdaptiveRounds:
        return AdaptiveRounds(self.scene, self.of_rounds)

    def empty(self) -> AdaptiveAccumulation:
        tiles, of_round = self._rounds.tiles, self.goal.of_round
        return AdaptiveAccumulation.empty(*self.description(), tiles, of_round, self.settings.schedule)

    def count(self, number: int) -> int:
        # Each half must know all tiles before a round can leave some out.
        return self.goal.of_round if number < FIRST else super().count(number)

    def begin(self, found: AdaptiveAccumulation, number: int, watched: bool) -> Callable[[Any], Accumulation]:
        seed, count = round_seed(self.settings.seed, number), self.count(number)
        result = self._rounds.begin(number, found.places(number, count), watched)
        return lambda found: found.with_round(seed, count, result())

    def overlaps(self, number: int) -> bool:
        # What the next round samples follows from the surveys, and from the counts of its own half.
        # Large ones would take the memory twice.
        return self._rounds.small and not is_survey(number)


def rounds(found: Accumulation, goal: Goal, image: RoundImage) -> Iterator[Accumulation]:
    """The accumulations after each round until a goal is reached, one at least."""
    start = before = time.perf_counter()
    of_round, waiting = 0.0, None
    # Nobody knows yet how long a round takes. Unless that matters, the second one is traced while the first runs.
    matters = image.settings.is_watched or goal.seconds is not None
    if found.rounds and goal.is_reached(found, 0.0, 0.0):
        yield found
        return
    found = found.whole
    for number in itertools.count(found.rounds):
        image.tell(found, number)
        watched = image.settings.is_watched and (of_round > SLOW or not of_round)
        result = waiting or image.begin(found, number, watched)
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


def begun(image: RoundImage, resume_from: Accumulation | None) -> Any:
    """The initial accumulation of an image: no rounds, or those of an earlier render.

    Raises:
        RenderError: They belong to another render. The arrays must fit the image, too, whatever its fingerprint.
    """
    if resume_from is not None:
        require_resumable(image, resume_from)
    empty = image.empty()
    if resume_from is None:
        return empty
    for name in ("channels", "size", "layout"):
        if getattr(resume_from, name) != getattr(empty, name):
            expected, stored = getattr(empty, name), getattr(resume_from, name)
            raise RenderError(f"the render can't continue: its {name} is {stored}, not {expected}")
    return resume_from


def require_resumable(image: RoundImage, found: Accumulation) -> None:
    """Raise `RenderError` unless an accumulation is the beginning of an image."""
    problem = "the render can't continue"
    found.require_same(versions(), image.fingerprint, problem)
    seed, round_spp, schedule = image.settings.seed, image.goal.of_round, image.settings.schedule
    if not isinstance(found, image.kind):
        negated = "" if isinstance(found, AdaptiveAccumulation) else "not "
        raise RenderError(f"{problem}: it was {negated}begun with adaptive=True")
    if round_spp != found.round_spp:
        raise RenderError(f"{problem}: its rounds have {found.round_spp} spp, 'round_spp' is {round_spp}")
    if found.seeds != tuple(round_seed(seed, number) for number in range(found.rounds)):
        reason = f"its seed is {found.seeds[0]}, not {seed}" if found.seeds[0] != seed else "it has several seeds"
        raise RenderError(f"{problem}: {reason}")
    if any(count != found.round_spp for count in found.whole.counts):
        raise RenderError(f"{problem}: it has rounds of {found.round_spp} spp and of {min(found.counts)} spp")
    if schedule != found.schedule:
        raise RenderError(f"{problem}: its schedule is '{found.schedule}', not '{schedule}'")

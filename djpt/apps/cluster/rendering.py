"""Renders in rounds, and gradients, on many machines."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.apps.cluster.tasks import InOrder, require_client, warn
from djpt.apps.cluster.work import Bundle, differentiated, rendered
from djpt.core.numeric import whole
from djpt.errors import ParameterError, RenderError
from djpt.rendering.progressive.accumulation import Accumulation, EvenAccumulation
from djpt.rendering.progressive.passes import EvenImage, Goal, begun, rounds
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.settings import RenderSettings, check_count, check_seed

__all__ = ["gradient", "render_passes"]


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
    try:
        yield from images
    finally:
        results.close()


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

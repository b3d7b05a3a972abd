"""`render_passes` on many machines."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from djpt.apps.cluster.bundle import Bundle
from djpt.apps.cluster.tasks import InOrder, require_client, warn
from djpt.apps.cluster.work import rendered
from djpt.core.numeric import whole
from djpt.errors import RenderError
from djpt.rendering.progressive.accumulation import Accumulation, EvenAccumulation
from djpt.rendering.progressive.passes import EvenImage, Goal, begun, rounds
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.settings import RenderSettings

__all__ = ["render_passes"]


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

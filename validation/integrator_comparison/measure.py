"""Time, error, bias and error floor of every integrator that suits a scene.

Each image is compared with a reference r, the mean of independent batches, whose own noise is known from their spread
and taken out of the numbers. With <.> the mean over pixels and channels, and var r the variance of that mean:

    RMSE^2  = <(a - r)^2> - <var r>          of the image a,
    floor^2 = <(a - r)(b - r)> - <var r>     of two independent images a and b: the error that samples don't remove,
    bias    = <a> - <r>                      with its standard error, from all images of the integrator.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.description.loader import load_dict
from djpt.errors import DjptError, RenderError, near_miss
from djpt.rendering.progress import Progress
from djpt.rendering.render import render
from djpt.rendering.schedules.job import MAX_SAMPLES
from djpt.scene.scene import Scene
from djpt.scenes.overrides import described, override
from djpt.validation.bridge import mitsuba_renderer
from djpt.validation.integrator_comparison.steps import STEPS, Step
from djpt.validation.metrics import pair
from djpt.validation.statistics import Batches

__all__ = ["BATCHES", "Ladder", "Measured", "Point", "Reference", "colors", "measure", "seeds"]

Pixels = npt.NDArray[np.float64]

REFERENCES = ("own", "mitsuba")

BATCHES = 16
"""Independent images that the reference is the mean of."""

NEIGHBOURS = 4
"""The number of neighbouring pixels that usual filters make depend on each other."""

REFERENCE_SHARE = 0.5
"""Time of one batch of the reference, as a share of the time of an integrator."""


@dataclass(frozen=True)
class Point:
    """One image of an integrator: samples per pixel, time without compilation, error."""

    spp: int
    seconds: float
    rmse: float


@dataclass(frozen=True)
class Measured:
    """The results of a step."""

    step: Step
    missing: str
    """The light of this scene that the step can't show; empty: none."""
    points: tuple[Point, ...]
    """The images by increasing numbers of samples; the last one is `image`."""
    image: Pixels
    bias: float
    bias_error: float
    """The standard error of `bias`; NaN if there is only one point."""
    floor: float
    """The error that more samples don't remove; 0 if it can't be told from noise."""
    compile_seconds: float
    """Time that the backend took to compile the kernels; 0 if they were in the cache on disk."""
    samples: int
    """The number of samples of the last image: samples per pixel times pixels."""
    notes: tuple[str, ...]
    """The warnings of `render`."""

    @property
    def last(self) -> Point:
        """The point of the last image, which took all of the given time."""
        return self.points[-1]

    @property
    def speed(self) -> float:
        """The number of samples per second."""
        return self.samples / self.last.seconds

    @property
    def at_floor(self) -> bool:
        """True if more samples won't remove most of the last image's error."""
        return self.floor > 0.5 * self.last.rmse

    def seconds_to(self, rmse: float) -> float:
        """The time to an error of `rmse`, by error = sqrt(floor^2 + c / time); infinite if it is below the floor."""
        floor = self.floor if self.at_floor else 0.0
        if rmse <= floor:
            return math.inf
        return self.last.seconds * max(self.last.rmse**2 - floor**2, 0.0) / (rmse**2 - floor**2)


@dataclass(frozen=True)
class Refused:
    """A step that doesn't suit the scene."""

    step: Step
    reason: str


@dataclass(frozen=True)
class Reference:
    """The image that all others are compared with."""

    title: str
    missing: str
    """The light of this scene that the reference can't show; images that show it seem to have an error."""
    image: Pixels
    variance: float
    """The variance of `image`, mean over pixels and channels."""
    mean_error: float
    """The standard error of the image's mean over pixels and channels."""
    spp: int
    seconds: float
    compile_seconds: float
    notes: tuple[str, ...]

    @property
    def noise(self) -> float:
        """The RMSE of the reference itself, by its noise."""
        return math.sqrt(self.variance)


@dataclass(frozen=True)
class Ladder:
    """The results of `measure`."""

    name: str
    seconds: float | None
    """Time per integrator in seconds, or None if `spp` was given."""
    spp: int | None
    reference: Reference
    measured: tuple[Measured, ...]
    refused: tuple[Refused, ...]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.reference.image.shape[1], self.reference.image.shape[0]


def measure(
    scene: Mapping[str, Any] | str,
    seconds: float = 10.0,
    spp: int | None = None,
    reference: str = "own",
    *,
    reference_spp: int | None = None,
    width: int | None = None,
    seed: int = 0,
    name: str | None = None,
    progress: Progress | None = None,
) -> Ladder:
    """Render `scene` with all steps of the ladder at equal time, or at equal samples per pixel.

    Args:
        scene: A dict of Mitsuba's schema, a built-in name, or a scene file. Its integrator says how long paths are.
        seconds: Time for the largest image of an integrator; smaller ones, of 1, 2, 4, .. spp, take as much once more.
        spp: Samples per pixel of the largest image, instead of `seconds`.
        reference: `own` (djpt's `path`, other seeds) or `mitsuba` (Mitsuba's `path`).
        reference_spp: Samples per pixel of the reference (default: 16 times what its renderer does in half of the time,
            or 16 times `spp`), rounded up to 16 equal parts.
        width: Pixels, instead of the scene's; the image keeps its shape.
        seed: Changes all seeds.
        name: Name of the scene, instead of its own.
        progress: Called with (integrators done, integrators in all); the reference is one more.

    Raises:
        SceneError: The scene is wrong.
        RenderError: Arguments out of range, or the reference can't be rendered.
        BackendError: Mitsuba isn't installed.
    """
    if reference not in REFERENCES:
        raise RenderError(f"unknown reference '{reference}'{near_miss(reference, REFERENCES)}")
    for key, value in (("seconds", seconds), ("spp", spp), ("reference_spp", reference_spp)):
        if value is not None and not value > 0:
            raise RenderError(f"'{key}' must be greater than 0, found {value!r}")
    own_name, description = described(scene)
    description = override(description, width=width)
    loaded = load_dict(description)
    budget = Budget(seconds, spp, most_spp(loaded))
    counted = progress or (lambda done, total: None)
    goal = reference_image(reference, description, loaded, budget, reference_spp, seed)
    counted(1, len(STEPS) + 1)
    measured, refused = [], []
    for i, step in enumerate(STEPS):
        try:
            measured.append(measure_step(step, loaded, goal, budget, seeds(seed, i + 1)))
        except DjptError as error:
            refused.append(Refused(step, " ".join(str(error).split())))
        counted(i + 2, len(STEPS) + 1)
    return Ladder(name or own_name, None if spp else seconds, spp, goal, tuple(measured), tuple(refused))


# ---- one integrator ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Budget:
    """The limit of an integrator's samples: by time, or by number."""

    seconds: float
    spp: int | None
    most: int
    """Most samples per pixel of one render."""

    def counts(self, took: Callable[[], float]) -> Iterator[int]:
        """The samples per pixel to take: 1, 2, 4, .. and at last as many as fit; `took` gives the time of the last."""
        limit = min(self.spp or self.most, self.most)
        spp = 1
        while True:
            yield spp
            share = 2.0 if self.spp else self.seconds / took()
            following = min(int(spp * min(share, 2.0)), limit)
            # A smaller increase isn't worth another image.
            if following <= spp or (following < 1.2 * spp and not self.spp):
                return
            spp = following


@dataclass(frozen=True)
class Render:
    """One image, with the time that it took and the warnings."""

    image: Pixels
    seconds: float
    compile_seconds: float
    notes: tuple[str, ...]


def measure_step(step: Step, scene: Scene, goal: Reference, budget: Budget, seed: Iterator[int]) -> Measured:
    """Render all images of one integrator, and compare them with the reference."""
    integrator = load_dict(step.description(scene))
    sampler = scene.sensors()[0].sampler()
    first = rendered(scene, integrator, 1, next(seed))
    points: list[Point] = []
    means: list[float] = []
    before = image = first.image
    for asked in budget.counts(lambda: points[-1].seconds):
        spp = sampler.round_count(asked)
        if points and spp <= points[-1].spp:
            continue
        shot = rendered(scene, integrator, spp, next(seed))
        before, image = image, shot.image
        points.append(Point(spp, shot.seconds, shared_error(image, image, goal)))
        means.append(float(image.mean()))
    # The mean of an image of n samples per pixel has the variance v / n: v is estimated from all images together.
    several, weights = len(points) > 1, np.array([point.spp for point in points], float)
    mean = float(np.average(means, weights=weights))
    v = float(weights @ np.square(np.array(means) - mean)) / (len(points) - 1) if several else math.nan
    return Measured(
        step=step,
        missing=step.missing(scene),
        points=tuple(points),
        image=image,
        bias=mean - float(goal.image.mean()),
        bias_error=math.sqrt(v / weights.sum() + goal.mean_error**2),
        floor=error_floor(before, image, (points[-2].spp, points[-1].spp), goal) if several else 0.0,
        compile_seconds=max(first.compile_seconds, goal.compile_seconds if step.title == goal.title else 0.0),
        samples=points[-1].spp * image.shape[0] * image.shape[1],
        notes=first.notes,
    )


def rendered(scene: Scene, integrator: Any, spp: int, seed: int) -> Render:
    """Render an image, and measure compilation and computation apart."""
    with warnings.catch_warnings(record=True) as caught, dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        warnings.simplefilter("always")
        dr.kernel_history_clear()
        start = time.perf_counter()
        image = np.array(render(scene, integrator=integrator, spp=spp, seed=seed), np.float64)
        seconds = time.perf_counter() - start
        compiling = sum(kernel.get("backend_time", 0.0) for kernel in dr.kernel_history()) / 1000
    notes = tuple(dict.fromkeys(str(warning.message) for warning in caught))
    return Render(colors(image), max(seconds - compiling, 1e-6), compiling, notes)


def colors(image: Pixels) -> Pixels:
    """Drop the alpha channel."""
    return image[..., : {2: 1, 4: 3}.get(image.shape[2], image.shape[2])]


def shared_error(a: Pixels, b: Pixels, goal: Reference) -> float:
    """The error sqrt(<(a - r)(b - r)> - <var r>) that two images share, or 0 if the square isn't positive."""
    (a, r), (b, r) = pair(a, goal.image), pair(b, goal.image)
    return math.sqrt(max(float(np.mean((a - r) * (b - r))) - goal.variance, 0.0))


def error_floor(a: Pixels, b: Pixels, spp: tuple[int, int], goal: Reference) -> float:
    """The `shared_error` of two independent images of `spp` samples per pixel, or 0 if noise alone could be the cause.

    Without a floor the products of their errors have the variance v_a v_b, where v_a + v_b is that of a - b, and
    v_a / v_b = n_b / n_a. Of normal deviates with variance v the fourth moment is 3 v^2.
    """
    fourth = np.square(np.mean(np.square(a - b), axis=2))
    product = fourth.sum() / 3 * spp[0] * spp[1] / (spp[0] + spp[1]) ** 2
    deviation = math.sqrt(product * NEIGHBOURS) / fourth.size
    floor = shared_error(a, b, goal)
    return floor if floor**2 > 4 * deviation else 0.0


# ---- the reference -----------------------------------------------------------------------------


def reference_image(
    kind: str, description: dict[str, Any], scene: Scene, budget: Budget, spp: int | None, seed: int
) -> Reference:
    """Render the reference: the mean of `BATCHES` images of `path`."""
    step = next(step for step in STEPS if step.title == "path")
    integrator = step.description(scene)
    random = seeds(seed, 0)
    render_batch: Callable[[int, int], Render]
    if kind == "own":
        plugin = load_dict(integrator)
        first = rendered(scene, plugin, 1, next(random))

        def render_batch(spp: int, seed: int) -> Render:
            return rendered(scene, plugin, spp, seed)
    else:
        theirs = mitsuba_renderer(override(description, integrator=integrator))

        def render_batch(spp: int, seed: int) -> Render:
            start = time.perf_counter()
            image = colors(theirs(spp, seed).astype(np.float64))
            return Render(image, time.perf_counter() - start, 0.0, ())

        first = render_batch(1, next(random))
    if spp:
        size = -(-spp // BATCHES)
    elif budget.spp:
        size = budget.spp
    else:
        took = [first.seconds]
        for size in Budget(budget.seconds * REFERENCE_SHARE, None, budget.most).counts(lambda: took[-1]):
            took.append(render_batch(size, next(random)).seconds)
    size = scene.sensors()[0].sampler().round_count(size)
    batches, means, seconds = Batches(), [], 0.0
    for _ in range(BATCHES):
        batch = render_batch(size, next(random))
        batches.add(batch.image)
        means.append(float(batch.image.mean()))
        seconds += batch.seconds
    return Reference(
        title="path" if kind == "own" else "path, Mitsuba",
        missing=step.missing(scene),
        image=batches.mean,
        variance=float(batches.variance_of_mean().mean()),
        mean_error=float(np.std(means, ddof=1) / math.sqrt(BATCHES)),
        spp=size * BATCHES,
        seconds=seconds,
        compile_seconds=first.compile_seconds,
        notes=first.notes,
    )


def most_spp(scene: Scene) -> int:
    """The number of samples per pixel that one render can take."""
    if not scene.sensors():
        raise RenderError("the scene has no sensor: add one, for example {'type': 'perspective'}")
    film = scene.sensors()[0].film()
    width, height = (n + 2 * film.border for n in film.crop_size())
    return max(1, MAX_SAMPLES // (width * height) // 2)


def seeds(seed: int, stream: int) -> Iterator[int]:
    """An endless sequence of seeds, other than those of other streams but by chance."""
    for number in np.random.SeedSequence([seed, stream]).generate_state(256):
        yield int(number)

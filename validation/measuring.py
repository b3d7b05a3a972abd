"""The renders of a comparison, in batches with seeds of their own, and what they are measured by."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.rendering.progress import Progress
from djpt.validation import metrics
from djpt.validation.bridge import Renderer
from djpt.validation.comparands import Comparand
from djpt.validation.comparison import Agreement, Comparison, agreement
from djpt.validation.metrics import ComparisonError
from djpt.validation.references import Reference
from djpt.validation.statistics import Batches, block_test, mean_test, noise_ratio, pixel_test, weighted_test, z_map

__all__ = ["OUR_SEEDS", "THEIR_SEEDS", "Rendering", "compared", "plan"]

OUR_SEEDS, THEIR_SEEDS = 0, 1
"""The streams of seeds of the two sides; references have the second one."""


class Rendering:
    """A renderer with its batches, times and seeds."""

    def __init__(self, renderer: Renderer, spp: int, count: int, seed: int, stream: int) -> None:
        self.renderer, self.spp, self.count = renderer, spp, count
        # With seeds that both sides share their noise would be correlated, and the tests too lenient.
        self.seeds = np.random.SeedSequence([seed, stream]).generate_state(count)
        self.batches = Batches()
        self.times: list[float] = []

    def render(self, k: int) -> None:
        """Render batch `k`."""
        start = time.perf_counter()
        image = self.renderer(self.spp, int(self.seeds[k]))
        self.times.append(time.perf_counter() - start)
        self.batches.add(image)

    @property
    def seconds(self) -> float:
        """The median time of a batch, without the first one, which compiles kernels."""
        return float(np.median(self.times[1:] or self.times))


class Shown:
    """The measurements of one side's image."""

    def __init__(self, side: Comparand, rendering: Rendering | None) -> None:
        self.facts: dict[str, Any] = dict(side.facts)
        self.batches: Batches | None = None
        self.spp, self.seconds = 0, 0.0
        if rendering is not None:
            self.batches, self.seconds = rendering.batches, rendering.seconds
            self.spp = rendering.spp * rendering.count
            self.facts["seeds"] = [int(seed) for seed in rendering.seeds]
        elif side.reference is not None:
            self.batches = side.reference.batches
            self.spp = side.reference.batch_spp * self.batches.count
            self.facts["seeds"] = list(side.reference.seeds)
        if self.batches is not None:
            self.facts |= {"batches": self.batches.count, "samples per pixel": self.spp}
            self.image: npt.NDArray[Any] = self.batches.mean
        else:
            self.image = stored(side)


def compared(
    a: Comparand,
    b: Comparand,
    *,
    name: str,
    spp: int,
    reference_spp: int | None,
    seed: int,
    significance: float,
    tests: bool,
    batches: int,
    same_seed_spp: int,
    same_estimator: bool,
    independent_pixels: bool,
    limits: Mapping[str, float],
    progress: Progress | None,
) -> Comparison:
    """Render what has to be rendered, and compare: the arguments are those of `djpt.validation.compare.compare`.

    `same_estimator`: both have the same variance. `independent_pixels`: pixels share no samples.
    """
    first, second = rendered(a, b, spp, reference_spp, batches, seed)
    rendering = [each for each in (first, second) if each is not None]
    paired = a.renderer is not None and b.renderer is not None and same_seed_spp > 0
    done, total = 0, sum(each.count for each in rendering) + (2 if paired else 0)
    # In turn, so that other load on the machine slows both.
    for k in range(max((each.count for each in rendering), default=0)):
        for each in rendering:
            if k < each.count:
                each.render(k)
                done += 1
                if progress:
                    progress(done, total)
    pair = same_seed(a, b, seed, same_seed_spp, "same_seed" in limits)
    if paired and progress:
        progress(total, total)

    ours, theirs = Shown(a, first), Shown(b, second)
    image, reference = metrics.pair(ours.image, theirs.image)
    found: dict[str, Any] = {"tests": (), "noise_rmse": math.nan, "noise_ratio": math.nan}
    if ours.batches is not None and theirs.batches is not None:
        found = statistics(
            ours.batches,
            theirs.batches,
            significance=significance,
            same_estimator=same_estimator,
            independent_pixels=independent_pixels,
            critical=limits.get("z"),
        )
        if not tests:
            found["tests"] = found["tests"][:1] if "z" in limits else ()
    elif "z" in limits:
        title = a.title if ours.batches is None else b.title
        raise ComparisonError(f"compare: 'z' needs the noise of both images, but that of {title} is unknown")
    return Comparison(
        name=name,
        image=image.astype(np.float32),
        reference=reference.astype(np.float32),
        titles=(a.title, b.title),
        spp=ours.spp,
        reference_spp=theirs.spp,
        batch_spp=rendering[0].spp if rendering else 0,
        rmse=metrics.rmse(image, reference),
        relative_rmse=metrics.relative_rmse(image, reference),
        bias=metrics.mean_bias(image, reference),
        relative_bias=metrics.relative_bias(image, reference),
        same_seed=pair,
        same_seed_spp=same_seed_spp if paired else 0,
        seconds=ours.seconds,
        reference_seconds=theirs.seconds,
        limits=dict(limits),
        facts=(ours.facts, theirs.facts),
        **found,
    )


def rendered(
    a: Comparand, b: Comparand, spp: int, reference_spp: int | None, batches: int, seed: int
) -> tuple[Rendering | None, Rendering | None]:
    """The renderings that are to be done: of both sides, one or none."""
    batch_spp, count, reference_count = plan(spp, reference_spp, batches)
    reference = a.reference or b.reference
    if reference is not None:  # batches of the same spp as its own
        batch_spp = reference.batch_spp
        count, reference_count = (max(2, n // batch_spp) for n in (spp, reference_spp or spp))
    return (
        Rendering(a.renderer, batch_spp, count, seed, OUR_SEEDS) if a.renderer else None,
        Rendering(b.renderer, batch_spp, reference_count, seed, THEIR_SEEDS) if b.renderer else None,
    )


def same_seed(a: Comparand, b: Comparand, seed: int, spp: int, wanted: bool) -> Agreement | None:
    """The agreement of the two sides at equal seeds, as far as they can have equal ones.

    Images are taken as they are. Whatever is compared with a reference renders again, with the reference's
    seeds, but only where the agreement is `wanted`.
    """
    if a.renderer and b.renderer:
        if not spp:
            return None
        if a.paired and b.paired:
            return agreement(a.paired(spp, seed), b.paired(spp, seed))
        return agreement(a.renderer(spp, seed), b.renderer(spp, seed))
    if not (a.renderer or b.renderer):
        return agreement(stored(a), stored(b))
    if not wanted:
        return None
    if a.renderer and b.reference:
        return agreement(repeated(a.renderer, b.reference), b.reference.batches.mean)
    if b.renderer and a.reference:
        return agreement(a.reference.batches.mean, repeated(b.renderer, a.reference))
    raise ComparisonError(f"compare: 'same_seed' can't be measured for {a.title} and {b.title}, whose seeds may differ")


def stored(side: Comparand) -> npt.NDArray[Any]:
    """The image of a side that doesn't render."""
    if side.reference is not None:
        return side.reference.batches.mean
    assert side.image is not None
    return side.image


def repeated(renderer: Renderer, reference: Reference) -> npt.NDArray[np.float64]:
    """The mean image of the batches of a reference, rendered again."""
    batches = Batches()
    for seed in reference.seeds:
        batches.add(renderer(reference.batch_spp, seed))
    return batches.mean


def statistics(
    a: Batches,
    b: Batches,
    *,
    significance: float,
    same_estimator: bool,
    independent_pixels: bool,
    critical: float | None,
) -> dict[str, Any]:
    """The fields of a `Comparison` that need the noise of both images."""
    options: dict[str, Any] = {"significance": significance, "equal_variance": same_estimator}
    noise = a.variance_of_mean().mean(), b.variance_of_mean().mean()
    return {
        "tests": (
            mean_test(a, b, independent_pixels=independent_pixels, critical=critical, **options),
            weighted_test(a, b, independent_pixels=independent_pixels, **options),
            block_test(a, b, independent_pixels=independent_pixels, **options),
            pixel_test(a, b, **options),
        ),
        "noise_rmse": float(np.sqrt(sum(noise))),
        "noise_ratio": noise_ratio(a, b),
        "z_map": z_map(a, b, same_estimator),
    }


def plan(spp: int, reference_spp: int | None, batches: int) -> tuple[int, int, int]:
    """The samples of a batch, our number of batches, the reference's number of batches."""
    reference_spp = spp if reference_spp is None else reference_spp
    for name, value, low in (("spp", spp, 4), ("reference_spp", reference_spp, 4), ("batches", batches, 2)):
        if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or value < low:
            raise ComparisonError(f"compare: '{name}' must be an integer of at least {low}, found {value!r}")
    batch_spp = max(1, min(spp, reference_spp) // batches)
    return batch_spp, spp // batch_spp, reference_spp // batch_spp

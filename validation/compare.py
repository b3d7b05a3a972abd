"""The comparison of two images, renderers or scenes: numbers, tests, a verdict, a picture and a page.

    result = djpt.validation.compare(djpt.cornell_box(), spp=256, rmse=0.05)
    print(result)
    assert result.passed

A scene is compared with Mitsuba's image of it, or with anything else: `against`. Renderers render in batches with
independent seeds. Batches have equal spp on both sides: developing a filtered image divides two sums, which biases
images of few samples a little. Only at equal spp are both biased alike.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.rendering.progress import Progress, watched
from djpt.scenes.overrides import described, override
from djpt.validation import metrics
from djpt.validation.bridge import Renderer
from djpt.validation.comparands import (
    Comparand,
    comparand_of,
    djpt_renderer,
    is_described,
    mitsuba_comparand,
    told_apart,
)
from djpt.validation.comparison import Agreement, Comparison, agreement
from djpt.validation.metrics import ComparisonError, checked_limits
from djpt.validation.references import Reference, write_reference
from djpt.validation.statistics import Batches, block_test, mean_test, noise_ratio, pixel_test, weighted_test, z_map

__all__ = [
    "OUR_SEEDS",
    "THEIR_SEEDS",
    "Comparison",
    "Side",
    "assert_matches",
    "compare",
    "compare_renderers",
    "compared",
    "djpt_renderer",
    "plan",
    "store_reference",
]

OUR_SEEDS, THEIR_SEEDS = 0, 1
"""The streams of seeds of the two sides; references have the second one."""


class Side:
    """One of the two things that are compared, with the batches that are rendered of it, or that a reference has."""

    def __init__(self, comparand: Comparand, spp: int, count: int, seed: int, stream: int) -> None:
        self.comparand, self.batch_spp = comparand, spp
        self.count = count if comparand.renderer else 0
        """The number of batches to render."""
        # With seeds that both sides share their noise would be correlated, and the tests too lenient.
        self.seeds = tuple(np.random.SeedSequence([seed, stream]).generate_state(self.count).tolist())
        self.batches = Batches()
        self.times: list[float] = []
        reference = comparand.reference
        if reference is not None:
            self.batches, self.batch_spp, self.seeds = reference.batches, reference.batch_spp, reference.seeds

    def render(self, k: int) -> None:
        """Render batch `k`."""
        assert self.comparand.renderer is not None
        start = time.perf_counter()
        image = self.comparand.renderer(self.batch_spp, self.seeds[k])
        self.times.append(time.perf_counter() - start)
        self.batches.add(image)

    @property
    def seconds(self) -> float:
        """The median time of a batch, without the first one, which compiles kernels; 0 if none was rendered."""
        return float(np.median(self.times[1:] or self.times)) if self.times else 0.0

    @property
    def spp(self) -> int:
        """Samples per pixel of all batches; 0 for images."""
        return self.batch_spp * self.batches.count

    @property
    def image(self) -> npt.NDArray[Any]:
        """The mean of the batches, or the image that has none."""
        return self.batches.mean if self.comparand.image is None else self.comparand.image

    @property
    def facts(self) -> dict[str, Any]:
        """What was rendered, and how, for people to read."""
        found = dict(self.comparand.facts)
        if self.batches.count:
            found |= {"seeds": list(self.seeds), "batches": self.batches.count, "samples per pixel": self.spp}
        return found


def compared(
    a: Comparand,
    b: Comparand,
    *,
    limits: Mapping[str, float],
    name: str = "scene",
    spp: int = 64,
    reference_spp: int | None = None,
    seed: int = 0,
    significance: float = 1e-3,
    tests: bool = True,
    batches: int = 8,
    same_seed_spp: int = 16,
    same_estimator: bool = True,
    independent_pixels: bool = False,
    progress: Progress | None = None,
) -> Comparison:
    """Render what has to be rendered, and compare: the arguments are those of `djpt.validation.compare.compare`.

    `same_estimator`: both have the same variance. `independent_pixels`: pixels share no samples.
    """
    ours, theirs = sides(a, b, spp, reference_spp, batches, seed)
    paired = a.renderer is not None and b.renderer is not None and same_seed_spp > 0
    done, total = 0, ours.count + theirs.count + (2 if paired else 0)
    # In turn, so that other load on the machine slows both.
    for k in range(max(ours.count, theirs.count)):
        for side in (ours, theirs):
            if k < side.count:
                side.render(k)
                done += 1
                if progress:
                    progress(done, total)
    pair = same_seed(ours, theirs, seed, same_seed_spp, "same_seed" in limits)
    if paired and progress:
        progress(total, total)

    image, reference = metrics.pair(ours.image, theirs.image)
    found: dict[str, Any] = {"tests": (), "noise_rmse": math.nan, "noise_ratio": math.nan}
    if ours.batches.count and theirs.batches.count:
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
        title = b.title if ours.batches.count else a.title
        raise ComparisonError(f"compare: 'z' needs the noise of both images, but that of {title} is unknown")
    return Comparison(
        name=name,
        image=image.astype(np.float32),
        reference=reference.astype(np.float32),
        titles=(a.title, b.title),
        spp=ours.spp,
        reference_spp=theirs.spp,
        batch_spp=next((side.batch_spp for side in (ours, theirs) if side.count), 0),
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


def sides(
    a: Comparand, b: Comparand, spp: int, reference_spp: int | None, batches: int, seed: int
) -> tuple[Side, Side]:
    """Both sides, before anything is rendered."""
    batch_spp, count, reference_count = plan(spp, reference_spp, batches)
    reference = a.reference or b.reference
    if reference is not None:  # batches of the same spp as its own
        batch_spp = reference.batch_spp
        count, reference_count = (max(2, n // batch_spp) for n in (spp, reference_spp or spp))
    return Side(a, batch_spp, count, seed, OUR_SEEDS), Side(b, batch_spp, reference_count, seed, THEIR_SEEDS)


def same_seed(ours: Side, theirs: Side, seed: int, spp: int, wanted: bool) -> Agreement | None:
    """The agreement of the two sides at equal seeds, as far as they can have equal ones.

    Images are taken as they are. Whatever is compared with a reference renders again, with the reference's
    seeds, but only where the agreement is `wanted`.
    """
    a, b = ours.comparand, theirs.comparand
    if a.renderer and b.renderer:
        if not spp:
            return None
        if a.paired and b.paired:
            return agreement(a.paired(spp, seed), b.paired(spp, seed))
        return agreement(a.renderer(spp, seed), b.renderer(spp, seed))
    if not (a.renderer or b.renderer):
        return agreement(ours.image, theirs.image)
    if not wanted:
        return None
    if a.renderer and b.reference:
        return agreement(repeated(a.renderer, b.reference), theirs.image)
    if b.renderer and a.reference:
        return agreement(ours.image, repeated(b.renderer, a.reference))
    raise ComparisonError(f"compare: 'same_seed' can't be measured for {a.title} and {b.title}, whose seeds may differ")


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


# ---- the verbs -------------------------------------------------------------------------------


def compare(
    scene: Any,
    spp: int = 64,
    rmse: float | None = None,
    *,
    against: Any = None,
    limits: Mapping[str, float | None] | None = None,
    same_seed: float | None = None,
    reference_spp: int | None = None,
    seed: int = 0,
    significance: float = 1e-3,
    tests: bool = True,
    batches: int = 8,
    same_seed_spp: int = 16,
    width: int | None = None,
    height: int | None = None,
    rfilter: str | Mapping[str, Any] | None = None,
    integrator: str | Mapping[str, Any] | None = None,
    integrator_b: str | Mapping[str, Any] | None = None,
    mitsuba_integrator: str | Mapping[str, Any] | None = None,
    schedule: str = "auto",
    schedule_b: str | None = None,
    parameters: Mapping[str, str] | None = None,
    name: str | None = None,
    progress: Progress | bool | None = None,
) -> Comparison:
    """Compare two images, or two renderers' images.

    Args:
        scene: The first side: a scene (a dict of Mitsuba's schema, the name of a built-in scene, an XML file) that
            djpt renders, a scene loaded by djpt or Mitsuba, an image file, an array (H, W, C), a `Reference`, or a
            function that gives an array: see `djpt.validation.comparands.as_renderer`.
        spp: Samples per pixel of a side that renders, in all batches together; rounded down to full batches. At
            least 4.
        rmse: Limit for the RMSE, which includes the noise of both images; None: no limit.
        against: The second side, as `scene`. None: Mitsuba's image of the scene, or djpt's if `integrator_b` or
            `schedule_b` is given.
        limits: Thresholds by the names of `djpt.validation.metrics.LIMITS`, such as ``{"flip": 0.05, "z": 4}``.
            `z` replaces the limit of the test of the image mean.
        same_seed: Limit for the share of pixels that agree at equal seeds, 0 to 1; None: reported only.
        reference_spp: Samples per pixel of the second side (default `spp`): more of them lower the noise in `rmse`.
        seed: Changes all seeds.
        significance: False-alarm probability of each of the four families of tests.
        tests: Whether the tests decide, or only the thresholds do.
        batches: Independent renders that `spp` is split into.
        same_seed_spp: Samples per pixel of the same-seed pair; 0 leaves it out.
        width: Pixels, instead of the scenes'; see `djpt.scenes.overrides.override`.
        height: Pixels, instead of the scenes'.
        rfilter: Reconstruction filter, instead of the scenes'. With `box` the tests are more sensitive.
        integrator: Integrator, instead of the scenes', on both sides.
        integrator_b: Integrator of the second side, instead of `integrator`: compares two estimators of one image.
        mitsuba_integrator: Integrator in Mitsuba, instead of `integrator`.
        schedule: djpt's schedule.
        schedule_b: djpt's schedule on the second side, instead of `schedule`.
        parameters: Values for the ``$name`` of scene files.
        name: What the comparison is called; the scene's name by default.
        progress: Called with (renders done, renders in all); True shows a bar.

    Raises:
        ComparisonError: The images can't be compared.
        SceneError: The scene is wrong.
        FileError: A file can't be read.
        BackendError: Mitsuba or another package isn't installed.
    """
    asked = checked_limits({**(limits or {}), **given(rmse=rmse, same_seed=same_seed)})
    film = {"width": width, "height": height, "rfilter": rfilter}
    if parameters and not is_scene_file(against):
        described(scene, parameters)  # raises unless it is a file: parameters of no scene are a mistake
    title, first = found(scene, parameters)
    a = comparand_of(first, schedule, **film, integrator=integrator)
    other = integrator if integrator_b is None else integrator_b
    other_schedule = schedule if schedule_b is None else schedule_b
    if against is not None:
        _, second = found(against, parameters)
        b = comparand_of(second, other_schedule, **film, integrator=other if is_described(second) else integrator_b)
    elif a.description is None:
        raise ComparisonError(
            "compare: only a scene description can be compared with Mitsuba; pass `against` to compare with something "
            "else"
        )
    elif (integrator_b is not None or schedule_b is not None) and mitsuba_integrator is None:
        b = comparand_of(first, other_schedule, **film, integrator=other)
    else:
        b = mitsuba_comparand(override(a.description, integrator=mitsuba_integrator))
    same_estimator = integrator_b is None and mitsuba_integrator is None and a.description is not None
    with watched(progress, "comparing", "renders") as shown:
        return compared(
            *told_apart(a, b),
            name=name or title,
            spp=spp,
            reference_spp=reference_spp,
            seed=seed,
            significance=significance,
            tests=tests,
            batches=batches,
            same_seed_spp=same_seed_spp,
            same_estimator=same_estimator and (b.description is not None or b.reference is not None),
            independent_pixels=a.independent_pixels and b.independent_pixels,
            limits=asked,
            progress=shown,
        )


def assert_matches(scene: Any, spp: int = 64, rmse: float | None = None, **options: Any) -> None:
    """Call `compare` with the same arguments; raise `ComparisonError` with its table unless everything passes.

    Also without anything that could fail: two images whose noise isn't known need a threshold.
    """
    result = compare(scene, spp, rmse, **options)
    if not result.checks:
        raise ComparisonError("nothing to assert: images whose noise is unknown need a threshold, such as rmse=0.01")
    if not result.passed:
        raise ComparisonError("\n".join(["the images differ:", *result.failures, "", str(result)]))


def store_reference(
    path: str | os.PathLike[str],
    scene: Any,
    spp: int = 256,
    *,
    batches: int = 8,
    seed: int = 0,
    schedule: str = "auto",
    parameters: Mapping[str, str] | None = None,
    progress: Progress | bool | None = None,
    **changes: Any,
) -> Reference:
    """Render `scene`, anything that renders and `compare` takes, and store the image with its noise at `path`, an exr.

    Args:
        path: The file.
        scene: What renders.
        spp: Samples per pixel, in all batches together.
        batches: Independent renders that `spp` is split into.
        seed: Changes all seeds.
        schedule: djpt's schedule.
        parameters: Values for the ``$name`` of scene files.
        progress: Called with (renders done, renders in all); True shows a bar.
        changes: `width`, `height`, `rfilter`, `integrator` in place of a described scene's.

    Raises:
        ComparisonError: `scene` is an image, whose noise can't be found.
        FileError: The file can't be written.
    """
    if parameters:
        described(scene, parameters)  # raises unless it is a file
    comparand = comparand_of(found(scene, parameters)[1], schedule, **changes)
    if comparand.renderer is None:
        raise ComparisonError("a reference must be rendered, in batches that reveal its noise; an image has no batches")
    batch_spp, count, _ = plan(spp, None, batches)
    side = Side(comparand, batch_spp, count, seed, THEIR_SEEDS)
    with watched(progress, "rendering", "renders") as shown:
        for k in range(count):
            side.render(k)
            if shown:
                shown(k + 1, count)
    reference = Reference(side.batches, batch_spp, side.seeds, comparand.independent_pixels, comparand.facts)
    write_reference(path, reference)
    return reference


def compare_renderers(
    ours: Renderer,
    theirs: Renderer,
    *,
    paired: Renderer | None = None,
    rmse: float | None = None,
    same_seed: float | None = None,
    limits: Mapping[str, float | None] | None = None,
    **options: Any,
) -> Comparison:
    """Compare any two functions (spp, seed) -> (H, W, C), as `compare` does, with its arguments by keyword.

    `paired`: renders the reference of the same-seed pair in place of `theirs`. Further arguments are `same_estimator`,
    whether both have the same variance (default true), and `independent_pixels`, whether pixels share no samples, as
    with a box filter (default false).
    """
    asked = checked_limits({**(limits or {}), **given(rmse=rmse, same_seed=same_seed)})
    return compared(Comparand("djpt", ours), Comparand("Mitsuba", theirs, paired), limits=asked, **options)


def found(value: Any, parameters: Mapping[str, str] | None) -> tuple[str, Any]:
    """The name of a side, and its description if it is a scene to be described; otherwise the side as it is."""
    if is_described(value):
        return described(value, parameters if is_scene_file(value) else None)
    if isinstance(value, (str, os.PathLike)):
        return os.path.basename(os.fspath(value)), value
    return getattr(value, "__name__", "comparison"), value


def is_scene_file(value: Any) -> bool:
    """True if a side is an XML file, which may have parameters."""
    return isinstance(value, (str, os.PathLike)) and os.fspath(value).lower().endswith(".xml")


def given(**limits: float | None) -> dict[str, float]:
    """The limits that aren't None."""
    return {name: limit for name, limit in limits.items() if limit is not None}

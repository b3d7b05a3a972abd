"""The comparison of djpt's image with Mitsuba's: numbers, tests, a verdict and a picture.

    result = djpt.validation.compare(djpt.cornell_box(), spp=256, rmse=0.05)
    print(result)
    assert result.passed

Both renderers render the same scene in batches with independent seeds. Batches have equal spp on both sides:
developing a filtered image divides two sums, which biases images of few samples a little. Only at equal spp
are both biased alike.
"""

from __future__ import annotations

import base64
import html
import math
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.description.overrides import described, override, rfilter_name
from djpt.display.progress import Progress, watched
from djpt.validation import metrics
from djpt.validation.bridge import Renderer, mitsuba_renderer
from djpt.validation.metrics import ComparisonError
from djpt.validation.same_seed import Agreement, agreement
from djpt.validation.statistics import Batches, TestResult, block_test, mean_test, noise_ratio, pixel_test

__all__ = ["Comparison", "assert_matches", "compare", "compare_renderers", "djpt_renderer"]

_OUR_SEEDS, _THEIR_SEEDS = 0, 1


@dataclass(frozen=True)
class Comparison:
    """The result of `compare`. `print()` shows a table; `write_picture(path)` draws a picture.

    * `image`, `reference`: djpt's and Mitsuba's mean image, (H, W, C) float32, linear.
    * `spp`, `reference_spp`, `batch_spp`: samples per pixel in all, and of one batch.
    * `rmse`, `relative_rmse`, `bias` (mean of djpt - Mitsuba), `relative_bias`: see `djpt.validation.metrics`.
    * `noise_rmse`: the RMSE that noise alone is expected to cause: sqrt(mean(var djpt + var Mitsuba)).
    * `noise_ratio`: standard deviation of djpt's pixels / Mitsuba's at equal spp, geometric mean over pixels.
    * `tests`: the families of `djpt.validation.statistics`: pixels, blocks, image mean.
    * `same_seed`: agreement of one pair of renders with the same seed at `same_seed_spp`, or None.
    * `seconds`, `reference_seconds`: median time of one batch, without the first one, which compiles.
    * `limits`: the thresholds that were given.
    """

    name: str
    image: npt.NDArray[np.float32]
    reference: npt.NDArray[np.float32]
    spp: int
    reference_spp: int
    batch_spp: int
    rmse: float
    noise_rmse: float
    relative_rmse: float
    bias: float
    relative_bias: float
    noise_ratio: float
    tests: tuple[TestResult, ...]
    same_seed: Agreement | None
    same_seed_spp: int
    seconds: float
    reference_seconds: float
    limits: Mapping[str, float] = field(default_factory=dict)

    @property
    def failures(self) -> list[str]:
        """One line for each check that failed; empty if all passed."""
        found = [str(test) for test in self.tests if not test.passed]
        if "rmse" in self.limits and not self.rmse <= self.limits["rmse"]:
            found.append(f"RMSE {self.rmse:.4g} above {self.limits['rmse']:g} (noise alone: {self.noise_rmse:.4g})")
        if "same_seed" in self.limits and self.same_seed and not self.same_seed.share >= self.limits["same_seed"]:
            found.append(f"same seed: {self.same_seed}, at least {self.limits['same_seed']:.4%} expected")
        return found

    @property
    def passed(self) -> bool:
        """Whether all tests and all given thresholds hold."""
        return not self.failures

    @property
    def speed(self) -> float:
        """Mitsuba's time / djpt's for one batch: an estimate, which `benchmarks/` measures more precisely."""
        return self.reference_seconds / self.seconds if self.seconds > 0 else math.inf

    def write_picture(self, path: str | os.PathLike[str]) -> None:
        """Write djpt | Mitsuba | difference side by side, as png or jpg."""
        from djpt.validation.report import write_picture

        write_picture(self, path)

    def _repr_html_(self) -> str:
        """The picture and the table, for notebooks."""
        png = base64.b64encode(self._repr_png_()).decode()
        return f'<img src="data:image/png;base64,{png}"><pre>{html.escape(str(self))}</pre>'

    def _repr_png_(self) -> bytes:
        """djpt | Mitsuba | difference as a PNG, for notebooks."""
        from djpt.images.image import Image
        from djpt.validation.report import picture

        return Image(picture(self))._repr_png_()

    def rows(self) -> list[tuple[str, str, str, str]]:
        """The rows of the table: (what, value, limit, verdict)."""
        limits = self.limits

        def verdict(name: str, good: bool) -> str:
            return "" if name not in limits else "ok" if good else "FAILED"

        limit = f"at most {limits['rmse']:g}" if "rmse" in limits else ""
        rows = [
            ("RMSE", f"{self.rmse:.5g}", limit, verdict("rmse", self.rmse <= limits.get("rmse", math.inf))),
            ("  expected from noise", f"{self.noise_rmse:.5g}", "", ""),
            ("relative RMSE", f"{self.relative_rmse:.5g}", "", ""),
            ("mean bias", f"{self.bias:+.3g} ({self.relative_bias:+.3%})", "", ""),
            ("noise, ours / Mitsuba", f"{self.noise_ratio:.3f}", "", ""),
        ]
        for test in self.tests:
            limit = f"{test.critical:.2f}, sees {test.detectable:.2g} of the mean"
            rows.append((f"worst z, {test.name}", f"{test.z:+.2f}", limit, "ok" if test.passed else "FAILED"))
        if self.same_seed:
            share = self.same_seed.share
            limit = f"at least {limits['same_seed']:.2%}" if "same_seed" in limits else ""
            text = f"{share:.3%} within {self.same_seed.tolerance:g}"
            name = f"same seed, {self.same_seed_spp} spp"
            rows.append((name, text, limit, verdict("same_seed", share >= limits.get("same_seed", 0))))
        text = f"{self.seconds:.3g} s / {self.reference_seconds:.3g} s"
        rows.append((f"time of {self.batch_spp} spp, ours / Mitsuba", text, f"{self.speed:.3g} x", ""))
        return rows

    def __str__(self) -> str:
        height, width, _ = self.image.shape
        title = f"{self.name}, {width} x {height}: djpt at {self.spp} spp, Mitsuba at {self.reference_spp} spp"
        rows = self.rows()
        widths = [max(len(row[i]) for row in rows) for i in range(3)]
        lines = ["  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[3]]) for row in rows]
        return "\n".join([title, *(f"  {line}".rstrip() for line in lines), "passed" if self.passed else "FAILED"])


def compare(
    scene: Mapping[str, Any] | str,
    spp: int = 64,
    rmse: float | None = None,
    *,
    same_seed: float | None = None,
    reference_spp: int | None = None,
    seed: int = 0,
    significance: float = 1e-3,
    batches: int = 8,
    same_seed_spp: int = 16,
    width: int | None = None,
    height: int | None = None,
    rfilter: str | Mapping[str, Any] | None = None,
    integrator: str | Mapping[str, Any] | None = None,
    mitsuba_integrator: str | Mapping[str, Any] | None = None,
    schedule: str = "auto",
    progress: Progress | bool | None = None,
) -> Comparison:
    """Render `scene` in djpt and in Mitsuba and compare the images.

    Args:
        scene: A dict of Mitsuba's schema or the name of a built-in scene.
        spp: Samples per pixel of djpt's image, in all batches together; rounded down to full batches. At least 4.
        rmse: Limit for the RMSE, which includes the noise of both images; None: no limit.
        same_seed: Limit for the share of pixels that agree at equal seeds, 0 to 1; None: reported only.
        reference_spp: Samples per pixel of Mitsuba's image (default `spp`): more of them lower the noise in `rmse`.
        seed: Changes all seeds.
        significance: False-alarm probability of each of the three families of tests.
        batches: Independent renders that `spp` is split into.
        same_seed_spp: Samples per pixel of the same-seed pair; 0 leaves it out.
        width: Pixels, instead of the scene's; see `djpt.description.overrides.override`.
        height: Pixels, instead of the scene's.
        rfilter: Reconstruction filter, instead of the scene's. With `box` the tests are more sensitive.
        integrator: Integrator, instead of the scene's, in both renderers.
        mitsuba_integrator: Integrator in Mitsuba, instead of `integrator`: compares two estimators of one image.
        schedule: djpt's schedule.
        progress: Called with (renders done, renders in all); True shows a bar.

    Raises:
        ComparisonError: The images can't be compared.
        SceneError: The scene is wrong.
        BackendError: Mitsuba isn't installed.
    """
    name, description = described(scene)
    description = override(description, width=width, height=height, rfilter=rfilter, integrator=integrator)
    theirs = override(description, integrator=mitsuba_integrator)
    with watched(progress, "comparing", "renders") as shown:
        return compare_renderers(
            djpt_renderer(description, schedule),
            mitsuba_renderer(theirs),
            paired=mitsuba_renderer(theirs, optimize=False),
            name=name,
            spp=spp,
            rmse=rmse,
            same_seed=same_seed,
            reference_spp=reference_spp,
            seed=seed,
            significance=significance,
            batches=batches,
            same_seed_spp=same_seed_spp,
            same_estimator=mitsuba_integrator is None,
            independent_pixels=rfilter_name(description) == "box",
            progress=shown,
        )


def assert_matches(scene: Mapping[str, Any] | str, spp: int = 64, rmse: float | None = None, **options: Any) -> None:
    """Call `compare` with the same arguments; raise `ComparisonError` with its table unless everything passes."""
    result = compare(scene, spp, rmse, **options)
    if not result.passed:
        raise ComparisonError("\n".join(["the images differ:", *result.failures, "", str(result)]))


def djpt_renderer(scene: Mapping[str, Any], schedule: str = "auto") -> Renderer:
    """Load `scene` into djpt once, to be rendered many times."""
    from djpt.description.loader import load_dict
    from djpt.rendering import render

    loaded = load_dict(scene)

    def renderer(spp: int, seed: int) -> npt.NDArray[np.float32]:
        return np.array(render(loaded, spp=spp, seed=seed, schedule=schedule), np.float32)

    return renderer


def compare_renderers(
    ours: Renderer,
    theirs: Renderer,
    *,
    paired: Renderer | None = None,
    name: str = "scene",
    spp: int = 64,
    rmse: float | None = None,
    same_seed: float | None = None,
    reference_spp: int | None = None,
    seed: int = 0,
    significance: float = 1e-3,
    batches: int = 8,
    same_seed_spp: int = 16,
    same_estimator: bool = True,
    independent_pixels: bool = False,
    progress: Progress | None = None,
) -> Comparison:
    """Compare any two functions (spp, seed) -> (H, W, C), as `compare` does.

    `paired`: renders the reference of the same-seed pair in place of `theirs`. `same_estimator`: both
    have the same variance. `independent_pixels`: pixels share no samples (box filter).
    """
    batch_spp, count, reference_count = _plan(spp, reference_spp, batches)
    limits = {key: value for key, value in (("rmse", rmse), ("same_seed", same_seed)) if value is not None}
    sides = (
        _Side(ours, batch_spp, count, seed, _OUR_SEEDS),
        _Side(theirs, batch_spp, reference_count, seed, _THEIR_SEEDS),
    )
    done, total = 0, count + reference_count + (2 if same_seed_spp else 0)
    # In turn, so that other load on the machine slows both.
    for k in range(max(count, reference_count)):
        for side in sides:
            if k < side.count:
                side.render(k)
                done += 1
                if progress:
                    progress(done, total)
    pair = None
    if same_seed_spp:
        pair = agreement(ours(same_seed_spp, seed), (paired or theirs)(same_seed_spp, seed))
        if progress:
            progress(total, total)

    a, b = sides[0].batches, sides[1].batches
    options: dict[str, Any] = {"significance": significance, "equal_variance": same_estimator}
    noise = a.variance_of_mean().mean(), b.variance_of_mean().mean()
    return Comparison(
        name=name,
        image=a.mean.astype(np.float32),
        reference=b.mean.astype(np.float32),
        spp=batch_spp * count,
        reference_spp=batch_spp * reference_count,
        batch_spp=batch_spp,
        rmse=metrics.rmse(a.mean, b.mean),
        noise_rmse=float(np.sqrt(sum(noise))),
        relative_rmse=metrics.relative_rmse(a.mean, b.mean),
        bias=metrics.mean_bias(a.mean, b.mean),
        relative_bias=metrics.relative_bias(a.mean, b.mean),
        noise_ratio=noise_ratio(a, b),
        tests=(
            mean_test(a, b, independent_pixels=independent_pixels, **options),
            block_test(a, b, independent_pixels=independent_pixels, **options),
            pixel_test(a, b, **options),
        ),
        same_seed=pair,
        same_seed_spp=same_seed_spp,
        seconds=sides[0].seconds,
        reference_seconds=sides[1].seconds,
        limits=limits,
    )


class _Side:
    """One of the two renderers, with its batches, times and seeds."""

    def __init__(self, renderer: Renderer, spp: int, count: int, seed: int, stream: int) -> None:
        self.renderer, self.spp, self.count = renderer, spp, count
        # With seeds that both sides share their noise would be correlated, and the tests too lenient.
        self.seeds = np.random.SeedSequence([seed, stream]).generate_state(count)
        self.batches = Batches()
        self.times: list[float] = []

    def render(self, k: int) -> None:
        start = time.perf_counter()
        image = self.renderer(self.spp, int(self.seeds[k]))
        self.times.append(time.perf_counter() - start)
        self.batches.add(image)

    @property
    def seconds(self) -> float:
        """The median time of a batch, without the first one, which compiles kernels."""
        return float(np.median(self.times[1:] or self.times))


def _plan(spp: int, reference_spp: int | None, batches: int) -> tuple[int, int, int]:
    """The samples of a batch, djpt's number of batches, the reference's number of batches."""
    reference_spp = spp if reference_spp is None else reference_spp
    for name, value, low in (("spp", spp, 4), ("reference_spp", reference_spp, 4), ("batches", batches, 2)):
        if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or value < low:
            raise ComparisonError(f"compare: '{name}' must be an integer of at least {low}, found {value!r}")
    batch_spp = max(1, min(spp, reference_spp) // batches)
    return batch_spp, spp // batch_spp, reference_spp // batch_spp

"""`check_gradient`: a test of the derivative of an image with respect to a parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from djpt.errors import BackendError, ParameterError
from djpt.images.sheets import DARK, Tile, captioned_sheet, enlarged
from djpt.rendering.progress import Progress, watched
from djpt.rendering.settings import check_count, check_seed
from djpt.scenes.overrides import described, override, reduced
from djpt.validation.gradcheck.losses import Loss, MitsubaLoss, loss_of
from djpt.validation.metrics import ComparisonError
from djpt.validation.report import Bytes, Pictured, aligned, difference_picture
from djpt.validation.statistics import deviate, limit_of, pooled_dof

__all__ = ["Direction", "GradientCheck", "Verdict", "check_gradient", "judged"]

TOLERANCE = 2e-3
"""The relative difference that counts as rounding and truncation."""


Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Verdict:
    """A comparison of the derivative by reverse mode with another estimate of it.

    * `what`: the direction and the other estimate.
    * `found`, `expected`: reverse mode's mean, and the other's.
    * `z`: the difference beyond `slack`, as a normal deviate; 0 within it.
    * `critical`: the largest absolute z that passes.
    * `slack`: the difference that rounding and truncation may make.
    """

    what: str
    found: float
    expected: float
    z: float
    critical: float
    slack: float

    @property
    def passed(self) -> bool:
        """True if noise explains the difference."""
        return math.isfinite(self.z) and abs(self.z) <= self.critical

    def __str__(self) -> str:
        verdict = "ok" if self.passed else "FAILED"
        return f"{self.what}: {self.found:+.5g} and {self.expected:+.5g}, z {self.z:+.2f}, {verdict}"


def judged(
    what: str, ours: Floats, theirs: Floats, critical: float, slack: float = 0.0, *, paired: bool = True
) -> Verdict:
    """Compare estimates of a derivative, one of each seed.

    Args:
        what: The name of the comparison.
        ours: By reverse mode.
        theirs: The other estimates.
        critical: The largest absolute z that passes.
        slack: The difference that may have another cause than noise, in addition to rounding.
        paired: Both have the same seeds, so that differences have less noise than either: Student's paired test.
            Otherwise they are independent: Welch's test.
    """
    found, expected = float(np.mean(ours)), float(np.mean(theirs))
    if paired:
        error, dof = float(standard_error(ours - theirs)), len(ours) - 1.0
    else:
        variances = np.square([standard_error(ours), standard_error(theirs)])
        dofs = np.array([len(ours), len(theirs)]) - 1
        error = math.sqrt(variances.sum())
        dof = float(pooled_dof(variances.sum(), (variances**2 / dofs).sum(), dofs.sum()))
    difference = found - expected
    slack += TOLERANCE * max(abs(found), abs(expected))
    beyond = max(0.0, abs(difference) - slack)
    if not math.isfinite(difference):
        z = math.nan
    elif beyond == 0:
        z = 0.0
    else:
        z = math.copysign(float(deviate(beyond / error, dof)) if error > 0 else math.inf, difference)
    return Verdict(what, found, expected, z, critical, slack)


def standard_error(values: Floats) -> Any:
    """The standard error of the mean over the last axis."""
    return np.std(values, axis=-1, ddof=1) / math.sqrt(values.shape[-1])


# ---- finite differences with common random numbers, and how far off they may be --------------


SHARE, LEAST = 0.1, 0.02
"""The step as a share of the largest entry that is changed, and the least one for entries near zero."""

HALVINGS = 12
"""The most times that a step which leaves the parameter's range is halved."""


@dataclass(frozen=True)
class Step:
    """A step in a direction, on both sides if the parameter's range has room for it, else on one."""

    loss: Loss
    direction: Floats
    size: float
    sides: int
    """0: central; 1: ahead only; -1: behind only."""

    @property
    def renders(self) -> int:
        """The images that `difference` renders."""
        return 4 if self.sides == 0 else 6

    def difference(self, seed: int) -> tuple[Floats, float]:
        """The derivative of the image at a seed, by two steps and Richardson's extrapolation.

        Of fourth order (central) or third; and how much halving the step changed the loss's derivative: the truncation
        error is a fraction of it.
        """
        coarse, fine = (self.loss.difference(self.direction, h, seed, self.sides) for h in (self.size, self.size / 2))
        return (4 * fine - coarse) / 3, abs(self.loss.value(fine) - self.loss.value(coarse))


def choose_step(loss: Loss, direction: Floats) -> Step:
    """The largest usual step that keeps the parameter in its range.

    Raises:
        ParameterError: The parameter can't be changed in this direction at all.
    """
    changed = np.abs(loss.values[direction != 0])
    size = max(LEAST, SHARE * float(changed.max(initial=0.0)))
    for _ in range(HALVINGS):
        for sides, reach in ((0, (1, -1)), (1, (1, 2)), (-1, (-1, -2))):
            if all(loss.allows(loss.values + steps * size * direction) for steps in reach):
                return Step(loss, direction, size, sides)
        size /= 2
    raise ParameterError(f"{loss.keys[0]}: can't be changed from {loss.values[direction != 0][:4].tolist()}")


# ---- directions ------------------------------------------------------------------------------


class Direction(NamedTuple):
    """A change of a parameter: the derivative in its direction is a number."""

    name: str
    vector: Floats
    """The change of each entry, (n,)."""


def directions_of(inward: Floats, slopes: Floats, samples: int, seed: int) -> list[Direction]:
    """The directions that a parameter of some entries is checked in.

    Up to four entries: each by itself. More: all together; two random combinations of signs, which no error of an entry
    that matters survives; and `samples` entries, half of them those of the largest `slopes`, half drawn at random.

    Args:
        inward: 1 for entries that can only grow, -1 for those that can only shrink, 0 for the others, (n,): where many
            entries change at once, such entries change inwards, so that the parameter keeps its range.
        slopes: The derivative with respect to each entry, (n,).
        samples: The number of single entries.
        seed: The seed of what is drawn.
    """
    count = inward.size
    if count <= 4:
        names = ("",) if count == 1 else tuple(f"[{i}]" for i in range(count))
        return [Direction(name, row) for name, row in zip(names, np.eye(count), strict=True)]
    rng = np.random.default_rng(seed)
    signs = [("all entries", np.ones(count))]
    signs += [(f"random signs {i}", rng.choice([-1.0, 1.0], count)) for i in (1, 2)]
    found = [Direction(name, np.where(inward == 0, row, inward)) for name, row in signs]
    largest = np.argsort(-np.abs(slopes))[: samples // 2]
    drawn = rng.choice(count, size=min(count, samples - len(largest)), replace=False)
    for entry in dict.fromkeys([*largest.tolist(), *drawn.tolist()]):
        vector = np.zeros(count)
        vector[entry] = 1.0
        found.append(Direction(f"entry {entry}", vector))
    return found


# ---- the check -------------------------------------------------------------------------------


GROWTH = 2
"""The factor by which the number of seeds grows while an estimate isn't precise enough."""

SIDE = 64
"""The largest side of the pictures that are checked by default, in pixels: larger ones take longer and find no more."""


@dataclass(frozen=True)
class GradientCheck(Pictured):
    """The result of `check_gradient`. `print()` shows a table; `write_picture(path)` draws a picture.

    * `key`, `value`: the parameter, and its entries where it was checked, (n,).
    * `gradient`: the derivative of the loss with respect to each entry, by reverse mode, (n,).
    * `verdicts`: the comparisons, all of which must pass.
    * `seeds`, `spp`: the number of seeds of each estimate, and the samples per pixel of each render.
    * `resolution`: the largest standard error of a difference between reverse mode and finite differences, relative to
      the largest derivative: a smaller error would not have been detected.
    * `derivative`, `by_differences`: the derivative image in the first direction, by forward mode and by finite
      differences, (H, W, C).
    * `notes`: what wasn't compared, and why.
    """

    title = "a gradient check"

    name: str
    key: str
    value: Floats
    gradient: Floats
    verdicts: tuple[Verdict, ...]
    seeds: int
    spp: int
    resolution: float
    derivative: Floats
    by_differences: Floats
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def failures(self) -> list[Verdict]:
        """The comparisons that failed."""
        return [verdict for verdict in self.verdicts if not verdict.passed]

    @property
    def passed(self) -> bool:
        """True if all comparisons passed."""
        return not self.failures

    def __str__(self) -> str:
        values = ", ".join(f"{x:.4g}" for x in self.value[:4]) + (", .." if self.value.size > 4 else "")
        lines = [f"{self.name}, {self.key} = {values}: {self.seeds} seeds of {self.spp} spp"]
        rows = (
            [("", "reverse mode", "expected", "z", f"limit {self.verdicts[0].critical:.2f}")] if self.verdicts else []
        )
        for verdict in self.verdicts:
            good = "ok" if verdict.passed else "FAILED"
            rows.append((verdict.what, f"{verdict.found:+.5g}", f"{verdict.expected:+.5g}", f"{verdict.z:+.2f}", good))
        lines += aligned(rows)
        lines.append(f"  resolution: detects errors above {self.resolution:.2%} of the largest derivative")
        lines += [f"  {note}" for note in self.notes]
        lines.append("passed" if self.passed else "FAILED")
        return "\n".join(line.rstrip() for line in lines)

    def picture(self) -> Bytes:
        """Three panels with captions: forward mode | finite differences | what is between them, sRGB (H, W, 3).

        Red is where a larger value means more light, blue where less. All have one full scale, stated below them, which
        is exceeded by one pixel in a hundred.
        """
        ours, other = self.derivative, self.by_differences
        scale = max(float(np.quantile(np.abs(np.mean(ours, axis=2)), 0.99)), 1e-9)
        nothing = np.zeros_like(ours)
        panels = (
            (f"{self.key}: forward mode", f"full scale {scale:.2g}", ours, nothing),
            ("finite differences", f"{self.seeds} seeds of {self.spp} spp", other, nothing),
            ("the difference", "passed" if self.passed else "FAILED", ours, other),
        )
        tiles = [Tile(above, below, enlarged(difference_picture(a, b, scale))) for above, below, a, b in panels]
        return captioned_sheet(tiles, palette=DARK)


def check_gradient(
    scene: Mapping[str, Any] | str,
    key: str,
    *,
    spp: int = 64,
    seeds: int = 8,
    most_seeds: int = 64,
    precision: float = 0.01,
    samples: int = 4,
    significance: float = 1e-3,
    sensor: int = 0,
    seed: int = 0,
    width: int | None = None,
    height: int | None = None,
    integrator: str | Mapping[str, Any] | None = None,
    mitsuba: bool | None = None,
    progress: Progress | bool | None = None,
) -> GradientCheck:
    """Check the derivative of the loss mean(w * image), with random weights w, with respect to a parameter of a scene.

    In each of several directions (`djpt.validation.gradcheck.check`) the derivative by reverse mode is compared

    * with forward mode, at the same seeds: both differentiate the same estimator, so they agree to rounding;
    * with finite differences at the same seeds, which follow nearly the same paths, so that most noise cancels: two
      steps on both sides, or on one at the end of the parameter's range, with Richardson's extrapolation. They know
      nothing of derivatives, so they find a wrong sign, a missing factor, a dropped term and a gradient that is zero;
    * with Mitsuba's `prb`, at other seeds.

    Each comparison is a t-test over independent seeds, at Sidak's level. Seeds are added until the standard error is
    below `precision` of the derivative, or there are `most_seeds`.

    Args:
        scene: A dict of Mitsuba's schema, the name of a built-in scene, or a file.
        key: The parameter, as in `djpt.traverse`. Of a `to_world` a motion is checked: the way along x, y and z, in
            scene units, and turns about these axes, in radians.
        spp: Samples per pixel of each render.
        seeds: The number of seeds to start with.
        most_seeds: The largest number of seeds.
        precision: The standard error to reach, relative to the largest derivative.
        samples: How many single entries of large parameters, such as textures, are checked.
        significance: The probability that noise makes a right gradient fail in any comparison.
        sensor: The index of the sensor.
        seed: The number from which all seeds are derived.
        width: Pixels. Default: the scene's, or fewer, so that no side has more than 64; with `width` or `height` alone,
            the image keeps its aspect ratio.
        height: Pixels, as `width`.
        integrator: Instead of the scene's.
        mitsuba: Compare with Mitsuba. None: if possible (it is installed, and knows the scene and the parameter).
        progress: Called with (renders done, renders in all), which grows when seeds are added; True shows a bar.

    Raises:
        ParameterError: There is no such parameter, it has no derivatives, or it can't be changed.
        ComparisonError: The comparison with Mitsuba is requested and impossible.
        SceneError: The scene is wrong.
        RenderError: Arguments are out of range.
    """
    name, description = described(scene)
    description = override(description, width=width, height=height, integrator=integrator)
    if width is None and height is None:
        description = reduced(description, SIDE)
    first = check_seed("seed", seed)
    spp, seeds = max(1, check_count("spp", spp)), max(3, check_count("seeds", seeds))
    most_seeds = max(seeds, check_count("most_seeds", most_seeds))
    with watched(progress, "checking", "renders") as shown:
        loss = loss_of(description, key, spp, sensor, first)
        theirs, notes = mitsuba_loss(description, key, spp, sensor, loss, mitsuba)
        numbers = np.random.SeedSequence([first, 5]).generate_state(2 * most_seeds).tolist()
        directions = directions_of(loss.inward(), loss.reverse(numbers[0]), samples, first)
        record = Record(loss, theirs, [(d, choose_step(loss, d.vector)) for d in directions])
        while True:
            record.extend(numbers, seeds, most_seeds, shown)
            if record.precision() <= precision or seeds >= most_seeds:
                break
            seeds = min(GROWTH * seeds, most_seeds)
    return GradientCheck(
        name=name,
        key=key,
        value=loss.values,
        gradient=np.mean(record.gradients, axis=0),
        verdicts=tuple(record.verdicts(significance)),
        seeds=len(record.gradients),
        spp=spp,
        resolution=record.precision(),
        derivative=record.images[0] / len(record.gradients),
        by_differences=record.images[1] / len(record.gradients),
        notes=tuple(notes),
    )


def mitsuba_loss(
    description: Mapping[str, Any], key: str, spp: int, sensor: int, loss: Loss, wanted: bool | None
) -> tuple[MitsubaLoss | None, list[str]]:
    """The loss in Mitsuba, or a note that says why there is none."""
    if wanted is False:
        return None, ["not compared with Mitsuba"]
    try:
        return MitsubaLoss(description, key, spp, sensor, loss), []
    except (BackendError, ComparisonError) as error:
        if wanted:
            raise
        return None, [f"not compared with Mitsuba: {error}".splitlines()[0]]


class Record:
    """The estimates of all derivatives so far."""

    def __init__(self, loss: Loss, theirs: MitsubaLoss | None, steps: list[tuple[Direction, Step]]) -> None:
        self.loss, self.theirs, self.steps = loss, theirs, steps
        self.gradients: list[Floats] = []
        self.mitsuba: list[Floats] = []
        self.rows: list[list[tuple[float, float, float]]] = []
        """For each seed, and each direction: forward mode, finite differences, and the change by halving their step."""
        self.images: Any = 0.0
        """The sums of the derivative images in the first direction, by forward mode and by differences."""

    def extend(self, numbers: list[int], count: int, most: int, progress: Progress | None) -> None:
        """Add seeds until there are `count`; Mitsuba has the second half of the numbers."""
        each = 1 + sum(1 + step.renders for _, step in self.steps) + (self.theirs is not None)
        done = each * len(self.gradients)

        def advance(renders: int = 1) -> None:
            nonlocal done
            done += renders
            if progress:
                progress(done, each * count)

        advance(0)
        for place in range(len(self.gradients), count):
            number = numbers[place]
            gradient = self.loss.reverse(number)
            advance()
            images, row = [], []
            for direction, step in self.steps:
                image = self.loss.forward(direction.vector, number)
                advance()
                by_differences, change = step.difference(number)
                advance(step.renders)
                images.append(np.stack([image, by_differences]))
                row.append((self.loss.value(image), self.loss.value(by_differences), change))
            if self.theirs is not None:
                self.mitsuba.append(self.theirs.reverse(numbers[most + place]))
                advance()
            self.images = self.images + images[0]
            self.rows.append(row)
            self.gradients.append(gradient)

    @property
    def estimates(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Reverse mode, forward mode, differences and the changes of these, (directions, seeds) each."""
        forward, differences, changes = np.array(self.rows).transpose(2, 1, 0)
        return self.along(self.gradients), forward, differences, changes

    def along(self, gradients: list[Floats]) -> Floats:
        """The derivatives in all directions by reverse mode, (directions, seeds)."""
        return np.stack([direction.vector for direction, _ in self.steps]) @ np.stack(gradients, axis=1)

    def precision(self) -> float:
        """The largest standard error of a difference to finite differences, relative to the largest derivative."""
        ours, _, differences, _ = self.estimates
        size = np.abs([ours.mean(axis=1), differences.mean(axis=1)]).max()
        return float(standard_error(ours - differences).max() / size) if size > 0 else 0.0

    def verdicts(self, significance: float) -> list[Verdict]:
        """The verdicts on all comparisons."""
        found = []
        critical = limit_of(significance, len(self.steps) * (2 + (self.theirs is not None)))
        for i, ((direction, _), ours, forward, differences, changes) in enumerate(
            zip(self.steps, *self.estimates, strict=True)
        ):
            label = f"{direction.name}, " if direction.name else ""
            found.append(judged(f"{label}forward mode", ours, forward, critical))
            # Halving the step takes most of the truncation error away, and extrapolation most of the rest.
            found.append(judged(f"{label}differences", ours, differences, critical, float(np.mean(changes)) / 3))
            if self.theirs is not None:
                other = self.along(self.mitsuba)[i]
                found.append(judged(f"{label}Mitsuba", ours, other, critical, paired=False))
        return found

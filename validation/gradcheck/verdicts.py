"""Tests of the agreement of two estimates of a derivative."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from djpt.validation.statistics import sidak

__all__ = ["Sample", "Verdict", "compared", "paired"]

TOLERANCE = 2e-3
"""The relative difference that counts as rounding and truncation."""


@dataclass(frozen=True)
class Sample:
    """Independent values of one estimate, one for each seed."""

    values: tuple[float, ...]

    @property
    def mean(self) -> float:
        """The mean of the values."""
        return float(np.mean(self.values))

    @property
    def error(self) -> float:
        """The standard error of the mean."""
        return float(np.std(self.values, ddof=1) / math.sqrt(len(self.values)))

    def __str__(self) -> str:
        return f"{self.mean:+.5g} +- {self.error:.1g}"


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


def paired(what: str, ours: Sample, theirs: Sample, slack: float, significance: float, tests: int) -> Verdict:
    """Compare estimates of the same seeds, whose differences have less noise than either: Student's paired test."""
    differences = Sample(tuple(a - b for a, b in zip(ours.values, theirs.values, strict=True)))
    return judged(
        what,
        ours.mean,
        theirs.mean,
        differences.mean,
        differences.error,
        len(ours.values) - 1,
        slack,
        significance,
        tests,
    )


def compared(what: str, ours: Sample, theirs: Sample, slack: float, significance: float, tests: int) -> Verdict:
    """Compare independent estimates: Welch's test."""
    variances = ours.error**2, theirs.error**2
    dofs = len(ours.values) - 1, len(theirs.values) - 1
    spread = sum(v * v / dof for v, dof in zip(variances, dofs, strict=True))
    dof = sum(variances) ** 2 / spread if spread > 0 else sum(dofs)
    difference = ours.mean - theirs.mean
    return judged(what, ours.mean, theirs.mean, difference, math.sqrt(sum(variances)), dof, slack, significance, tests)


def judged(
    what: str,
    found: float,
    expected: float,
    difference: float,
    error: float,
    dof: float,
    slack: float,
    significance: float,
    tests: int,
) -> Verdict:
    """The verdict on a difference with a standard error; each of `tests` tests has Sidak's level."""
    from scipy.stats import norm, t

    critical = float(norm.isf(sidak(significance, tests) / 2))
    slack += TOLERANCE * max(abs(found), abs(expected))
    beyond = max(0.0, abs(difference) - slack)
    if not math.isfinite(difference):
        z = math.nan
    elif beyond == 0:
        z = 0.0
    elif error == 0:
        z = math.copysign(math.inf, difference)
    else:
        ratio = beyond / error
        z = math.copysign(min(float(norm.isf(t.sf(ratio, dof))), ratio), difference)
    return Verdict(what, found, expected, z, critical, slack)

"""The comparison of integrators with closed forms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.description.loader import load_dict
from djpt.description.registry import registered
from djpt.rendering.render import render
from djpt.validation.closed_forms.cases import ClosedForm
from djpt.validation.statistics import deviate, limit_of

__all__ = ["Outcome", "validate"]

BATCHES = 16

WITHOUT_ROULETTE: dict[str, dict[str, Any]] = {
    "path_nee": {"russian_roulette": 1.0},
    "prb_basic": {},
    "direct": {},
    "whitted": {},
    "distributed": {"split": 1, "light_samples": 2},
}
"""Settings of integrators; the others have ``rr_depth`` as large as the depth."""


@dataclass(frozen=True)
class Outcome:
    """An integrator's radiance in a closed form.

    * `case`, `integrator`: the names.
    * `expected`, `found`, `error`: the radiance by the formula, the mean of the image, its standard error.
    * `z`: (found - expected) / error, after the relative error that the scene's approximation causes.
    * `critical`: the largest absolute z that passes.
    """

    case: str
    integrator: str
    expected: float
    found: float
    error: float
    z: float
    critical: float

    @property
    def passed(self) -> bool:
        """True if noise explains the difference."""
        return abs(self.z) <= self.critical

    @property
    def relative(self) -> float:
        """found / expected - 1."""
        return self.found / self.expected - 1


def validate(
    cases: Sequence[ClosedForm],
    integrators: Sequence[str] | None = None,
    *,
    spp: int = 1024,
    seed: int = 0,
    significance: float = 1e-3,
    settings: Mapping[str, Any] | None = None,
) -> Iterator[Outcome]:
    """Render closed forms with the integrators that find all of their light, and compare the means.

    Args:
        cases: Of `CASES`.
        integrators: Only these, where a closed form has them.
        spp: Samples of each of the 64 pixels, all of which see the same.
        seed: Of the images.
        significance: The probability that a right integrator fails in any of the comparisons of this call.
        settings: Parameters of the integrators, such as ``rr_depth``; without them nothing ends paths by chance.
    """
    known = registered("integrator")
    pairs = [
        (case, name)
        for case in cases
        for name in case.integrators
        if name in known and (integrators is None or name in integrators)
    ]
    critical = limit_of(significance, max(1, len(pairs)))
    for case, name in pairs:
        means = [float(np.mean(image)) for image in images(case, name, spp, seed, settings)]
        found, error = float(np.mean(means)), float(np.std(means, ddof=1) / np.sqrt(BATCHES))
        difference = found - case.radiance
        beyond = max(0.0, abs(difference) - case.exact * case.radiance)
        # As a normal deviate: the standard error comes from few batches.
        z = float(deviate(beyond / error, BATCHES - 1)) if error > 0 else np.inf
        z = 0.0 if beyond == 0 else float(np.copysign(z, difference))
        yield Outcome(case.name, name, case.radiance, found, error, z, critical)


def images(
    case: ClosedForm, name: str, spp: int, seed: int, settings: Mapping[str, Any] | None
) -> Iterator[npt.NDArray[np.float32]]:
    """Independent images of a closed form."""
    scene = load_dict(case.scene())
    limit = {} if name == "direct" else {"max_depth": case.depth}
    if settings is None:
        settings = WITHOUT_ROULETTE.get(name, {"rr_depth": case.depth + 1})
    integrator = load_dict({"type": name, **settings, **limit})
    for number in np.random.SeedSequence([seed, 13]).generate_state(BATCHES):
        yield np.array(render(scene, integrator=integrator, spp=max(1, spp // BATCHES), seed=int(number)))

"""Rounds of cases: generated, run, and made small where they find a mistake."""

from __future__ import annotations

import contextlib
from collections import Counter
from dataclasses import dataclass

import hypothesis
from hypothesis import HealthCheck, Phase, settings
from hypothesis.errors import Flaky

from tests.fuzz.cases import Case
from tests.fuzz.families import FAMILIES
from tests.fuzz.pool import Pool
from tests.fuzz.worker import Verdict

__all__ = ["Finding", "Tally", "attack"]

Tally = Counter[tuple[str, str]]
"""Numbers of cases by family and outcome."""


@dataclass
class Finding:
    """A mistake, and the smallest case that was found to show it."""

    family: str
    case: Case
    verdict: Verdict

    def __str__(self) -> str:
        return f"{' '.join(filter(None, self.verdict.signature))}\n{self.case.code}\n{self.verdict.text}"


class Found(Exception):
    """Tells hypothesis that a case is to be made smaller."""


def attack(
    pool: Pool, family: str, seed: int, cases: int, known: set[tuple[str, ...]], tally: Tally | None = None
) -> Finding | None:
    """Run cases of a family until one shows a mistake that isn't `known`; then make this one smaller.

    Equal seeds give equal cases. What is found is added to `known`, and to `tally` all that was run until then.
    """
    latest: list[Finding] = []

    @hypothesis.seed(seed)
    @settings(
        max_examples=cases,
        database=None,
        deadline=None,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
        print_blob=False,
    )
    @hypothesis.given(FAMILIES[family])
    def check(case: Case) -> None:
        verdict = pool.run(case)
        if tally is not None and not latest:
            tally[family, verdict.outcome] += 1
        if not verdict.is_finding or verdict.signature in known:
            return
        if latest and latest[0].verdict.signature != verdict.signature:
            return  # another mistake: one at a time
        latest[:] = [Finding(family, case, verdict)]
        raise Found

    with contextlib.suppress(Found, Flaky):
        check()
    if not latest:
        return None
    known.add(latest[0].verdict.signature)
    return latest[0]

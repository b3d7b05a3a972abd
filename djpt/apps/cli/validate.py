"""The command ``djpt validate``."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, ExitCode, require_positive
from djpt.errors import RenderError, near_miss

if TYPE_CHECKING:
    from collections.abc import Sequence

    from djpt.validation.closed_forms import ClosedForm, Outcome

__all__ = ["command", "table"]


@click.command("validate", cls=Command)
@click.argument("names", metavar="[CASE]...", nargs=-1)
@click.option("--integrator", "integrators", multiple=True, help="Only this integrator; may be repeated.")
@click.option("--spp", type=int, default=1024, help="Samples per pixel of images of 64 pixels that all see the same.")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@click.option("--markdown", is_flag=True, help="Print a table in Markdown.")
@options.seed
@options.quiet
def command(
    names: tuple[str, ...],
    integrators: tuple[str, ...],
    spp: int,
    as_json: bool,
    markdown: bool,
    seed: int,
    quiet: bool,
) -> None:
    """Compare integrators with closed-form solutions.

    A CASE is a scene whose radiance is given by a formula; without CASE, all are rendered. The exit code is 1 if a
    result is wrong.
    """
    from djpt.description.registry import registered
    from djpt.validation.closed_forms import CASES, validate

    require_positive(spp=spp)
    for name in names:
        if name not in CASES:
            raise RenderError(f"unknown closed form '{name}'{near_miss(name, CASES)}")
    cases = [CASES[name] for name in names or CASES]
    able = {name for case in cases for name in case.integrators}
    for name in integrators:
        if name not in registered("integrator"):
            raise RenderError(f"unknown integrator '{name}'{near_miss(name, able)}")
        if name not in able:
            raise RenderError(f"the integrator '{name}' can't find the light of any of the cases{near_miss('', able)}")
    outcomes = []
    for outcome in validate(cases, integrators or None, spp=spp, seed=seed):
        outcomes.append(outcome)
        if not (quiet or as_json or markdown):
            good = "ok" if outcome.passed else "FAILED"
            print(
                f"{outcome.case:<20} {outcome.integrator:<12} {outcome.found:.5f} +- {outcome.error:.1e}  "
                f"{outcome.relative:+.3%} of {outcome.expected:.5f}  z {outcome.z:+.2f}  {good}",
                flush=True,
            )
    if as_json:
        print(json.dumps([asdict(outcome) | {"passed": outcome.passed} for outcome in outcomes], indent=1))
    if markdown:
        print(table(cases, outcomes))
    wrong = sum(not outcome.passed for outcome in outcomes)
    if not (quiet or as_json or markdown):
        print(f"{len(outcomes) - wrong} of {len(outcomes)} are right")
    if wrong:
        raise click.exceptions.Exit(ExitCode.DIFFERENT)


def table(cases: Sequence[ClosedForm], outcomes: Sequence[Outcome]) -> str:
    """The results as a table of Markdown: a row for each closed form."""
    lines = ["| closed form | formula | source | integrators | worst error |", "|---|---|---|---|---|"]
    for case in cases:
        of_case = [outcome for outcome in outcomes if outcome.case == case.name]
        if not of_case:
            continue
        worst = max(of_case, key=lambda outcome: abs(outcome.z))
        names = ", ".join(f"`{outcome.integrator}`" + ("" if outcome.passed else " (wrong)") for outcome in of_case)
        formula = case.formula.replace("|", "\\|")
        lines.append(f"| {case.name} | {formula} | {case.source} | {names} | {worst.relative:+.3%}, z {worst.z:+.1f} |")
    return "\n".join(lines)

"""The command ``djpt gradcheck``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from djpt.cli import options
from djpt.cli.console import Command, ExitCode, parameters, progress_bar, require_positive, say
from djpt.errors import ParameterError

if TYPE_CHECKING:
    from djpt.validation.gradcheck import GradientCheck

__all__ = ["command"]


@click.command("gradcheck", cls=Command, epilog=options.SCENE)
@options.scene
@click.argument("keys", metavar="[KEY]...", nargs=-1)
@click.option("--spp", type=int, default=64, help="Samples per pixel of each render.")
@click.option("--seeds", type=int, default=8, help="Renders of each estimate at first.")
@click.option("--most-seeds", type=int, default=64, help="At most: seeds are added while noise is too large.")
@click.option("--precision", type=float, default=0.01, help="The standard error that is aimed at, as a share.")
@click.option("--samples", type=int, default=4, help="Entries of large parameters, such as texels, to check.")
@click.option("--sensor", type=click.IntRange(min=0), default=0, help="Which of the scene's sensors, counted from 0.")
@click.option("--mitsuba/--no-mitsuba", default=None, help="Compare with Mitsuba. Default: if it can be done.")
@options.output("A picture of the derivatives for one KEY, or a folder of pictures for several. Default: none")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@options.seed
@options.width
@options.height
@options.integrator
@options.define
@options.quiet
def command(
    scene: str,
    keys: tuple[str, ...],
    spp: int,
    seeds: int,
    most_seeds: int,
    precision: float,
    samples: int,
    sensor: int,
    mitsuba: bool | None,
    output: Path | None,
    as_json: bool,
    seed: int,
    width: int | None,
    height: int | None,
    integrator: str | None,
    define: tuple[str, ...],
    quiet: bool,
) -> None:
    """Check the gradients of SCENE by the parameters KEY.

    Reverse mode is compared with forward mode, with finite differences, and with Mitsuba. Without KEY all parameters
    are checked that have derivatives and don't move shapes. The exit code is 1 if a gradient is wrong.
    """
    from djpt.description.overrides import described, override
    from djpt.images.image import check_writable

    require_positive(spp=spp, seeds=seeds, most_seeds=most_seeds, width=width, height=height)
    name, description = described(scene, parameters(define))
    from djpt.description.loader import load_dict
    from djpt.validation.gradcheck import check_gradient

    chosen = keys or smooth_keys(load_dict(override(description, integrator=integrator)))
    if output is not None and len(chosen) == 1:
        check_writable(output)
    results, unchecked = [], []
    for key in chosen:
        try:
            with progress_bar(key, "seeds", quiet or as_json) as progress:
                result = check_gradient(
                    description,
                    key,
                    spp=spp,
                    seeds=seeds,
                    most_seeds=most_seeds,
                    precision=precision,
                    samples=samples,
                    sensor=sensor,
                    seed=seed,
                    width=width,
                    height=height,
                    integrator=integrator,
                    mitsuba=mitsuba,
                    progress=progress,
                )
        except ParameterError as error:
            if keys:
                raise
            unchecked.append(str(error))
            continue
        results.append(replace(result, name=name))
        if output is not None:
            target = output if len(chosen) == 1 else output / f"{key}.png"
            target.parent.mkdir(parents=True, exist_ok=True)
            result.write_picture(target)
        if not (quiet or as_json):
            print(results[-1])
    if as_json:
        found = {"scene": name, "checks": [summary(result) for result in results], "unchecked": unchecked}
        print(json.dumps(found, indent=1))
    elif not quiet:
        wrong = [result.key for result in results if not result.passed]
        names = f"; wrong: {', '.join(wrong)}" if wrong else ""
        say(f"{len(results) - len(wrong)} of {len(results)} gradients are right{names}")
        for reason in unchecked:
            say(f"not checked: {reason}")
    if not all(result.passed for result in results):
        raise click.exceptions.Exit(ExitCode.DIFFERENT)


def smooth_keys(scene: Any) -> list[str]:
    """The parameters that have derivatives without silhouettes."""
    import djpt

    params = djpt.traverse(scene)
    moving = djpt.ParamFlags.Discontinuous
    return [key for key in params if params.flags(key).differentiable and not params.flags(key) & moving]


def summary(result: GradientCheck) -> dict[str, Any]:
    """A result as JSON."""
    return {
        "key": result.key,
        "passed": result.passed,
        "seeds": result.seeds,
        "spp": result.spp,
        "resolution": result.resolution,
        "gradient": result.gradient[:16].tolist(),
        "verdicts": [
            {"what": v.what, "found": v.found, "expected": v.expected, "z": v.z, "passed": v.passed}
            for v in result.verdicts
        ],
        "notes": list(result.notes),
    }

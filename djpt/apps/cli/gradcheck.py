"""The command ``djpt gradcheck``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, ExitCode, described_scene, require_positive, say
from djpt.errors import ParameterError
from djpt.rendering.progress import progress_bar

if TYPE_CHECKING:
    from djpt.validation.gradcheck import GradientCheck

__all__ = ["command"]

SIDE = 64
"""The default of `djpt.validation.check_gradient`, which isn't imported for the help."""


@click.command("gradcheck", cls=Command, epilog=options.SCENE)
@options.scene
@click.argument("keys", metavar="[KEY]...", nargs=-1)
@click.option("--spp", type=int, default=64, help="Samples per pixel of each render.")
@click.option("--seeds", type=int, default=8, help="Number of seeds to start with.")
@click.option("--most-seeds", type=int, default=64, help="Largest number; seeds are added up to --precision.")
@click.option("--precision", type=float, default=0.01, help="Standard error to reach, relative to the derivative.")
@click.option("--samples", type=int, default=4, help="Single entries to check of large parameters such as bitmaps.")
@click.option("--sensor", type=click.IntRange(min=0), default=0, help="Index of the sensor, from 0.")
@click.option("--mitsuba/--no-mitsuba", default=None, help="Compare with Mitsuba. Default: if possible.")
@options.output("Picture of the derivatives, or, for several KEYs, a folder of pictures. Default: none")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@options.seed
@click.option("--width", type=int, help=f"Width in pixels. Default: the scene's, at most {SIDE} on the longer side.")
@click.option("--height", type=int, help="Height in pixels. Default: follows from --width.")
@options.integrator
@options.define
@options.quiet
def command(
    scene: str,
    keys: tuple[str, ...],
    width: int | None,
    height: int | None,
    integrator: str | None,
    output: Path | None,
    as_json: bool,
    define: tuple[str, ...],
    quiet: bool,
    **settings: Any,
) -> None:
    """Check the gradients of SCENE with respect to the parameters KEY.

    Compares reverse mode with forward mode, with finite differences and with Mitsuba. Without KEY, checks all
    differentiable parameters that don't move shapes. The exit code is 1 if a gradient is wrong.
    """
    from djpt.images.image import check_writable

    counts = {name: settings[name] for name in ("spp", "seeds", "most_seeds")}
    require_positive(**counts, width=width, height=height)
    name, description = described_scene(scene, define, integrator=integrator)
    from djpt.description.loader import load_dict
    from djpt.validation.gradcheck import check_gradient

    chosen = keys or smooth_keys(load_dict(description))
    if output is not None and len(chosen) == 1:
        check_writable(output)
    results, unchecked = [], []
    for key in chosen:
        try:
            with progress_bar(key, "renders", quiet or as_json) as progress:
                result = check_gradient(description, key, width=width, height=height, progress=progress, **settings)
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
    """The differentiable parameters that move no silhouettes."""
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

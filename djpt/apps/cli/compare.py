"""The command ``djpt compare``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, ExitCode, parameters, require_positive, say
from djpt.core.files import require_different
from djpt.rendering.progress import progress_bar

if TYPE_CHECKING:
    from djpt.validation.comparison import Comparison

__all__ = ["command"]

STORED = ("spp", "seed", "schedule", "width", "height", "rfilter", "integrator")
"""The settings that count for a reference."""

EPILOG = (
    "A and B are XML files, models, built-in scenes (see 'djpt scenes') or images. References, written by --store, "
    "also record their noise. Exit code: 0 if A and B agree, 1 if they differ, 2 if the input is wrong."
)


@click.command("compare", cls=Command, epilog=EPILOG)
@click.argument("a", metavar="A", shell_complete=options.complete_scene)
@click.argument("b", metavar="[B]", required=False, shell_complete=options.complete_scene)
@click.option("--spp", type=int, default=64, help="Samples per pixel of rendered images.")
@click.option("--reference-spp", type=int, help="Samples per pixel of B. Default: the same.")
@click.option("--rmse", type=float, help="Fail if the RMSE exceeds this.")
@click.option("--mae", type=float, help="Fail if the mean absolute error exceeds this.")
@click.option("--relmse", type=float, help="Fail if the relative mean squared error exceeds this.")
@click.option("--bias", type=float, help="Fail if the relative bias of the image mean exceeds this in magnitude.")
@click.option("--psnr", type=float, help="Fail if the PSNR of the displayed images is below this, in dB.")
@click.option("--ssim", type=float, help="Fail if the SSIM of the displayed images is below this.")
@click.option("--flip", type=float, help="Fail if the mean FLIP of the displayed images exceeds this.")
@click.option("--hdr-flip", type=float, help="Fail if the mean HDR-FLIP exceeds this.")
@click.option("--z", type=float, help="Fail if the bias of a channel's mean exceeds this, in standard errors.")
@click.option("--same-seed", type=float, help="Fail if a smaller share of pixels, 0 to 1, agrees at equal seeds.")
@click.option("--tests/--no-tests", default=True, help="Test whether noise explains the difference.")
@click.option(
    "--significance", type=float, default=1e-3, help="False-alarm rate of each of the four families of tests."
)
@click.option("--integrator-b", help="Integrator of B. Without B, djpt renders scene A with it.")
@click.option("--schedule", default="auto", help="djpt's schedule: auto, flat, machine or wave.")
@click.option("--schedule-b", help="djpt's schedule for B. Without B, djpt renders scene A with it.")
@options.output("Picture, png or jpg. Default: NAME_comparison.png")
@click.option("--picture/--no-picture", default=None, help="Write A | B | difference. Default: without --report.")
@click.option("--report", type=click.Path(path_type=Path), help="Write a page with all pictures and numbers, .html.")
@click.option("--store", type=click.Path(path_type=Path), help="Render A alone and store it as a reference, .exr.")
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON.")
@options.seed
@options.width
@options.height
@options.rfilter
@options.integrator
@options.define
@options.quiet
def command(
    a: str,
    b: str | None,
    output: Path | None,
    picture: bool | None,
    report: Path | None,
    store: Path | None,
    as_json: bool,
    define: tuple[str, ...],
    quiet: bool,
    **settings: Any,
) -> None:
    """Compare A with B, or djpt's image of the scene A with Mitsuba's.

    Scenes are rendered, images are read. The exit code is 1 if a test or a threshold fails.
    """
    from djpt.images.image import check_writable
    from djpt.validation.comparison import Comparison
    from djpt.validation.report import check_page

    require_positive(**{name: settings[name] for name in ("spp", "reference_spp", "width", "height")})
    if store is not None:
        refuse_beside_store(b, report, as_json)
        require_different({"--store": store}, {"A": Path(a)})
        keep(store, a, define, quiet, **{name: settings[name] for name in STORED})
        return
    target = output or Path(f"{Path(a).stem}_comparison.png")
    drawn = picture if picture is not None else output is not None or (report is None and not as_json)
    if drawn:
        check_writable(target)
        Comparison.check_picture(target)
    if report is not None:
        check_page(report, "--report")
    require_different(
        {"--output": target if drawn else None, "--report": report},
        {"A": Path(a), "B": None if b is None else Path(b)},
    )
    from djpt.validation.compare import compare
    from djpt.validation.metrics import LIMITS

    limits = {name: settings.pop(name) for name in LIMITS}
    with progress_bar("comparing", "renders", quiet or as_json) as progress:
        result = compare(a, against=b, limits=limits, parameters=parameters(define), progress=progress, **settings)
    if drawn:
        result.write_picture(target)
    if report is not None:
        result.write_page(report)
    tell(result, target if drawn else None, report, as_json, quiet)
    if not result.passed:
        raise click.exceptions.Exit(ExitCode.DIFFERENT)


def tell(result: Comparison, picture: Path | None, report: Path | None, as_json: bool, quiet: bool) -> None:
    """Print what was found."""
    if as_json:
        print(json.dumps(result.summary(), indent=1))
    elif not quiet:
        print(result)
        for what, path in (("picture", picture), ("report", report)):
            if path is not None:
                say(f"{what}: {path}")


def keep(target: Path, a: str, define: tuple[str, ...], quiet: bool, **settings: Any) -> None:
    """Render A and store it."""
    from djpt.images.image import check_writable
    from djpt.validation.compare import store_reference

    check_writable(target)
    with progress_bar("rendering", "renders", quiet) as progress:
        stored = store_reference(target, a, parameters=parameters(define), progress=progress, **settings)
    if not quiet:
        height, width, _ = stored.batches.shape
        say(f"{target}: {width} x {height}, {stored.batch_spp * stored.batches.count} spp")


def refuse_beside_store(b: str | None, report: Path | None, as_json: bool) -> None:
    """Raise a usage error for what --store has no use for."""
    for name, unused in (("B", b is None), ("--report", report is None), ("--json", not as_json)):
        if not unused:
            raise click.UsageError(f"--store renders A alone, without {name}")

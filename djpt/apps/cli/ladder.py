"""The command ``djpt ladder``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, described_scene, require_positive, say
from djpt.rendering.progress import progress_bar

__all__ = ["command"]


@click.command("ladder", cls=Command, epilog=options.SCENE)
@options.scene
@options.output("HTML page to write.", "ladder.html")
@click.option(
    "--time", "seconds", type=float, default=10.0, help="Time for the largest image of an algorithm, in seconds."
)
@click.option("--spp", type=int, help="Samples per pixel of the largest image, instead of --time.")
@click.option("--reference", default="own", help="own (djpt's path, other seeds) or mitsuba.")
@click.option("--reference-spp", type=int, help="Samples per pixel of the reference.")
@options.size
@options.seed
@options.define
@options.quiet
def command(scene: str, output: Path, size: int | None, define: tuple[str, ...], quiet: bool, **settings: Any) -> None:
    """Write a page that compares the errors of all algorithms.

    Each algorithm renders SCENE at several sample counts.
    """
    from djpt.validation.integrator_comparison.measure import measure
    from djpt.validation.integrator_comparison.page import html
    from djpt.validation.report import check_page, write_page

    require_positive(spp=settings["spp"], reference_spp=settings["reference_spp"], size=size)
    check_page(output, "the comparison of algorithms")
    name, description = described_scene(scene, define)
    with progress_bar("measuring", "algorithms", quiet) as progress:
        found = measure(description, width=size, name=name, progress=progress, **settings)
    write_page(output, html(found))
    if not quiet:
        for rung in found.measured:
            last, floor = rung.last, ", at its floor" if rung.at_floor else ""
            say(f"{rung.step.title:<20} {last.spp:>7} spp {last.seconds:7.2f} s  RMSE {last.rmse:.4g}{floor}")
        for no in found.refused:
            say(f"{no.step.title:<20} refused: {no.reason}")
        say(f"page: {output}")

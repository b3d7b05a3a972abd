"""The command ``djpt strategies``."""

from __future__ import annotations

import time
from pathlib import Path

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, number_or_word, parameters, require_positive
from djpt.rendering.progress import progress_bar

__all__ = ["command"]


@click.command("strategies", cls=Command, epilog=options.SCENE)
@options.scene
@options.output("Picture, png or jpg.", "strategies.png")
@click.option("--max-depth", type=int, default=5, help="Edges of the longest path, 2 to 8.")
@click.option("--spp", type=int, default=64, help="Samples per pixel.")
@click.option("--exposure", metavar="STOPS", default="auto", help="Exposure in stops, or 'auto' for each row.")
@options.size
@options.seed
@options.define
@options.quiet
def command(
    scene: str,
    output: Path,
    max_depth: int,
    spp: int,
    exposure: str,
    size: int | None,
    seed: int,
    define: tuple[str, ...],
    quiet: bool,
) -> None:
    """Show the light that each strategy of bdpt finds in SCENE.

    Strategy (s, t) joins s vertices from a light and t from the camera. Each row shows paths of one length: first all
    rows with the strategies' weights, then all rows with each strategy alone.
    """
    from djpt.apps.cli.strips import checked, write_rows
    from djpt.scenes.overrides import described
    from djpt.validation.integrator_comparison.strips import pyramid

    require_positive(spp=spp, max_depth=max_depth, size=size)
    target = checked(output)
    description = described(scene, parameters(define))[1]
    start = time.perf_counter()
    with progress_bar("rendering", "samples", quiet) as progress:
        rows = pyramid(
            description,
            max_depth,
            spp,
            exposure=number_or_word(exposure),
            width=size,
            seed=seed,
            progress=progress,
        )
    write_rows(target, rows, start, quiet)

"""The command ``djpt bounces``."""

from __future__ import annotations

import time
from pathlib import Path

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, number_or_word, parameters, require_positive
from djpt.rendering.progress import progress_bar

__all__ = ["command"]


@click.command("bounces", cls=Command, epilog=options.SCENE)
@options.scene
@options.output("Picture, png or jpg.", "bounces.png")
@click.option("--max-depth", type=int, default=6, help="Edges of the longest path: the number of terms.")
@click.option("--spp", type=int, default=256, help="Samples per pixel.")
@options.exposure
@options.columns
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
    columns: int | None,
    size: int | None,
    seed: int,
    define: tuple[str, ...],
    quiet: bool,
) -> None:
    """Show the light of SCENE separated by its number of bounces.

    The pictures are E, KE, K^2 E, .. and their sum.
    """
    from djpt.apps.cli.strips import checked, write
    from djpt.scenes.overrides import described
    from djpt.validation.integrator_comparison.strips import bounces

    require_positive(spp=spp, max_depth=max_depth, size=size, columns=columns)
    target = checked(output)
    description = described(scene, parameters(define))[1]
    start = time.perf_counter()
    with progress_bar("rendering", "samples", quiet) as progress:
        tiles = bounces(
            description,
            max_depth,
            spp,
            exposure=number_or_word(exposure),
            width=size,
            seed=seed,
            progress=progress,
        )
    write(target, tiles, columns, start, quiet)

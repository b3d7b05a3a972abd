"""The command ``djpt spp``."""

from __future__ import annotations

import time
from pathlib import Path

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, parameters, require_positive
from djpt.rendering.progress import progress_bar

__all__ = ["command"]


@click.command("spp", cls=Command, epilog=options.SCENE)
@options.scene
@options.output("Picture, png or jpg.", "spp.png")
@click.option("--most", type=int, default=4096, help="Samples per pixel of the last picture.")
@options.integrator
@click.option("--reference-spp", type=int, help="Samples per pixel of the reference. Default: 4 times --most.")
@click.option("--repeats", type=int, default=4, help="Images with different seeds over which each RMSE is averaged.")
@options.columns
@options.size
@options.seed
@options.define
@options.quiet
def command(
    scene: str,
    output: Path,
    most: int,
    integrator: str | None,
    reference_spp: int | None,
    repeats: int,
    columns: int | None,
    size: int | None,
    seed: int,
    define: tuple[str, ...],
    quiet: bool,
) -> None:
    """Show SCENE with increasing numbers of samples per pixel.

    The pictures have 1, 16, 64, 256, .. samples per pixel and are labelled with their RMSE.
    """
    from djpt.apps.cli.strips import checked, write
    from djpt.scenes.overrides import described
    from djpt.validation.integrator_comparison.strips import samples

    require_positive(most=most, reference_spp=reference_spp, repeats=repeats, size=size, columns=columns)
    target = checked(output)
    description = described(scene, parameters(define))[1]
    start = time.perf_counter()
    with progress_bar("rendering", "spp", quiet) as progress:
        tiles = samples(
            description,
            most,
            integrator=integrator,
            reference_spp=reference_spp,
            repeats=repeats,
            width=size,
            seed=seed,
            progress=progress,
        )
    write(target, tiles, columns, start, quiet)

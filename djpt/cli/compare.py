"""The command ``djpt compare``."""

from __future__ import annotations

from pathlib import Path

import click

from djpt.cli import options
from djpt.cli.console import Command, ExitCode, parameters, progress_bar, require_positive

__all__ = ["command"]


@click.command("compare", cls=Command, epilog=options.SCENE)
@options.scene
@click.option("--spp", type=int, default=64, help="Samples per pixel of djpt's image.")
@click.option("--rmse", type=float, help="Fail if the RMSE is above this.")
@click.option("--same-seed", type=float, help="Fail if a smaller share of pixels agrees at equal seeds, 0 to 1.")
@click.option("--reference-spp", type=int, help="Samples per pixel of Mitsuba's image. Default: the same.")
@options.output("The picture, png or jpg. Default: SCENE_comparison.png")
@click.option("--picture/--no-picture", default=True, help="Write ours | Mitsuba | difference.")
@options.seed
@options.width
@options.height
@options.rfilter
@options.integrator
@options.define
@options.quiet
def command(
    scene: str,
    spp: int,
    rmse: float | None,
    same_seed: float | None,
    reference_spp: int | None,
    output: Path | None,
    picture: bool,
    seed: int,
    width: int | None,
    height: int | None,
    rfilter: str | None,
    integrator: str | None,
    define: tuple[str, ...],
    quiet: bool,
) -> None:
    """Compare djpt's image of SCENE with Mitsuba's.

    The exit code is 1 if they differ.
    """
    from djpt.description.document import Document
    from djpt.description.overrides import described
    from djpt.images.image import check_writable
    from djpt.validation.compare import compare

    require_positive(spp=spp, reference_spp=reference_spp, width=width, height=height)
    name, description = described(scene, parameters(define))
    target = output or Path(f"{name}_comparison.png")
    if picture:
        check_writable(target)
    with progress_bar("comparing", "renders", quiet) as progress:
        result = compare(
            description if isinstance(description, Document) else scene,
            spp,
            rmse,
            same_seed=same_seed,
            reference_spp=reference_spp,
            seed=seed,
            width=width,
            height=height,
            rfilter=rfilter,
            integrator=integrator,
            progress=progress,
        )
    if picture:
        result.write_picture(target)
    if not quiet:
        print(result)
        if picture:
            print(f"picture: {target}")
    if not result.passed:
        raise click.exceptions.Exit(ExitCode.DIFFERENT)

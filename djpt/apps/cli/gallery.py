"""The command ``djpt gallery``."""

from __future__ import annotations

import time
from pathlib import Path

import click

import djpt
from djpt.apps.cli import options
from djpt.apps.cli.console import Command, announce, require_positive, say
from djpt.errors import RenderError
from djpt.rendering.progress import has_terminal, progress_bar

__all__ = ["command"]


@click.command("gallery", cls=Command)
@click.argument("names", metavar="[NAME]..", nargs=-1)
@options.output("Picture, png or jpg.", "gallery.png")
@click.option("--spp", type=int, default=512, help="Samples per pixel.")
@click.option("--size", type=int, default=200, help="Width and height of a panel in pixels.")
@options.seed
@options.quiet
def command(names: tuple[str, ...], output: Path, spp: int, size: int, seed: int, quiet: bool) -> None:
    """Render a ball of each material, side by side.

    NAMEs select panels. Default: all of them.
    """
    from djpt.images.formats import DISPLAY_FORMATS
    from djpt.images.image import check_writable
    from djpt.scenes.gallery import panels, sheet

    require_positive(spp=spp, size=size)
    check_writable(output)
    if output.suffix.lower() not in DISPLAY_FORMATS:
        raise RenderError(f"a gallery has labels, so it is written as png or jpg, found '{output}'")
    chosen = panels(names)
    start = time.perf_counter()
    begin = None if quiet or has_terminal() else announce
    with progress_bar("rendering", "samples", quiet) as progress:
        djpt.write(output, sheet(chosen, size, spp, seed, progress=progress, begin=begin))
    if not quiet:
        seconds = time.perf_counter() - start
        say(f"{output}: {len(chosen)} panels of {size} x {size}, {spp} spp, {seconds:.2f} s")

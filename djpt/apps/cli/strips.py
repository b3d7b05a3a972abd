"""The commands ``djpt bounces``, ``spp``, ``strategies`` and ``gallery``, which write pictures side by side."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, announce, described_scene, number_or_word, require_positive, say
from djpt.errors import RenderError
from djpt.rendering.progress import has_terminal, progress_bar

__all__ = ["bounces", "gallery", "spp", "strategies"]


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
def bounces(max_depth: int, spp: int, exposure: str, columns: int | None, **chosen: Any) -> None:
    """Show the light of SCENE separated by its number of bounces.

    The pictures are E, KE, K^2 E, .. and their sum.
    """
    from djpt.validation.integrator_comparison import strips

    require_positive(spp=spp, max_depth=max_depth, columns=columns)
    write(strips.bounces, (max_depth, spp), {"exposure": number_or_word(exposure)}, columns=columns, **chosen)


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
def spp(
    most: int, integrator: str | None, reference_spp: int | None, repeats: int, columns: int | None, **chosen: Any
) -> None:
    """Show SCENE with increasing numbers of samples per pixel.

    The pictures have 1, 16, 64, 256, .. samples per pixel and are labelled with their RMSE.
    """
    from djpt.validation.integrator_comparison import strips

    require_positive(most=most, reference_spp=reference_spp, repeats=repeats, columns=columns)
    settings = {"integrator": integrator, "reference_spp": reference_spp, "repeats": repeats}
    write(strips.samples, (most,), settings, unit="spp", columns=columns, **chosen)


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
def strategies(max_depth: int, spp: int, exposure: str, **chosen: Any) -> None:
    """Show the light that each strategy of bdpt finds in SCENE.

    Strategy (s, t) joins s vertices from a light and t from the camera. Each row shows paths of one length: first all
    rows with the strategies' weights, then all rows with each strategy alone.
    """
    from djpt.validation.integrator_comparison import strips

    require_positive(spp=spp, max_depth=max_depth)
    write(strips.pyramid, (max_depth, spp), {"exposure": number_or_word(exposure)}, **chosen)


@click.command("gallery", cls=Command)
@click.argument("names", metavar="[NAME]..", nargs=-1)
@options.output("Picture, png or jpg.", "gallery.png")
@click.option("--spp", type=int, default=512, help="Samples per pixel.")
@click.option("--size", type=int, default=200, help="Width and height of a panel in pixels.")
@options.seed
@options.quiet
def gallery(names: tuple[str, ...], output: Path, spp: int, size: int, seed: int, quiet: bool) -> None:
    """Render a ball of each material, side by side.

    NAMEs select panels. Default: all of them.
    """
    import djpt
    from djpt.scenes.gallery import panels, sheet

    require_positive(spp=spp, size=size)
    check_labelled(output, "a gallery")
    chosen = panels(names)
    start = time.perf_counter()
    begin = None if quiet or has_terminal() else announce
    with progress_bar("rendering", "samples", quiet) as progress:
        djpt.write(output, sheet(chosen, size, spp, seed, progress=progress, begin=begin))
    if not quiet:
        seconds = time.perf_counter() - start
        say(f"{output}: {len(chosen)} panels of {size} x {size}, {spp} spp, {seconds:.2f} s")


def write(
    rendered: Callable[..., Any],
    counts: tuple[int, ...],
    settings: dict[str, Any],
    *,
    scene: str,
    output: Path,
    size: int | None,
    seed: int,
    define: tuple[str, ...],
    quiet: bool,
    columns: int | None = None,
    unit: str = "samples",
) -> None:
    """Render tiles, or rows of them, write them as a picture, and print its size and the time.

    Raises:
        RenderError: `output` isn't the name of a picture for displays.
        FileError: it can't be written.
    """
    import djpt
    from djpt.images.sheets import captioned_rows, captioned_sheet

    require_positive(size=size)
    check_labelled(output, "a strip")
    description = described_scene(scene, define)[1]
    start = time.perf_counter()
    with progress_bar("rendering", unit, quiet) as progress:
        tiles = rendered(description, *counts, **settings, width=size, seed=seed, progress=progress)
    in_rows = isinstance(tiles[0], list)
    djpt.write(output, captioned_rows(tiles) if in_rows else captioned_sheet(tiles, columns))
    if not quiet:
        shown = [tile for row in tiles for tile in row] if in_rows else tiles
        height, width, _ = shown[0].picture.shape
        say(f"{output}: {len(shown)} pictures of {width} x {height}, {time.perf_counter() - start:.2f} s")


def check_labelled(target: Path, what: str) -> None:
    """Raise `RenderError` unless a file is a picture for displays, and `FileError` unless it can be written."""
    from djpt.images.formats import DISPLAY_FORMATS
    from djpt.images.image import check_writable

    check_writable(target)
    if target.suffix.lower() not in DISPLAY_FORMATS:
        raise RenderError(f"{what} has labels, so it is written as png or jpg, found '{target}'")

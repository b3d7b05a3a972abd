"""The commands that compare: ``djpt ladder``, ``djpt bounces``, ``djpt spp``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from djpt.cli.console import (
    Defines,
    Exposure,
    Quiet,
    SceneName,
    Seed,
    number_or_word,
    parameters,
    progress_bar,
    readable_errors,
    require_positive,
)

if TYPE_CHECKING:
    from djpt.validation.ladder.strips import Panel

__all__ = ["bounces", "ladder", "spp"]

Size = Annotated[int | None, typer.Option(help="Width in pixels; the image keeps its shape. Default: the scene's.")]
Strip = Annotated[Path | None, typer.Option("--output", "-o", help="png or jpg.")]


def ladder(
    scene: SceneName,
    output: Annotated[Path, typer.Option("--output", "-o", help="The page.")] = Path("ladder.html"),
    seconds: Annotated[float, typer.Option("--time", help="Seconds for the largest image of an algorithm.")] = 10.0,
    spp: Annotated[int | None, typer.Option(help="Samples per pixel of the largest image, instead of --time.")] = None,
    reference: Annotated[str, typer.Option(help="own (djpt's path, other seeds) or mitsuba.")] = "own",
    reference_spp: Annotated[int | None, typer.Option(help="Samples per pixel of the reference.")] = None,
    size: Size = None,
    seed: Seed = 0,
    define: Defines = None,
    quiet: Quiet = False,
) -> None:
    """Render SCENE by every algorithm and write a page that compares their errors."""
    with readable_errors():
        from djpt.description.overrides import described
        from djpt.errors import FileError, RenderError
        from djpt.validation.ladder.measure import measure
        from djpt.validation.ladder.page import html

        require_positive(spp=spp, reference_spp=reference_spp, size=size)
        if output.suffix.lower() not in (".html", ".htm"):
            raise RenderError(f"the page is written as html, found '{output}'")
        if not output.parent.is_dir():
            raise FileError(f"can't write '{output}': there is no folder '{output.parent}'")
        name, description = described(scene, parameters(define))
        with progress_bar("measuring", "algorithms", quiet) as progress:
            found = measure(
                description,
                seconds,
                spp,
                reference,
                reference_spp=reference_spp,
                width=size,
                seed=seed,
                name=name,
                progress=progress,
            )
        output.write_text(html(found), encoding="utf-8")
        if not quiet:
            for rung in found.measured:
                last, floor = rung.last, ", at its floor" if rung.at_floor else ""
                print(f"{rung.step.title:<20} {last.spp:>7} spp {last.seconds:7.2f} s  RMSE {last.rmse:.4g}{floor}")
            for no in found.refused:
                print(f"{no.step.title:<20} refused: {no.reason}")
            print(f"page: {output}")


def bounces(
    scene: SceneName,
    output: Strip = None,
    max_depth: Annotated[int, typer.Option(help="Edges of the longest path: the number of terms.")] = 6,
    spp: Annotated[int, typer.Option(help="Samples per pixel.")] = 256,
    exposure: Exposure = "0",
    columns: Annotated[int | None, typer.Option(help="Pictures in a row. Default: all.")] = None,
    size: Size = None,
    seed: Seed = 0,
    define: Defines = None,
    quiet: Quiet = False,
) -> None:
    """Show the light of SCENE by the number of its bounces: E, KE, K^2 E, .. and their sum."""
    with readable_errors():
        from djpt.description.overrides import described
        from djpt.validation.ladder.strips import bounces as render

        require_positive(spp=spp, max_depth=max_depth, size=size, columns=columns)
        target = checked(output or Path("bounces.png"))
        description = described(scene, parameters(define))[1]
        start = time.perf_counter()
        with progress_bar("rendering", "samples", quiet) as progress:
            panels = render(
                description,
                max_depth,
                spp,
                exposure=number_or_word(exposure),
                width=size,
                seed=seed,
                progress=progress,
            )
        write(target, panels, columns, start, quiet)


def spp(
    scene: SceneName,
    output: Strip = None,
    most: Annotated[int, typer.Option(help="Samples per pixel of the last picture.")] = 4096,
    integrator: Annotated[str | None, typer.Option(help="Integrator, instead of the scene's.")] = None,
    reference_spp: Annotated[int | None, typer.Option(help="Of the reference. Default: 4 times --most.")] = None,
    repeats: Annotated[int, typer.Option(help="Images, with seeds of their own, that an RMSE is the mean of.")] = 4,
    columns: Annotated[int | None, typer.Option(help="Pictures in a row. Default: all.")] = None,
    size: Size = None,
    seed: Seed = 0,
    define: Defines = None,
    quiet: Quiet = False,
) -> None:
    """Show SCENE with 1, 16, 64, 256, .. samples per pixel, with the RMSE of each."""
    with readable_errors():
        from djpt.description.overrides import described
        from djpt.validation.ladder.strips import samples

        require_positive(most=most, reference_spp=reference_spp, repeats=repeats, size=size, columns=columns)
        target = checked(output or Path("spp.png"))
        description = described(scene, parameters(define))[1]
        start = time.perf_counter()
        with progress_bar("rendering", "spp", quiet) as progress:
            panels = samples(
                description,
                most,
                integrator=integrator,
                reference_spp=reference_spp,
                repeats=repeats,
                width=size,
                seed=seed,
                progress=progress,
            )
        write(target, panels, columns, start, quiet)


def checked(target: Path) -> Path:
    """Check that a strip can be written to a file, and return its path."""
    from djpt.errors import RenderError
    from djpt.images.formats import DISPLAY_FORMATS
    from djpt.images.image import check_writable

    check_writable(target)
    if target.suffix.lower() not in DISPLAY_FORMATS:
        raise RenderError(f"a strip has labels, it is written as png or jpg, found '{target}'")
    return target


def write(target: Path, panels: list[Panel], columns: int | None, start: float, quiet: bool) -> None:
    """Write the strip, and print its size and the time that it took."""
    import djpt
    from djpt.validation.ladder.strips import strip

    djpt.write(target, strip(panels, columns))
    if not quiet:
        height, width, _ = panels[0].picture.shape
        print(f"{target}: {len(panels)} pictures of {width} x {height}, {time.perf_counter() - start:.2f} s")

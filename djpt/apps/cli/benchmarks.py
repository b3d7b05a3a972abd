"""The command ``djpt benchmarks``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, ExitCode, parameters, require_positive, say
from djpt.core.files import check_target, writing

__all__ = ["command"]

EPILOG = (
    "SCENE is an XML file, a folder with such files at any depth, or a built-in scene; see 'djpt scenes'. Each gets a "
    "process of its own with an empty kernel cache. Exit code: 0 if all were rendered by both, 1 if some weren't."
)


@click.command("benchmarks", cls=Command, epilog=EPILOG)
@click.argument("scenes", metavar="SCENE...", nargs=-1, required=True, shell_complete=options.complete_scene)
@click.option("--only", default="", metavar="PATTERN", help="Files of folders: a part of their path, or a pattern.")
@click.option("--width", type=int, default=320, help="Width of films in pixels, at most.")
@click.option("--samples", type=int, default=10**6, help="Samples of an image.")
@click.option("--spp", type=int, help="Samples per pixel, at most those of the scene; instead of --samples.")
@click.option("--pairs", type=int, default=5, help="Pairs of images, at most.")
@click.option("--clock", type=click.Choice(["wall", "cpu"]), default="wall", help="cpu: for machines that are busy.")
@click.option("--lanes", type=click.Choice(["8", "16"]), help="Compile for AVX2 or AVX-512. Default: the machine's.")
@click.option("--limit", type=float, default=120.0, help="Seconds that a scene may take.")
@options.define
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="File for the numbers.")
def command(
    scenes: tuple[str, ...],
    only: str,
    width: int,
    samples: int,
    spp: int | None,
    pairs: int,
    clock: str,
    lanes: str | None,
    limit: float,
    define: tuple[str, ...],
    json_file: Path | None,
) -> None:
    """Compare the speed with Mitsuba's, on this machine.

    Both renderers load SCENE and render it in turns. The table has Mitsuba's time / djpt's for images (the median of
    pairs), for the first image and for loading, and the share of pixels that agree at equal seeds.
    """
    from djpt.apps.benchmarks.one_scene import Options
    from djpt.apps.benchmarks.run import measured, scenes_named
    from djpt.apps.benchmarks.table import HEADING, line, numbers, summary
    from djpt.jit.backends import load_backend
    from djpt.validation.bridge import mitsuba_scene

    require_positive(width=width, samples=samples, spp=spp, pairs=pairs, limit=limit)
    if json_file is not None:
        check_target(json_file)
    named = scenes_named(scenes, only)
    chosen = Options(width, spp, samples, pairs, int(lanes) if lanes else None, clock, parameters(define))
    load_backend()
    with mitsuba_scene(None):  # raises now if there is no Mitsuba
        from djpt.apps.benchmarks.measuring import heading, machine

        if lanes:
            from djpt.jit.llvm.lanes import force_lanes

            force_lanes(int(lanes))
        facts = machine()
    amount = f"{spp} spp at most" if spp else f"about {samples} samples"
    what = f"{width} pixels wide at most, {amount}, {pairs} pairs, {clock} time"
    for text in [*heading(facts, what).splitlines(), HEADING]:
        say(text)
    rows = []
    for name, scene in named:
        rows.append(measured(name, scene, chosen, limit))
        for text in line(rows[-1]).splitlines():
            say(text)
        if json_file is not None:
            with writing(json_file) as temporary:
                table = {"machine": facts, "what": what, "rows": [numbers(row) for row in rows]}
                temporary.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    if len(rows) > 1:
        for text in summary(rows):
            say(text)
    if not all(row.image for row in rows):
        raise click.exceptions.Exit(ExitCode.DIFFERENT)

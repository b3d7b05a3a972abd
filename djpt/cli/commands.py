"""The command line: ``djpt render``, ``compare``, ``tonemap``, ``info``, ``scenes``, ``gallery``, ``doctor``.

The commands ``ladder``, ``bounces`` and ``spp``, which compare algorithms, are in `djpt.cli.ladder`.

Exit codes, for scripts: 0 done; 1 a comparison found a difference; 2 wrong input; 3 this machine can't run
it (no usable LLVM, no Mitsuba to compare with); 130 interrupted. Results go to stdout, errors and the progress
bar to stderr; the bar only to a terminal.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

import djpt
from djpt.cli import ladder
from djpt.cli.console import (
    Defines,
    ExitCode,
    Exposure,
    Quiet,
    SceneName,
    Seed,
    Width,
    announce,
    has_terminal,
    number_or_word,
    parameters,
    progress_bar,
    readable_errors,
    require_positive,
    short,
)
from djpt.cli.pictures import channels_for, layers
from djpt.errors import RenderError

__all__ = ["ExitCode", "app", "main", "run"]

app = typer.Typer(
    help="A differentiable path tracer in pure Python over Dr.Jit that reads Mitsuba 3's scenes.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Height = Annotated[int | None, typer.Option(help="Pixels; keeps the shape unless --width is given.")]
RFilter = Annotated[str | None, typer.Option(help="Reconstruction filter, instead of the scene's.")]
IntegratorName = Annotated[str | None, typer.Option("--integrator", help="Integrator, instead of the scene's.")]
WhiteBalance = Annotated[
    str | None,
    typer.Option("--white-balance", metavar="LIGHT", help="What shall look white: kelvin, or R,G,B; for png and jpg."),
]


F = TypeVar("F", bound=Callable[..., Any])


def command(function: F) -> F:
    """Make a command of a function; `djpt --help` lists it with the first line of its docstring, never cut off."""
    summary = (function.__doc__ or "").strip().partition("\n")[0]
    return app.command(short_help=summary)(function)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    if version:
        print(f"djpt {djpt.__version__}")
        raise typer.Exit(ExitCode.DONE)


@command
def render(
    scene: SceneName,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="exr hdr pfm npy (linear), png jpg (sRGB). Default: SCENE.exr"),
    ] = None,
    spp: Annotated[int | None, typer.Option(help="Samples per pixel. Default: the scene's.")] = None,
    seed: Seed = 0,
    width: Width = None,
    height: Height = None,
    rfilter: RFilter = None,
    integrator: IntegratorName = None,
    sensor: Annotated[int, typer.Option(min=0, help="Which of the scene's sensors, counted from 0.")] = 0,
    schedule: Annotated[str, typer.Option(help="How lanes are filled: auto, flat, machine or wave.")] = "auto",
    tonemap: Annotated[
        str | None, typer.Option(help="For png and jpg: srgb (the default: clipped), reinhard, aces or agx.")
    ] = None,
    exposure: Exposure = "0",
    white_balance: WhiteBalance = None,
    define: Defines = None,
    quiet: Quiet = False,
) -> None:
    """Render SCENE to an image file."""
    with readable_errors():
        from djpt.description.overrides import described, override

        require_positive(spp=spp, width=width, height=height)
        name, description = described(scene, parameters(define))
        from djpt.images.image import check_writable

        target = output or Path(f"{name}.exr")
        check_writable(target)
        toned = tonemap is not None or exposure != "0" or white_balance is not None
        tone = _Tone(target, tonemap or "srgb", exposure, white_balance) if toned else None
        description = override(description, width=width, height=height, rfilter=rfilter, integrator=integrator)
        loaded = djpt.load_dict(description)
        names = djpt.channel_names(loaded, sensor=sensor)
        # Before the long render: can the file hold the image?
        kept = channels_for(target, names, len(loaded.sensors()[sensor].film().channel_names()))
        start = time.perf_counter()
        samples = 0
        with progress_bar("rendering", "samples", quiet) as show:

            def progress(done: int, total: int) -> None:
                nonlocal samples
                samples = total
                show(done, total)

            image = djpt.render(
                loaded, sensor=sensor, spp=spp or 0, seed=seed, schedule=schedule, progress=progress
            ).numpy()
        seconds = time.perf_counter() - start
        image = image[..., :kept]
        facts = {"scene": name, **_facts(loaded, sensor, spp, seed), "seconds": f"{seconds:.2f}"}
        if tone is not None:
            image, facts = tone.apply(image), {**facts, **tone.facts}
        stored = names if target.suffix.lower() == ".exr" else None
        djpt.write(target, image, channels=stored, metadata=_carried(target, facts))
        if not quiet:
            rows, columns, _ = image.shape
            speed = f"{short(samples / seconds)}samples/s"
            count = facts["spp"]
            print(f"{target}: {columns} x {rows}, {count} spp, {seconds:.2f} s, {speed}")
            if names[kept:]:
                print(f"without {', '.join(layers(names[kept:]))}: exr and npy hold all channels")


@command
def tonemap(
    image: Annotated[Path, typer.Argument(metavar="IMAGE", help="exr hdr pfm npy: linear values.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="png or jpg. Default: the name of IMAGE with .png")
    ] = None,
    operator: Annotated[str, typer.Option("--tonemap", help="srgb (clipped), reinhard, aces or agx.")] = "srgb",
    exposure: Exposure = "0",
    white_balance: WhiteBalance = None,
    quiet: Quiet = False,
) -> None:
    """Make a picture for displays from an image of any range; its metadata are kept."""
    with readable_errors():
        from djpt.images.image import check_writable, read_metadata, read_pixels

        target = output or image.with_suffix(".png")
        check_writable(target)
        tone = _Tone(target, operator, exposure, white_balance)
        pixels = read_pixels(image)
        # The first channels of an image with layers are the colour.
        shown = tone.apply(pixels if pixels.shape[2] <= 4 else pixels[..., :3])
        facts = read_metadata(image) if image.suffix.lower() == ".exr" else {}
        djpt.write(target, shown, metadata=_carried(target, {**facts, **tone.facts}))
        if not quiet:
            print(f"{target}: {shown.shape[1]} x {shown.shape[0]}")


@command
def compare(
    scene: SceneName,
    spp: Annotated[int, typer.Option(help="Samples per pixel of djpt's image.")] = 64,
    rmse: Annotated[float | None, typer.Option(help="Fail if the RMSE is above this.")] = None,
    same_seed: Annotated[
        float | None, typer.Option(help="Fail if a smaller share of pixels agrees at equal seeds, 0 to 1.")
    ] = None,
    reference_spp: Annotated[
        int | None, typer.Option(help="Samples per pixel of Mitsuba's image. Default: the same.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The picture, png or jpg. Default: SCENE_comparison.png")
    ] = None,
    picture: Annotated[bool, typer.Option(help="Write ours | Mitsuba | difference.")] = True,
    seed: Seed = 0,
    width: Width = None,
    height: Height = None,
    rfilter: RFilter = None,
    integrator: IntegratorName = None,
    define: Defines = None,
    quiet: Quiet = False,
) -> None:
    """Render SCENE in djpt and in Mitsuba and compare: exit code 1 if they differ."""
    with readable_errors():
        from djpt.description.document import Document
        from djpt.description.overrides import described
        from djpt.images.image import check_writable
        from djpt.validation.compare import compare as run

        require_positive(spp=spp, reference_spp=reference_spp, width=width, height=height)
        name, description = described(scene, parameters(define))
        target = output or Path(f"{name}_comparison.png")
        if picture:
            check_writable(target)
        with progress_bar("comparing", "renders", quiet) as progress:
            result = run(
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
        raise typer.Exit(ExitCode.DIFFERENT)


@command
def info(scene: SceneName, define: Defines = None) -> None:
    """Print what SCENE consists of, and how well its triangles can be searched."""
    with readable_errors():
        from djpt.cli.info import describe
        from djpt.description.overrides import described

        print(describe(djpt.load_dict(described(scene, parameters(define))[1])))


@command
def scenes() -> None:
    """List the built-in scenes."""
    with readable_errors():
        from djpt.scenes import NAMES

        width = max(len(name) for name in NAMES)
        for name in NAMES:
            summary = (getattr(djpt.scenes, name).__doc__ or "").strip().splitlines()
            print(f"{name:<{width}}  {summary[0] if summary else ''}".rstrip())


@command
def gallery(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]..", help="Panels; wrong names are answered with all of them.")
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="png or jpg.")] = Path("gallery.png"),
    spp: Annotated[int, typer.Option(help="Samples per pixel.")] = 512,
    size: Annotated[int, typer.Option(help="Width and height of a panel in pixels.")] = 200,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Render a ball of each material, side by side."""
    with readable_errors():
        from djpt.images.formats import DISPLAY_FORMATS
        from djpt.images.image import check_writable
        from djpt.scenes.gallery import panels, sheet

        require_positive(spp=spp, size=size)
        check_writable(output)
        if output.suffix.lower() not in DISPLAY_FORMATS:
            raise RenderError(f"a gallery has labels, it is written as png or jpg, found '{output}'")
        chosen = panels(names or ())
        start = time.perf_counter()
        begin = None if quiet or has_terminal() else announce
        with progress_bar("rendering", "samples", quiet) as progress:
            djpt.write(output, sheet(chosen, size, spp, seed, progress=progress, begin=begin))
        if not quiet:
            seconds = time.perf_counter() - start
            print(f"{output}: {len(chosen)} panels of {size} x {size}, {spp} spp, {seconds:.2f} s")


@command
def doctor() -> None:
    """Print what was found on this machine, what was chosen and why, and what to do."""
    from djpt.cli.doctor import main as examine

    raise typer.Exit(examine())


for compares in (ladder.ladder, ladder.bounces, ladder.spp):
    command(compares)


def main() -> int:
    """Run the command line and return the exit code."""
    try:
        app(prog_name="djpt")
    except SystemExit as end:  # how Click always ends
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return ExitCode.DONE


def run() -> None:
    """Run `main`, and end the process with its exit code."""
    code = main()
    if code == ExitCode.UNUSABLE:
        # Without an LLVM, Dr.Jit's own shutdown has been seen to hang.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


class _Tone:
    """The options of tone mapping, checked before anything is rendered."""

    def __init__(self, target: Path, operator: str, exposure: str, white_balance: str | None) -> None:
        import numpy as np

        from djpt.images.formats import DISPLAY_FORMATS

        if target.suffix.lower() not in DISPLAY_FORMATS:
            raise RenderError(f"tone mapping makes pictures for displays, png or jpg, found '{target}'")
        self.operator = operator
        self.exposure: float | str = number_or_word(exposure)
        self.white_balance: Any = None
        if white_balance is not None:
            parts = [number_or_word(part) for part in white_balance.split(",")]
            self.white_balance = parts[0] if len(parts) == 1 else parts
        self.apply(np.zeros((1, 1, 3), np.float32))
        self.facts = {"tonemap": operator, "exposure": exposure}
        if white_balance is not None:
            self.facts["whiteBalance"] = white_balance

    def apply(self, image: Any) -> Any:
        return djpt.tonemap(image, self.operator, self.exposure, self.white_balance)


def _facts(scene: djpt.Scene, sensor: int, spp: int | None, seed: int) -> dict[str, Any]:
    """The metadata that files of an image carry."""
    from djpt.description.registry import name_of

    def type_of(plugin: Any) -> str:
        return name_of(type(plugin)) or type(plugin).__name__

    sampler, integrator = scene.sensors()[sensor].sampler(), scene.integrator()
    return {
        "Software": f"djpt {djpt.__version__}",
        "integrator": "path" if integrator is None else type_of(integrator),
        "sampler": type_of(sampler),
        "sensor": sensor,
        "spp": sampler.round_count(spp or sampler.sample_count()),
        "seed": seed,
    }


def _carried(target: Path, facts: dict[str, Any]) -> dict[str, Any]:
    """The metadata, if a file of this format can carry them; else none."""
    from djpt.images.formats import METADATA

    return facts if target.suffix.lower() in METADATA else {}

"""The command ``djpt render``."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import djpt
from djpt.apps.cli import options
from djpt.apps.cli.console import Command, described_scene, require_positive, say
from djpt.core.files import require_different
from djpt.core.interruption import ending_at_once
from djpt.errors import RenderError
from djpt.rendering.progress import progress_bar, short

if TYPE_CHECKING:
    from djpt.rendering.settings import RenderSettings

__all__ = ["command"]


@click.command("render", cls=Command, epilog=options.SCENE)
@options.scene
@options.output("exr hdr pfm npy (linear), png jpg (sRGB). Default: SCENE.exr")
@click.option(
    "--spp",
    type=int,
    help="Samples per pixel. Default: the scene's. With --checkpoint, --target-error, --time-budget, --preview, "
    "--cluster or --adaptive they are rendered in rounds of 64, each with a seed of its own: beyond 64 the samples "
    "differ from those of a plain render.",
)
@options.seed
@options.width
@options.height
@options.rfilter
@options.integrator
@click.option("--sensor", type=click.IntRange(min=0), default=0, help="Index of the sensor, from 0.")
@click.option("--schedule", default="auto", help="Schedule of the kernels: auto, flat, machine or wave.")
@click.option("--tonemap", help="Tone curve of png and jpg: srgb (default, clipped), reinhard, aces or agx.")
@options.exposure
@options.white_balance
@click.option("--denoise", is_flag=True, help="Denoise the image; implies the box filter.")
@options.denoiser
@click.option(
    "--raw", type=click.Path(path_type=Path), help="With --denoise: an exr for the noisy image and the guides."
)
@click.option("--keep-partial", is_flag=True, help="On SIGINT or SIGTERM, write the partial image.")
@click.option("--checkpoint", type=click.Path(path_type=Path), help="Save progress to this file at intervals.")
@click.option("--every", default="60s", help="Interval between checkpoints: 90s, 10m, 1h30m.")
@click.option(
    "--resume",
    is_flag=True,
    help="Continue from the checkpoint, if it exists; it must have the same scene, seed, schedule and versions.",
)
@click.option("--target-error", help="Stop at this relative RMSE: 1% or 0.01.")
@click.option("--time-budget", help="Stop after this time: 90s, 10m, 1h30m.")
@click.option("--preview", type=click.Path(path_type=Path), help="Write a picture of the progress at intervals.")
@click.option("--cluster", metavar="ADDRESS", help="Render on the workers of a scheduler, such as tcp://host:8786.")
@click.option("--adaptive", is_flag=True, help="Take more samples where there is more noise; --spp is the average.")
@options.define
@options.quiet
def command(
    scene: str,
    output: Path | None,
    spp: int | None,
    seed: int,
    rfilter: str | None,
    sensor: int,
    schedule: str,
    tonemap: str | None,
    exposure: str,
    white_balance: str | None,
    denoise: bool,
    denoiser: str,
    raw: Path | None,
    keep_partial: bool,
    checkpoint: Path | None,
    preview: Path | None,
    define: tuple[str, ...],
    quiet: bool,
    **chosen: Any,
) -> None:
    """Render SCENE to an image file."""
    from djpt.apps.cli.passes import passes_of
    from djpt.description.files import files_of

    require_positive(spp=spp)
    changes = {option: chosen.pop(option) for option in ("width", "height", "integrator")}
    changes["rfilter"] = rfilter or ("box" if denoise else None)
    name, description = described_scene(scene, define, **changes)
    in_rounds = passes_of(checkpoint=checkpoint, preview=preview, **chosen)
    # NumPy is imported after the scene was found.
    from djpt.apps.cli.pictures import Stored, Tone
    from djpt.images.image import check_writable
    from djpt.rendering.settings import RenderSettings

    target = output or Path(f"{name}.exr")
    check_writable(target)
    require_different(
        {"--output": target, "--checkpoint": checkpoint, "--preview": preview, "--raw": raw},
        {f"the scene's '{path}'": path for path in files_of(description)},
    )
    toned = tonemap is not None or exposure != "0" or white_balance is not None
    tone = Tone(target, tonemap or "srgb", exposure, white_balance) if toned else None
    if raw is not None and not denoise:
        raise RenderError("--raw writes the input of --denoise: give both, or --output alone")
    loaded = djpt.load_dict(description)
    settings = RenderSettings.of(loaded, sensor, seed=seed, spp=spp or 0, schedule=schedule)
    names = djpt.channel_names(loaded, sensor=sensor)
    # Before the long render: can the file hold the image?
    stored = Stored(target, names, len(settings.sensor.film().channel_names()))
    clean = cleaner(loaded, denoiser, settings, raw) if denoise else None
    start = time.perf_counter()
    samples = 0

    def convert(rows: Any) -> Any:
        colours = (rows if clean is None else clean(rows))[..., : stored.kept]
        return colours if tone is None else tone.apply(colours)

    metadata = {"scene": name, **({"denoised": denoiser} if denoise else {}), **({} if tone is None else tone.facts)}
    if in_rounds is not None:
        from djpt.rendering.progressive.to_file import facts

        with ending_at_once():
            found, taken, leave = in_rounds.render(loaded, description, settings, keep_partial, quiet)
            of_image = facts(replace(settings, spp=found.spp), sensor)
            stored.write(convert(found.image().numpy()), {**of_image, **metadata})
            leave()
        if not quiet:
            (columns, rows), seconds = found.size, time.perf_counter() - start
            speed = f"{short(taken * columns * rows / seconds)}samples/s"
            what = f"{columns} x {rows}, {found.spp} spp, error {found.error().overall:.2%}"
            say(f"{target}: {what}, {seconds:.2f} s, {speed}")
        return

    with progress_bar("rendering", "samples", quiet) as show, ending_at_once():

        def progress(done: int, total: int) -> None:
            nonlocal samples
            samples = total
            show(done, total)

        djpt.render_to_file(
            loaded,
            target,
            sensor=sensor,
            seed=seed,
            spp=spp or 0,
            schedule=schedule,
            progress=progress,
            metadata=metadata,
            convert=convert,
            convert_at_once=denoise or exposure == "auto",
            keep_partial=keep_partial,
        )
    seconds = time.perf_counter() - start
    if not quiet:
        columns, rows = settings.sensor.film().crop_size()
        taken, speed = settings.sample_count, f"{short(samples / seconds)}samples/s"
        say(f"{target}: {columns} x {rows}, {taken} spp, {seconds:.2f} s, {speed}")
        stored.say_left_out()


def cleaner(scene: Any, method: str, settings: RenderSettings, raw: Path | None) -> Any:
    """The function that denoises the image, checked before it is rendered."""
    from djpt.errors import FileError
    from djpt.images.image import check_writable
    from djpt.rendering.denoising.rendered import Cleaner

    if raw is not None:
        check_writable(raw)
        if raw.suffix.lower() != ".exr":
            raise FileError(f"can't write '{raw}': only exr has layers for albedo and normals")
    return Cleaner(scene, method, settings, raw)

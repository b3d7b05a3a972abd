"""The command ``djpt render``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import djpt
from djpt.cli import options
from djpt.cli.console import Command, parameters, progress_bar, require_positive, short

if TYPE_CHECKING:
    from djpt.scene import Scene

__all__ = ["command"]


@click.command("render", cls=Command, epilog=options.SCENE)
@options.scene
@options.output("exr hdr pfm npy (linear), png jpg (sRGB). Default: SCENE.exr")
@click.option("--spp", type=int, help="Samples per pixel. Default: the scene's.")
@options.seed
@options.width
@options.height
@options.rfilter
@options.integrator
@click.option("--sensor", type=click.IntRange(min=0), default=0, help="Which of the scene's sensors, counted from 0.")
@click.option("--schedule", default="auto", help="How lanes are filled: auto, flat, machine or wave.")
@click.option("--tonemap", help="For png and jpg: srgb (the default: clipped), reinhard, aces or agx.")
@options.exposure
@options.white_balance
@options.define
@options.quiet
def command(
    scene: str,
    output: Path | None,
    spp: int | None,
    seed: int,
    width: int | None,
    height: int | None,
    rfilter: str | None,
    integrator: str | None,
    sensor: int,
    schedule: str,
    tonemap: str | None,
    exposure: str,
    white_balance: str | None,
    define: tuple[str, ...],
    quiet: bool,
) -> None:
    """Render SCENE to an image file."""
    from djpt.description.overrides import described, override

    require_positive(spp=spp, width=width, height=height)
    name, description = described(scene, parameters(define))
    # NumPy is imported after the scene was found.
    from djpt.cli.pictures import channels_for, layers
    from djpt.cli.tone import Tone, carried
    from djpt.images.image import check_writable

    target = output or Path(f"{name}.exr")
    check_writable(target)
    toned = tonemap is not None or exposure != "0" or white_balance is not None
    tone = Tone(target, tonemap or "srgb", exposure, white_balance) if toned else None
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
    found = {"scene": name, **facts(loaded, sensor, spp, seed), "seconds": f"{seconds:.2f}"}
    if tone is not None:
        image, found = tone.apply(image), {**found, **tone.facts}
    stored = names if target.suffix.lower() == ".exr" else None
    djpt.write(target, image, channels=stored, metadata=carried(target, found))
    if not quiet:
        rows, columns, _ = image.shape
        speed = f"{short(samples / seconds)}samples/s"
        print(f"{target}: {columns} x {rows}, {found['spp']} spp, {seconds:.2f} s, {speed}")
        if names[kept:]:
            print(f"without {', '.join(layers(names[kept:]))}: exr and npy hold all channels")


def facts(scene: Scene, sensor: int, spp: int | None, seed: int) -> dict[str, Any]:
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

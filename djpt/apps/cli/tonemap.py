"""The command ``djpt tonemap``."""

from __future__ import annotations

from pathlib import Path

import click

import djpt
from djpt.apps.cli import options
from djpt.apps.cli.console import Command, say
from djpt.core.files import require_different

__all__ = ["command"]


@click.command("tonemap", cls=Command)
@click.argument("image", metavar="IMAGE", type=click.Path(path_type=Path))
@options.output("Picture, png or jpg. Default: the name of IMAGE with .png")
@click.option("--tonemap", "operator", default="srgb", help="srgb (clipped), reinhard, aces or agx.")
@options.exposure
@options.white_balance
@options.quiet
def command(
    image: Path, output: Path | None, operator: str, exposure: str, white_balance: str | None, quiet: bool
) -> None:
    """Convert a high-dynamic-range image to a picture for displays.

    IMAGE holds linear values: exr, hdr, pfm or npy. Its metadata are kept.
    """
    from djpt.apps.cli.tone import Tone, carried
    from djpt.images.image import check_writable, read_metadata, read_pixels

    target = output or image.with_suffix(".png")
    check_writable(target)
    require_different({"--output": target}, {"IMAGE": image})
    tone = Tone(target, operator, exposure, white_balance)
    pixels = read_pixels(image)
    # The first channels of an image with layers are the colour.
    shown = tone.apply(pixels if pixels.shape[2] <= 4 else pixels[..., :3])
    facts = read_metadata(image) if image.suffix.lower() == ".exr" else {}
    djpt.write(target, shown, metadata=carried(target, {**facts, **tone.facts}))
    if not quiet:
        say(f"{target}: {shown.shape[1]} x {shown.shape[0]}")

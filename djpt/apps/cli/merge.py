"""The command ``djpt merge``."""

from __future__ import annotations

from pathlib import Path

import click

import djpt
from djpt.apps.cli import options
from djpt.apps.cli.console import Command, say
from djpt.apps.cli.tone import channels_for, layers
from djpt.core.files import require_different
from djpt.errors import RenderError

__all__ = ["command"]


@click.command("merge", cls=Command)
@click.argument("checkpoints", metavar="CHECKPOINT..", nargs=-1, required=True, type=click.Path(path_type=Path))
@options.output("Image (exr hdr pfm npy png jpg) or checkpoint (djpt) to write.")
@options.quiet
def command(checkpoints: tuple[Path, ...], output: Path | None, quiet: bool) -> None:
    """Merge checkpoints of one scene.

    `djpt render --checkpoint` writes them; each render needs its own seed.
    """
    from djpt.images.image import check_writable

    if output is None:
        raise RenderError("no output file: give -o image.exr, or -o all.djpt to merge more later")
    if output.suffix.lower() != ".djpt":
        check_writable(output)
    require_different({"--output": output}, {f"checkpoint {n}": path for n, path in enumerate(checkpoints, 1)})
    total = djpt.Accumulation.load(checkpoints[0])
    for path in checkpoints[1:]:
        total += djpt.Accumulation.load(path)
    width, height = total.size
    left_out: tuple[str, ...] = ()
    if output.suffix.lower() == ".djpt":
        total.save(output)
    else:
        colours = next((i for i, name in enumerate(total.channels) if "." in name), len(total.channels))
        kept = channels_for(output, total.channels, max(1, colours))
        left_out = total.channels[kept:]
        stored = total.channels[:kept] if output.suffix.lower() == ".exr" else None
        djpt.write(output, total.image().numpy()[..., :kept], channels=stored)
    if not quiet:
        say(f"{output}: {width} x {height}, {total.spp} spp, error {total.error().overall:.2%}")
        if left_out:
            say(f"without {', '.join(layers(left_out))}: exr and npy hold all channels")

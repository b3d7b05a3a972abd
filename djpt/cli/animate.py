"""The command ``djpt animate``."""

from __future__ import annotations

from typing import Any

import click

from djpt.cli import options
from djpt.cli.console import Command
from djpt.cli.frames import animate, of_frames
from djpt.errors import ParameterError

__all__ = ["command"]


@click.command("animate", cls=Command, epilog=options.SCENE)
@of_frames
@click.option(
    "--set",
    "tracks",
    metavar="KEY=FRAME:VALUE;..",
    multiple=True,
    help="How a parameter moves: its values at some frames, counted from 0. A value is a number, numbers with commas, "
    "or the 16 of a matrix. May be repeated.",
)
def command(tracks: tuple[str, ...], **chosen: Any) -> None:
    """Render SCENE while its parameters move.

    The parameters are those of `djpt.traverse`. Frames that exist already aren't rendered again.
    """
    if not tracks:
        raise ParameterError("nothing moves: --set KEY=FRAME:VALUE;FRAME:VALUE says what does")
    texts = {}
    for text in tracks:
        key, equals, values = text.partition("=")
        if not equals or key in texts:
            raise ParameterError(f"--set takes KEY=FRAME:VALUE;.. once for each KEY, found '{text}'")
        texts[key] = values

    def moving(scene: Any, sensor: Any) -> dict[str, Any]:
        from djpt.animation.tracks import Track

        return {key: Track.parse(values) for key, values in texts.items()}

    animate(moving, **chosen)

"""The command ``djpt animate``."""

from __future__ import annotations

from typing import Any

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command
from djpt.apps.cli.frames import animate, of_frames
from djpt.errors import ParameterError

__all__ = ["command"]


@click.command("animate", cls=Command, epilog=options.SCENE)
@of_frames
@click.option(
    "--set",
    "tracks",
    metavar="KEY=FRAME:VALUE;..",
    multiple=True,
    help="Keyframes of a parameter: its values at given frames, counted from 0. A value is a number, comma-separated "
    "numbers, or the 16 entries of a matrix. May be repeated.",
)
def command(tracks: tuple[str, ...], **chosen: Any) -> None:
    """Render an animation of parameters of SCENE.

    The parameters are those of `djpt.traverse`. Existing frames are not rendered again.
    """
    if not tracks:
        raise ParameterError("nothing moves: name a parameter with --set KEY=FRAME:VALUE;FRAME:VALUE")
    texts = {}
    for text in tracks:
        key, equals, values = text.partition("=")
        if not equals or key in texts:
            raise ParameterError(f"--set takes KEY=FRAME:VALUE;.. once for each KEY, found '{text}'")
        texts[key] = values

    def moving(scene: Any, sensor: Any) -> dict[str, Any]:
        from djpt.apps.animation.tracks import Track

        return {key: Track.parse(values) for key, values in texts.items()}

    animate(moving, **chosen)

"""The command ``djpt turntable``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command
from djpt.apps.cli.frames import animate, of_frames

if TYPE_CHECKING:
    from djpt.apps.animation.frames import Moving
    from djpt.scene.scene import Scene
    from djpt.sensors import Sensor

__all__ = ["command"]


@click.command("turntable", cls=Command, epilog=options.SCENE)
@of_frames
@click.option("--degrees", type=float, default=360.0, help="Total angle of the orbit.")
def command(degrees: float, **chosen: Any) -> None:
    """Render SCENE from all sides.

    The camera orbits the centre of its view at constant height; a full turn ends one step before the first frame.
    Existing frames are not rendered again.
    """

    def turning(scene: Scene, sensor: Sensor) -> dict[str, Moving]:
        import djpt
        from djpt.apps.animation.tracks import TurningCamera
        from djpt.apps.orbit import OrbitCamera

        names = djpt.traverse(scene).names_of(sensor)
        key = next((name for name in names if name.rpartition(".")[2] == "to_world"), None)
        if key is None:
            raise djpt.RenderError(f"'{sensor.id()}' can't be moved")
        return {key: TurningCamera(OrbitCamera.of(scene, sensor), degrees / chosen["frames"])}

    animate(turning, **chosen)

"""The command ``djpt view``."""

from __future__ import annotations

from typing import Any

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, described_scene, require_positive
from djpt.core.terminal import visible

__all__ = ["command"]


@click.command("view", cls=Command, epilog=options.SCENE)
@options.scene
@click.option("--spp", type=int, default=4096, help="Samples per pixel of the finished picture.")
@options.seed
@options.width
@options.height
@options.rfilter
@options.integrator
@click.option("--sensor", type=click.IntRange(min=0), default=0, help="Index of the sensor, from 0.")
@click.option("--port", type=click.IntRange(0, 65535), default=8642, help="Port of the page. 0: any free port.")
@click.option("--host", default="127.0.0.1", help="Address to listen on, such as 0.0.0.0 for all interfaces.")
@click.option("--open", "opens", is_flag=True, help="Open the page in the browser.")
@options.define
@options.quiet
def command(spp: int, seed: int, sensor: int, port: int, host: str, opens: bool, quiet: bool, **chosen: Any) -> None:
    """Show SCENE on a page while it is rendered.

    The mouse moves the camera, sliders change parameters; the scene is reloaded when its files change. Press Ctrl-C to
    stop. The address of the page contains a secret: anyone who knows it can view the page and change values.
    """
    from djpt.apps.viewer.server import Server
    from djpt.apps.viewer.session import Session

    require_positive(spp=spp)
    with Server(port, host) as server:
        session = Session(lambda: described_scene(**chosen)[1], sensor, spp, seed, server.publish, server.publish)
        if not quiet:
            print(f"{server.url} shows {visible(chosen['scene'])}; press Ctrl-C to stop", flush=True)
        if opens:
            click.launch(server.url)
        session.run(server.inbox)

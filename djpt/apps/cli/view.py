"""The command ``djpt view``."""

from __future__ import annotations

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, parameters, require_positive
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
def command(
    scene: str,
    spp: int,
    seed: int,
    width: int | None,
    height: int | None,
    rfilter: str | None,
    integrator: str | None,
    sensor: int,
    port: int,
    host: str,
    opens: bool,
    define: tuple[str, ...],
    quiet: bool,
) -> None:
    """Show SCENE on a page while it is rendered.

    The mouse moves the camera, sliders change parameters; the scene is reloaded when its files change. Press Ctrl-C to
    stop. The address of the page contains a secret: anyone who knows it can view the page and change values.
    """
    from djpt.apps.viewer.server import Server
    from djpt.apps.viewer.session import Session
    from djpt.scenes.overrides import described, override

    require_positive(spp=spp, width=width, height=height)

    def describe() -> dict[str, object]:
        description = described(scene, parameters(define))[1]
        return override(description, width=width, height=height, rfilter=rfilter, integrator=integrator)

    with Server(port, host) as server:
        session = Session(describe, sensor, spp, seed, server.publish, server.tell)
        if not quiet:
            print(f"{server.url} shows {visible(scene)}; press Ctrl-C to stop", flush=True)
        if opens:
            click.launch(server.url)
        session.run(server.inbox)

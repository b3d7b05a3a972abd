"""Anything with triangles, shown: in a notebook below the cell, elsewhere on the viewer's page."""

from __future__ import annotations

import os
import sys
from typing import Any

from djpt.models.objects import description_of, scene_of
from djpt.rendering.progress import running_notebook
from djpt.scene.scene import Scene

__all__ = ["show"]


def show(x: Any, *, spp: int = 64, seed: int = 0, viewer: bool | None = None, **parameters: Any) -> Any:
    """Show `x`, and return its picture.

    In a notebook the picture stands below the cell. Elsewhere the viewer's page opens in the browser, until Ctrl-C; on
    a machine without a display, or without a terminal, `x` is rendered, and nothing opens.

    Args:
        x: what `djpt.scene_of` takes.
        spp: samples per pixel.
        seed: seed; equal seeds give equal pictures.
        viewer: whether the page opens; default: as said above.
        parameters: those of `djpt.scene_of`.

    Returns:
        A `djpt.Image`, which notebooks show and `write` writes; of the viewer None.

    Raises:
        SceneError: it can't be shown.
        FileError: a file can't be read.
    """
    opens = viewer if viewer is not None else not running_notebook() and has_display()
    if opens and not isinstance(x, Scene):
        view(description_of(x, **parameters), spp, seed)
        return None
    from djpt.images.image import Image
    from djpt.rendering.render import render

    return Image(render(scene_of(x, **parameters), spp=spp, seed=seed))


def has_display() -> bool:
    """True if somebody sits before the terminal of this machine, and a browser can open."""
    windows = sys.platform in ("win32", "darwin") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )
    return windows and sys.stdout.isatty()


def view(description: dict[str, Any], spp: int, seed: int) -> None:
    """Open the viewer's page of a scene, until Ctrl-C."""
    import click

    from djpt.apps.viewer.server import Server
    from djpt.apps.viewer.session import Session

    with Server(0, "127.0.0.1") as server:
        session = Session(lambda: description, 0, spp, seed, server.publish, server.publish)
        print(f"{server.url}; press Ctrl-C to stop", flush=True)
        click.launch(server.url)
        session.run(server.inbox)

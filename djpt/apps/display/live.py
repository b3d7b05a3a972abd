"""A render in a notebook: its image below the cell, while it gets better."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from djpt.errors import RenderError
from djpt.rendering.progress import running_notebook

if TYPE_CHECKING:
    from djpt.rendering.progressive.accumulation import Accumulation

__all__ = ["show_passes"]

INTERVAL = 0.5
"""The least time between two pictures, in seconds."""


def show_passes(passes: Iterator[Accumulation]) -> Accumulation:
    """Show the image of a render in rounds while it is rendered, and return the last accumulation.

    In a notebook the picture stands below the cell, with the samples and the estimated error, and is replaced as
    rounds come; interrupting the kernel ends the render with what exists. Elsewhere nothing is shown::

        done = djpt.show_passes(djpt.render_passes(scene, target_error=0.01))

    Args:
        passes: What `djpt.render_passes` or `djpt.apps.cluster.render_passes` returned.

    Raises:
        RenderError: There were no rounds.
    """
    found, shown, handle = None, 0.0, None
    try:
        for found in passes:
            if running_notebook() and time.perf_counter() - shown >= INTERVAL:
                handle = displayed(found, handle)
                shown = time.perf_counter()
    except KeyboardInterrupt:
        if found is None:
            raise
    if found is None:
        raise RenderError("'passes' has no rounds; expected what djpt.render_passes returned")
    if running_notebook():
        displayed(found, handle)
    return found


def displayed(found: Accumulation, handle: object) -> object:
    """Show an image in the place of `handle`, or in a new one below the cell; returns the place."""
    import base64

    from IPython.display import HTML, display

    from djpt.images.image import Image

    pixels = found.image().numpy()
    data = base64.b64encode(Image(pixels if pixels.shape[2] <= 4 else pixels[..., :3])._repr_png_()).decode()
    error = found.error().overall
    text = f"{found.spp} spp" + (f", error {error:.2%}" if error < float("inf") else "")
    html = HTML(f'<figure><img src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>')
    if handle is None:
        return display(html, display_id=True)
    handle.update(html)  # type: ignore[attr-defined]
    return handle

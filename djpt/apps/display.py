"""Results in notebooks: images below the cell, also those of a render in progress."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from djpt.errors import RenderError
from djpt.rendering.progress import running_notebook, running_shell

if TYPE_CHECKING:
    from djpt.rendering.progressive.accumulation import Accumulation

__all__ = ["LEAST_SIZE", "displayed", "picture_of", "show_images", "show_passes", "source"]

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
                handle = displayed(caption(found), handle)
                shown = time.perf_counter()
    except KeyboardInterrupt:
        if found is None:
            raise
    if found is None:
        raise RenderError("'passes' has no rounds; expected what djpt.render_passes returned")
    if running_notebook():
        displayed(caption(found), handle)
    return found


def caption(found: Accumulation) -> str:
    """An image so far as HTML, with the samples and the estimated error."""
    error = found.error().overall
    text = f"{found.spp} spp" + (f", error {error:.2%}" if error < float("inf") else "")
    return f'<figure><img src="{source(found.image().numpy())}"><figcaption>{text}</figcaption></figure>'


def displayed(text: str, handle: Any) -> Any:
    """Show HTML in the place of `handle`, or in a new one below the cell; returns the place."""
    from IPython.display import HTML, display

    if handle is None:
        return display(HTML(text), display_id=True)
    handle.update(HTML(text))
    return handle


def source(pixels: Any) -> str:
    """Linear pixels (H, W, C) as the address of an image in HTML."""
    from djpt.images.image import Image, png_address

    return png_address(Image(pixels)._repr_png_())


# ---- images that show themselves -------------------------------------------------------------


TENSORS = tuple((f"drjit.{backend}{ad}", "TensorXf") for backend in ("llvm", "cuda") for ad in (".ad", ""))
"""The classes of images: their modules and names, so that none has to be imported."""

LEAST_SIZE = 8
"""Images have at least so many rows and columns; smaller tensors are shown as numbers."""


def show_images() -> None:
    """Let IPython, if it runs, show tensors of the shape of an image as a picture."""
    shell = running_shell()
    if shell is not None:
        formatter = shell.display_formatter.formatters["image/png"]
        for module, name in TENSORS:
            formatter.for_type_by_name(module, name, picture_of)


def picture_of(tensor: Any) -> bytes | None:
    """An image (H, W, C) as the bytes of a PNG, see `djpt.Image`; None for what isn't an image.

    Rendering is finished first; gradients stay as they are.
    """
    shape = tensor.shape
    if len(shape) != 3 or min(shape[:2]) < LEAST_SIZE or shape[2] < 1:
        return None
    import drjit as dr

    from djpt.errors import FileError
    from djpt.images.image import Image

    try:
        return Image(dr.detach(tensor))._repr_png_()
    except FileError:
        return None

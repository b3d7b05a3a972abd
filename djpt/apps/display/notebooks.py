"""Notebooks: images that show themselves, and a place for a bar.

IPython asks objects for pictures of themselves. Images of `djpt.render` can't answer, since their class is Dr.Jit's; so
a function is registered for it when djpt is imported in a notebook.
"""

from __future__ import annotations

from typing import Any

from djpt.rendering.progress import running_shell

__all__ = ["LEAST_SIZE", "picture_of", "show_images"]

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

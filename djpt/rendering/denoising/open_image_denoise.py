"""Intel's Open Image Denoise: a neural network, trained with path traced images.

The wheel is `mitsuba-oidn`, by the authors of Mitsuba and Dr.Jit: it shares Dr.Jit's threads.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.errors import BackendError

__all__ = ["filtered", "library"]

Pixels = npt.NDArray[np.float32]


def library() -> Any:
    """The module of the wheel; raises `BackendError` if it isn't installed."""
    import drjit  # noqa: F401 (first: the wheel links its threads)

    try:
        return importlib.import_module("mitsuba_oidn")
    except ImportError as error:
        raise BackendError(
            f"Open Image Denoise can't be loaded ({error}): pip install mitsuba-oidn, or choose the method 'nlm', "
            "which needs no package but denoises worse"
        ) from error


def filtered(noisy: Pixels, guides: Mapping[str, Pixels], clean: bool) -> Pixels:
    """The image (H, W, 3) of linear values without its noise. Guides, by name, that aren't `clean` are filtered first.

    A normal without an albedo is left out: the network has no such input.
    """
    oidn = library()
    albedo = guides.get("albedo")
    normal = None if albedo is None else guides.get("normal")
    try:
        if not clean:
            # Filters for one guide alone: its name is that of the input and of the network.
            albedo = None if albedo is None else alone(oidn, "albedo", albedo)
            normal = None if normal is None else alone(oidn, "normal", normal)
        return oidn.denoise(noisy, albedo, normal, hdr=True, clean_aux=albedo is not None)
    except oidn.Error as error:
        raise BackendError(f"Open Image Denoise failed: {error}") from error


def alone(oidn: Any, name: str, guide: Pixels) -> Pixels:
    """A guide without its noise."""
    result = np.empty_like(guide)
    network = oidn.Device().new_filter("RT")
    network.set_image(name, guide)
    network.set_image("output", result)
    network.execute()
    return result

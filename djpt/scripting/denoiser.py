"""The denoiser that djpt doesn't have."""

from __future__ import annotations

from typing import Any

from djpt.errors import BackendError

__all__ = ["OptixDenoiser"]


class OptixDenoiser:
    """Mitsuba's denoiser, which is a part of NVIDIA's OptiX; djpt needs no OptiX and has none.

    Raises:
        BackendError: always.
    """

    def __init__(self, *args: Any, **keywords: Any) -> None:
        raise BackendError(
            "'OptixDenoiser' needs OptiX, which djpt doesn't use. Render more samples, or write the image with its "
            "albedo and normals (the integrator 'aov') to an exr file for a denoiser such as Open Image Denoise"
        )

"""`denoise`: an image without its noise, by a method that is chosen by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from djpt.errors import ArgumentError, near_miss

if TYPE_CHECKING:
    from djpt.jit.types import TensorXf

__all__ = ["METHODS", "Guides", "check_method", "denoise", "denoise_pixels"]

Pixels = npt.NDArray[np.float32]

METHODS = ("oidn", "nlm")
"""The filters: Intel's Open Image Denoise, and non-local means."""


@dataclass
class Guides:
    """What surfaces look like without light: images (H, W, 3), either of which may be missing."""

    albedo: Pixels | None = None
    """The fraction of light that is reflected, 0 to 1."""
    normal: Pixels | None = None
    """Normals in any one frame, -1 to 1; 0 where there is no surface."""


def denoise(
    image: Any,
    albedo: Any = None,
    normal: Any = None,
    *,
    channels: Sequence[str] | None = None,
    method: str = "oidn",
    clean: bool = False,
) -> TensorXf:
    """Remove the noise of a rendered image: TensorXf of the shape of `image`.

    Colours are filtered; alpha and further channels stay as they are, to the bit. Values that aren't finite count as 0.
    The result has no derivatives.

    Args:
        image: (H, W, C) of linear values without an upper bound: `TensorXf`, NumPy array or `Image`.
        albedo: (H, W, 3), the fraction of light that surfaces reflect: keeps textures sharp. Default: none.
        normal: (H, W, 3), normals of surfaces, in the world's frame or the camera's: keeps edges sharp. Default: none.
        channels: The names of the image's channels, `djpt.channel_names(scene)`. Default: Y; Y A; R G B; R G B A; of
            more channels the first three are the colour.
        method: ``oidn`` is Intel's Open Image Denoise, ``nlm`` the joint non-local means of djpt, which is worse and
            needs nothing but NumPy.
        clean: Whether `albedo` and `normal` have no noise; otherwise they are filtered first.

    Raises:
        ArgumentError: Shapes that don't fit together, no colours, or an unknown method.
        BackendError: Open Image Denoise isn't installed.
    """
    from djpt.jit.types import TensorXf

    pixels = numbers("image", image)
    guides = Guides(
        None if albedo is None else numbers("albedo", albedo), None if normal is None else numbers("normal", normal)
    )
    return TensorXf(denoise_pixels(pixels, guides, colour_count(pixels, channels), method, clean))


def denoise_pixels(pixels: Pixels, guides: Guides, colours: int, method: str = "oidn", clean: bool = False) -> Pixels:
    """The NumPy form of `denoise`; the first channels of `pixels`, one or three of them, are the colour."""
    check_method(method)
    for name, guide in vars(guides).items():
        if guide is not None and guide.shape != (*pixels.shape[:2], 3):
            raise ArgumentError(f"'{name}' must have the shape {(*pixels.shape[:2], 3)}, found {guide.shape}")
    result = pixels.copy()
    noisy = finite(np.repeat(pixels[..., :1], 3, axis=2) if colours == 1 else pixels[..., :3])
    known = {name: finite(guide) for name, guide in vars(guides).items() if guide is not None}
    if method == "oidn":
        from djpt.rendering.denoising.open_image_denoise import filtered
    else:
        from djpt.rendering.denoising.nonlocal_means import filtered
    smooth = filtered(noisy, known, clean)
    result[..., :colours] = smooth.mean(axis=2, keepdims=True) if colours == 1 else smooth
    return result


def check_method(method: str) -> None:
    """Raise `ArgumentError` unless a method is known, and `BackendError` if it isn't installed."""
    if method not in METHODS:
        raise ArgumentError(f"unknown method '{method}' to denoise{near_miss(str(method), METHODS)}")
    if method == "oidn":
        from djpt.rendering.denoising.open_image_denoise import library

        library()


def colour_count(pixels: Pixels, names: Sequence[str] | None) -> int:
    """How many of an image's channels, the first ones, are its colour without alpha: 1 or 3."""
    count = pixels.shape[2]
    if names is None:
        return 3 if count >= 3 else 1
    if len(names) != count:
        raise ArgumentError(f"'channels' must name the {count} channels of the image, found {len(names)}")
    for colour in (("R", "G", "B"), ("X", "Y", "Z"), ("Y",)):
        if tuple(names[: len(colour)]) == colour:
            return len(colour)
    raise ArgumentError(f"the image has no colours to denoise: its channels are {', '.join(names)}")


def numbers(name: str, image: Any) -> Pixels:
    """An image as an array (H, W, C) of float32."""
    values = image.numpy() if hasattr(image, "numpy") else np.asarray(image)
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or 0 in values.shape or values.dtype.kind != "f":
        raise ArgumentError(
            f"'{name}' must be an image (height, width, channels) of linear floats, found {values.dtype} of shape "
            f"{values.shape}"
        )
    return np.asarray(values, np.float32)


def finite(pixels: Pixels) -> Pixels:
    """An array in one piece, with 0 in place of values that aren't finite."""
    return np.ascontiguousarray(np.where(np.isfinite(pixels), pixels, 0), np.float32)

"""The colour space, linear sRGB: its constants, and the luminance of images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["LUMINANCE", "RGB_TO_XYZ", "luminance"]

LUMINANCE = (0.212671, 0.715160, 0.072169)
"""Weights of red, green and blue in the luminance of linear sRGB (ITU-R BT.709)."""

RGB_TO_XYZ = ((0.412453, 0.357580, 0.180423), LUMINANCE, (0.019334, 0.119193, 0.950227))
"""CIE XYZ (1931) of the primaries of linear sRGB, row by row (ITU-R BT.709, white point D65)."""


def luminance(image: NDArray[np.floating], channels: Sequence[str]) -> NDArray[np.floating]:
    """The luminance of an image (channels, ..): of R, G, B, or Y; without those the mean of all."""
    places = {name: i for i, name in reversed(list(enumerate(channels[: len(image)])))}
    if all(name in places for name in "RGB"):
        r, g, b = (image[places[name]] * image.dtype.type(s) for name, s in zip("RGB", LUMINANCE, strict=True))
        return r + g + b
    if "Y" in places:
        return image[places["Y"]]
    return image.mean(0) if len(image) else np.zeros(image.shape[1:], image.dtype)

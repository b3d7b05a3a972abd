"""Images as parts of a page: PNG in `data:` addresses, and maps of errors."""

from __future__ import annotations

import base64
import io
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.images.formats import encode_png
from djpt.images.image import Image
from djpt.images.srgb import to_srgb8

__all__ = ["ERROR_COLORS", "address", "error_map", "error_range", "pixel_errors", "shown"]

Bytes = npt.NDArray[np.uint8]
Pixels = npt.NDArray[np.float64]

OKLAB_TO_LMS = np.array(
    [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.2914855480]]
)
LMS_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)
"""The two matrices from Oklab to linear sRGB, with a cube between them: B. Ottosson, "A perceptual color space for
image processing", 2020."""


def oklab_to_srgb(lightness: Pixels, chroma: Pixels, hue: Pixels) -> Bytes:
    """Convert Oklab in polar coordinates, hue in radians, to bytes of sRGB, (.., 3)."""
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)
    linear = (lab @ OKLAB_TO_LMS.T) ** 3 @ LMS_TO_RGB.T
    return to_srgb8(np.asarray(linear[None], np.float32))[0]


def error_colors(count: int = 256) -> Bytes:
    """A scale of black, violet, red, orange, pale yellow, (count, 3), with Oklab's lightness rising evenly."""
    t = np.linspace(0.0, 1.0, count)
    hue = np.radians(-75 + 180 * t)
    return oklab_to_srgb(0.1 + 0.87 * t, 0.02 + 0.15 * np.sin(np.pi * t), hue)


ERROR_COLORS = error_colors()
"""The colours of `error_map`, from small to large errors."""


def shown(image: Pixels) -> Bytes:
    """Convert linear light to bytes of sRGB, (H, W, 1 or 3)."""
    return Image(image.astype(np.float32)).srgb()


def address(pixels: Bytes) -> str:
    """Encode bytes of sRGB as a PNG in a `data:` address."""
    stream = io.BytesIO()
    encode_png(stream, pixels)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def pixel_errors(image: Any, reference: Any) -> Pixels:
    """The root mean square of image - reference over channels, (H, W)."""
    difference = np.asarray(image, np.float64) - np.asarray(reference, np.float64)
    return np.asarray(np.sqrt(np.mean(np.square(difference), axis=2)))


def error_range(errors: list[Pixels]) -> tuple[int, int]:
    """The powers of ten that enclose the errors of several images, but for a few pixels; four decades at most."""
    largest = max(float(np.quantile(error, 0.99)) for error in errors)
    smallest = min(float(np.quantile(error, 0.10)) for error in errors)
    high = math.ceil(math.log10(largest)) if largest > 0 else 0
    low = math.floor(math.log10(smallest)) if smallest > 0 else high - 4
    return max(min(low, high - 1), high - 4), high


def error_map(errors: Pixels, low: int, high: int) -> Bytes:
    """Draw errors in colours, (H, W, 3): black up to 10^low, pale yellow from 10^high, logarithmic in between."""
    t = (np.log10(np.maximum(errors, 10.0**low)) - low) / (high - low)
    return ERROR_COLORS[np.rint(np.clip(t, 0, 1) * (len(ERROR_COLORS) - 1)).astype(int)]

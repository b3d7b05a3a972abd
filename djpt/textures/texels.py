"""The pixels of a bitmap texture: their sources, and the checks that they pass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.limits import LARGEST
from djpt.core.numeric import describe
from djpt.description.files import confined, read_once, resolve
from djpt.description.properties import Properties
from djpt.errors import FileError, SceneError
from djpt.images.colorimetry import XYZ_TO_RGB
from djpt.images.formats import DISPLAY_FORMATS
from djpt.images.image import read_pixels, require_modest
from djpt.images.srgb import decoded, encoded, from_srgb, shares
from djpt.jit.kernels import maximum, minimum
from djpt.jit.types import Float, TensorXf, UInt32

__all__ = ["WRAP_MODES", "as_texels", "check_texels", "load_texels", "mean_texel", "numbers_of", "wrapped"]

Pixels = NDArray[np.float32]
SOURCES = ("filename", "bitmap", "data")


def load_texels(props: Properties, raw: bool, precision: str = "variant") -> TensorXf:
    """The texels that `filename`, `bitmap` or `data` give: (H, W, 1 or 3), linear unless `raw`.

    `precision`: 'float16' rounds them to half precision, 'uint8' to 8 bits, of sRGB if the image is that and not `raw`.
    """
    given = [key for key in SOURCES if key in props]
    if len(given) != 1:
        found = " and ".join(f"'{key}'" for key in given) or "none"
        raise SceneError(f"{props.node}: '{props.plugin_name()}' needs one of {', '.join(SOURCES)}; found {found}")
    key = given[0]
    value = props.raw(key)
    try:
        srgb = False
        if key == "data":
            texels = as_texels(value)
        else:
            if key == "filename":
                name = props.string(key)
                path = resolve(name)
                if confined():
                    require_modest(path)
                pixels = read_once(name, ("pixels", raw), lambda: read_pixels(path, raw))
                srgb = path.suffix.lower() in DISPLAY_FORMATS
            else:
                pixels, srgb = from_object(value, raw), is_encoded(value)
            own = np.ascontiguousarray(without_alpha(pixels))
            # Tensors share the memory of arrays, other textures that of what was read once.
            texels = TensorXf(own if pixels.flags.writeable else own.copy())
        if precision == "float16":
            texels = TensorXf(rounded(numbers_of(texels)))
        elif precision == "uint8":
            texels = TensorXf(in_bytes(numbers_of(texels), srgb and not raw))
        check_texels(numbers_of(texels))
    except FileError as error:
        raise SceneError(f"{props.node}: '{key}': {error}") from None
    except SceneError as error:
        raise props.error(key, str(error)) from None
    return texels


# ---- the three sources ---------------------------------------------------------------------


def as_texels(value: Any) -> TensorXf:
    """`data` as a tensor (H, W, C), attached to its gradients; (H, W) is one channel.

    Raises:
        SceneError: not an array of numbers, or of another shape.
    """
    if isinstance(value, TensorXf):
        texels = TensorXf(value)
    else:
        array = as_pixels(value)
        if array.dtype == np.uint8:
            raise SceneError("holds linear numbers, found bytes; pass 8-bit images as 'bitmap'")
        # A copy, so that the caller's memory isn't shared.
        with np.errstate(over="ignore"):
            texels = TensorXf(np.array(array, np.float32, order="C"))
    if len(texels.shape) == 2:
        texels = TensorXf(texels.array, (*texels.shape, 1))
    shape = tuple(texels.shape)
    if len(shape) != 3 or shape[2] not in (1, 3) or 0 in shape:
        raise SceneError(
            f"must have the shape (height, width), (height, width, 1) or (height, width, 3), found {shape}"
        )
    return texels


def from_object(value: Any, raw: bool) -> Pixels:
    """A copy of the pixels of a bitmap object: Mitsuba's, a djpt image, or anything that NumPy takes for an array.

    Whole numbers are shares of the type's largest; bytes are sRGB unless the object says otherwise.
    """
    if isinstance(value, str):
        raise SceneError(f"must be an image, found {describe(value)}; a file's name is given as 'filename'")
    pixels = as_pixels(value)
    curved = is_encoded(value)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or 0 in pixels.shape:
        raise SceneError(f"must have the shape (height, width, channels), found {pixels.shape}")
    if pixels.dtype in (np.uint8, np.uint16):
        pixels = from_srgb(pixels) if curved and not raw else shares(pixels)
    else:
        if pixels.dtype.kind in "iu":
            pixels = pixels / np.iinfo(pixels.dtype).max
        with np.errstate(over="ignore"):
            pixels = np.array(pixels, np.float32, order="C")
        if curved and not raw:
            colours = pixels.shape[2] - (pixels.shape[2] in (2, 4))
            pixels[..., :colours] = decoded(pixels[..., :colours])
    if str(getattr(value, "pixel_format", lambda: "")()).rpartition(".")[2].startswith("XYZ"):
        pixels[..., :3] = pixels[..., :3] @ XYZ_TO_RGB.T.astype(np.float32)
    return pixels


def is_encoded(value: Any) -> bool:
    """True if the colours of a bitmap object have sRGB's transfer curve: by its own flag, or else if they are bytes."""
    return bool(value.srgb_gamma()) if hasattr(value, "srgb_gamma") else as_pixels(value).dtype == np.uint8


def as_pixels(value: Any) -> NDArray[Any]:
    """An array of numbers on the host."""
    try:
        array = np.asarray(dr.detach(value) if dr.is_array_v(value) else value)
    except Exception:  # a foreign object may fail in any way
        array = np.asarray(None)
    if array.dtype.kind not in "fiu":
        raise SceneError(f"must be an array of numbers, found {describe(value)}")
    return array


# ---- steps -----------------------------------------------------------------------------------


def without_alpha(pixels: Pixels) -> Pixels:
    """The pixels without alpha, grey or RGB: alpha isn't applied, as in Mitsuba."""
    channels = pixels.shape[2]
    if channels > 4:
        raise SceneError(f"must have 1 to 4 channels (grey or RGB, with or without alpha), found {channels}")
    return pixels[..., : 1 if channels < 3 else 3]


def check_texels(pixels: Pixels) -> None:
    """Raise `SceneError` unless there are pixels, and all numbers are finite."""
    if not pixels.size:
        raise SceneError(f"must have at least one pixel, found the shape {pixels.shape}")
    # False for NaN, which is both the least and the greatest number wherever it occurs.
    if not (pixels.min() >= -LARGEST and pixels.max() <= LARGEST):
        y, x, channel = np.argwhere(~(np.abs(pixels) <= LARGEST))[0]
        raise SceneError(f"must be finite, found {pixels[y, x, channel]} in row {y}, column {x}")


def numbers_of(texels: TensorXf) -> Pixels:
    """The texels on the host, to be read: where the backend allows it they aren't copied."""
    numbers: Pixels = np.asarray(dr.detach(texels))
    numbers.flags.writeable = False
    return numbers


def mean_texel(pixels: Pixels) -> NDArray[np.float64]:
    """The mean of each channel, (C,)."""
    rows, columns, channels = pixels.shape
    # Whole rows are added up: much faster than sums over two axes.
    total = np.add.reduce(pixels.reshape(rows, -1), axis=0, dtype=np.float64)
    mean: NDArray[np.float64] = total.reshape(columns, channels).sum(axis=0) / (rows * columns)
    return mean


def rounded(pixels: Pixels) -> Pixels:
    """The pixels rounded to half precision, as float32."""
    with np.errstate(over="ignore"):
        return pixels.astype(np.float16).astype(np.float32)


def in_bytes(pixels: Pixels, srgb: bool) -> Pixels:
    """The pixels clipped to [0, 1] and rounded to 8 bits, as float32; `srgb`: to the bytes of sRGB."""
    shown = np.clip(np.nan_to_num(pixels), 0, 1)
    codes = np.rint((encoded(shown) if srgb else shown.astype(np.float64)) * 255) / 255
    return (decoded(codes) if srgb else codes).astype(np.float32)


# ---- grids beyond their borders --------------------------------------------------------------


WRAP_MODES = ("repeat", "mirror", "clamp")
"""Values beyond the border: the grid again, its mirror image, or the last point."""


def wrapped(i: Float, count: Float, mode: str) -> UInt32:
    """The number of a point along an axis that has `count` of them; `i` is whole, but may lie outside."""
    if mode == "repeat":
        i = remainder(i, count)
    elif mode == "mirror":
        i = remainder(i, 2 * count)
        i = minimum(i, 2 * count - 1 - i)
    # Also for safety: no coordinate whatsoever may lead out of memory.
    return UInt32(minimum(maximum(i, 0), count - 1))


def remainder(i: Float, n: Float) -> Float:
    """The remainder of `i` by `n`, whole numbers up to some millions: half a unit keeps off the steps of floor."""
    return dr.fma(-n, dr.floor((i + 0.5) * dr.rcp(n)), i)

"""Arrays inside a page: compressed, as text."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Packed", "bytes_of", "halves_of", "packed"]

Packed = dict[str, Any]

LARGEST_HALF = 65504.0


def packed(array: npt.NDArray[Any]) -> str:
    """The bytes of an array of bytes or of 16-bit numbers, deflated, in base64.

    Of 16-bit numbers all lower bytes come before all higher ones: the higher bytes of neighbours are alike, which
    makes the text a fifth shorter.
    """
    flat = np.ascontiguousarray(array).reshape(-1)
    planes = flat.view(np.uint8).reshape(flat.size, flat.itemsize).T
    compressor = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)  # without a header, as browsers inflate it
    data = compressor.compress(np.ascontiguousarray(planes).tobytes()) + compressor.flush()
    return base64.b64encode(data).decode("ascii")


def halves_of(values: npt.NDArray[Any]) -> Packed:
    """Numbers as float16, scaled by a power of two such that the largest of them fits and small ones keep digits."""
    wide = np.asarray(values, np.float64)
    largest = float(np.max(np.abs(wide), initial=0.0))
    scale = 2.0 ** np.floor(np.log2(LARGEST_HALF / largest)) if largest > 0 else 1.0
    return {"scale": float(1 / scale), "data": packed((wide * scale).astype("<f2"))}


def bytes_of(values: npt.NDArray[Any], low: float, high: float) -> Packed:
    """Numbers in 255 equal steps from `low` to `high`; those outside are clipped."""
    steps = np.rint((np.clip(values, low, high) - low) / (high - low) * 254)
    return {"low": low, "high": high, "data": packed(steps.astype(np.uint8))}

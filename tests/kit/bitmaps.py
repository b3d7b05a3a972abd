"""A bitmap with bright and dark texels, for lights."""

from __future__ import annotations

from typing import Any

import numpy as np

from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import TensorXf

__all__ = ["TEXELS", "TURNED", "bitmap"]

rng = np.random.default_rng(5)
TEXELS = (6 * rng.random((5, 7, 3)) ** 3).astype(np.float32)
TEXELS[2, 3] = 0

TURNED = T().translate([0.3, 1, 0]).rotate([0, 0, 1], 40).scale([1.5, -1, 1])


def bitmap(texels: np.ndarray = TEXELS, **keys: Any) -> dict[str, Any]:
    return {"type": "bitmap", "data": TensorXf(texels), "raw": True, **keys}

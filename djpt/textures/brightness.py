"""The weights by which cells of the unit square are sampled on textured lights."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.jit.types import Float, Point2f

if TYPE_CHECKING:
    from djpt.textures.uv import UVTexture

__all__ = ["cell_weights"]

MAX_CELLS = 2048
"""The largest number of cells along an axis."""
LOOKUPS = 4
"""The number of lookups per cell along an axis."""
LEAST = 0.01
"""The least weight of a cell, relative to the mean: lookups may miss its light."""


def cell_weights(texture: UVTexture, resolution: tuple[int, int]) -> NDArray[np.float64]:
    """The mean luminance in cells that are about as large as the texels that `to_uv` puts there.

    `resolution`: texels in a row and in a column. Every cell has some weight, since lookups may miss its light.
    """
    matrix = texture.to_uv.matrix[np.ix_([0, 1], [0, 1])]
    across = np.linalg.norm(matrix * np.array(resolution)[:, None], axis=0)
    columns, rows = (min(max(math.ceil(n - 1e-6), 1), MAX_CELLS) for n in across)
    y, x = np.indices((rows * LOOKUPS, columns * LOOKUPS)).reshape(2, -1) + 0.5
    at = SimpleNamespace(
        uv=Point2f(
            Float((x / (columns * LOOKUPS)).astype(np.float32)), Float((y / (rows * LOOKUPS)).astype(np.float32))
        )
    )
    found = np.array(dr.detach(texture.eval_1(at)), np.float64).reshape(rows, LOOKUPS, columns, LOOKUPS)
    weights: NDArray[np.float64] = np.maximum(found.mean(axis=(1, 3)), 0)
    return np.maximum(weights, LEAST * weights.mean())

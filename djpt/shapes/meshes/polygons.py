"""Polygons as fans of triangles around their first corner, as Mitsuba cuts them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["fans"]


def fans(counts: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut polygons whose corners lie one after the other in a list.

    Args:
        counts: corners of each polygon, (P,); those with less than three give nothing.

    Returns:
        The triangles as positions in the list, (F, 3), and the polygon of each, (F,).
    """
    starts = np.cumsum(counts) - counts
    triangles = np.maximum(counts.astype(np.int64) - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    first = starts[polygon]
    return np.stack([first, first + step + 1, first + step + 2], axis=1), polygon

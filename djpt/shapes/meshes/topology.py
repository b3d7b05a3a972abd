"""Which triangles share edges, and whether a mesh encloses a volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["is_closed", "opposite_edges"]


def is_closed(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> bool:
    """Whether every edge belongs to an even number of triangles.

    Then any ray from a point far away crosses the mesh an even number of times on its way out, and parity
    tells inside from outside. Vertices at the same place count as one: seams of texture coordinates
    double them.
    """
    # Adding zero turns -0 into 0, so that equal numbers have equal bits.
    bits = np.ascontiguousarray(positions + np.float32(0)).view(np.dtype((np.void, 12))).ravel()
    _, place = np.unique(bits, return_inverse=True)
    corners = place[indices].astype(np.uint64)
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    ends.sort(axis=1)
    _, uses = np.unique(ends[:, 0] << np.uint64(32) | ends[:, 1], return_counts=True)
    return bool((uses % 2 == 0).all())


def opposite_edges(indices: NDArray[np.uint32], vertex_count: int) -> NDArray[np.uint32]:
    """The directed edge that runs against each directed edge, (3 F,); 2^32 - 1 where it isn't exactly one.

    Edge k of triangle f, number 3 f + k, runs from its corner k to the next one.
    """
    start = indices.astype(np.int64).ravel()
    end = np.roll(indices, -1, axis=1).astype(np.int64).ravel()
    forward, backward = start * vertex_count + end, end * vertex_count + start
    order = np.argsort(forward, kind="stable")
    ranked = forward[order]
    first, past = np.searchsorted(ranked, backward, "left"), np.searchsorted(ranked, backward, "right")
    own_first, own_past = np.searchsorted(ranked, forward, "left"), np.searchsorted(ranked, forward, "right")
    single = (past - first == 1) & (own_past - own_first == 1)
    result = np.full(len(start), 0xFFFFFFFF, np.uint32)
    result[single] = order[first[single]]
    return result

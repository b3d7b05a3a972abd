"""Tests of every ray against every triangle: the reference for all other structures."""

from __future__ import annotations

import time

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.geometry.accelerators.base import Approach, Found, SearchedTable, Statistics, TriangleTable
from djpt.jit.types import UInt32

__all__ = ["BruteForce", "closest_in_double"]

CHUNK = 1 << 20
"""Ray-triangle pairs that `closest_in_double` handles at a time."""


class BruteForce(SearchedTable):
    """A plain list of triangles, without any structure."""

    def __init__(self, corners: NDArray[np.float32]) -> None:
        start = time.perf_counter()
        self.table = TriangleTable(corners)
        self.seconds = time.perf_counter() - start

    def search(self, ray: Approach, any_hit: bool) -> Found:
        count = dr.opaque(UInt32, self.table.count)
        first = dr.zeros(UInt32, ray.lanes)
        return self.table.visit_list(ray, None, first, count, ray.nothing_yet(), any_hit)[1]

    def statistics(self) -> Statistics:
        """Measure the list; the SAH cost is the number of triangles, all of which are tested."""
        count = self.table.count
        return Statistics(count, 0, count, 0, float(count), 64 * count, self.seconds)


def closest_in_double(
    corners: NDArray[np.float32], o: NDArray[np.float32], d: NDArray[np.float32], maxt: float = np.inf
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """The first hits of rays (R, 3) in double precision, by NumPy: distance, face, and distance to an edge.

    T. Moeller and B. Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997. The last result
    is the smallest distance, in barycentric units, from any triangle's edge to the ray, over all
    triangles that the ray comes near to: hits closer to an edge than the rounding of the numbers may
    go either way.
    """
    p0, p1, p2 = (corners[:, k].astype(np.float64) for k in range(3))
    e1, e2 = p1 - p0, p2 - p0
    t_all, face_all, margin_all = [], [], []
    step = max(1, CHUNK // len(corners))
    for begin in range(0, len(o), step):
        origin, direction = (x[begin : begin + step, None].astype(np.float64) for x in (o, d))
        with np.errstate(divide="ignore", invalid="ignore"):
            h = np.cross(direction, e2[None])
            inv = 1 / (e1 * h).sum(-1)
            s = origin - p0
            b1 = (s * h).sum(-1) * inv
            q = np.cross(s, np.broadcast_to(e1, s.shape))
            b2 = (direction * q).sum(-1) * inv
            t = (e2 * q).sum(-1) * inv
            inside = np.minimum(np.minimum(b1, b2), 1 - b1 - b2)
            hit = (inside >= 0) & (t > 0) & (t < maxt)
        t = np.where(hit, t, np.inf)
        face = t.argmin(axis=1)
        t_all.append(t[np.arange(len(t)), face])
        face_all.append(face)
        margin_all.append(np.nan_to_num(np.abs(inside), nan=0.0).min(axis=1))
    return np.concatenate(t_all), np.concatenate(face_all), np.concatenate(margin_all)

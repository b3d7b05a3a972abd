"""The interface of acceleration structures, which find the triangles that rays hit, and what they share.

Scenes are rendered with `djpt.geometry.bvh`; the others are there to teach and to test it. All of them
use the same centred triangles and origins from `TriangleTable`, so that they agree bit by bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.geometry.bvh.steps.traversal import reciprocal
from djpt.geometry.query import enter
from djpt.geometry.triangle import RayPlane, intersect_triangle
from djpt.jit.kernels import aligned, as_float, as_vector, maximum, minimum, while_loop, wide
from djpt.jit.types import ArrayXu, Bool, Float, Point3f, UInt32, Vector3f

__all__ = ["NO_FACE", "Accelerator", "Approach", "Found", "SearchedTable", "Statistics", "TriangleTable", "half_area"]

NO_FACE = 0xFFFFFFFF


@dataclass
class Statistics:
    """The size and quality of an acceleration structure."""

    primitives: int
    nodes: int
    """Nodes of a tree, cells of a grid."""
    references: int
    """The number of references to primitives in leaves or cells."""
    depth: int
    """Levels of nodes in the tree."""
    sah_cost: float
    """The mean number of nodes and primitives that a line through the structure's box meets; see `sah_cost`."""
    bytes: int
    """Memory that kernels read."""
    build_seconds: float

    def __str__(self) -> str:
        return (
            f"{self.primitives} primitives in {self.nodes} nodes ({self.references} references), depth {self.depth}, "
            f"SAH cost {self.sah_cost:.2f}, {self.bytes / 2**20:.1f} MiB, built in {self.build_seconds:.3f} s"
        )


class Accelerator(Protocol):
    """The contract of acceleration structures, which are built from corners (F, 3, 3) float32: face, corner, axis."""

    def closest(self, ray: Ray3f) -> tuple[Float, UInt32]:
        """Distance and face of the first hit with 0 < t < maxt; infinity and 0 on a miss."""

    def any_hit(self, ray: Ray3f) -> Bool:
        """Whether there is a hit with 0 < t < maxt."""

    def statistics(self) -> Statistics:
        """Measure the structure's size and quality."""


@dataclass
class Found:
    """The nearest hit so far: loop state."""

    t: Float
    face: UInt32
    """The face that was hit, or NO_FACE."""


class Approach:
    """A ray as accelerators use it: it starts near the triangles, in coordinates around their centre."""

    def __init__(self, table: TriangleTable, ray: Ray3f) -> None:
        anchor: Any = table
        self.o, self.entry = enter(anchor, ray)
        self.d, self.maxt = ray.d, ray.maxt - self.entry
        self.lanes = dr.width(ray, self.o)
        self.plane = RayPlane(self.o, self.d)
        self.inv = reciprocal(self.d)

    def nothing_yet(self) -> Found:
        """The state before the first triangle."""
        found: Found = wide(Found(self.maxt, UInt32(NO_FACE)), self.lanes)
        return found

    def through(self, low: Vector3f, high: Vector3f) -> tuple[Float, Float]:
        """The distances at which the ray enters and leaves a box."""
        a, b = (low - self.o) * self.inv, (high - self.o) * self.inv
        entry, leave = Float(0), self.maxt
        for axis in range(3):
            entry = maximum(entry, minimum(a[axis], b[axis]))
            leave = minimum(leave, maximum(a[axis], b[axis]))
        return wide(entry, self.lanes), wide(leave, self.lanes)

    def answer(self, found: Found) -> tuple[Float, UInt32]:
        """Turn the nearest hit into the result of `Accelerator.closest`."""
        hit = found.face != NO_FACE
        t: Float = dr.select(hit, found.t + self.entry, dr.inf)
        return t, dr.select(hit, found.face, 0)


class TriangleTable:
    """Triangles ready for kernels: 16 words each, corners relative to the middle of all."""

    def __init__(self, corners: NDArray[np.float32]) -> None:
        self.count = len(corners)
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        center = ((low.astype(np.float64) + high) / 2).astype(np.float32)
        extent = float(np.linalg.norm(high.astype(np.float64) - low))
        self.center = as_vector(center.astype(np.float64))
        self.radius = as_float(0.50001 * extent)
        centred = corners - center
        rows = aligned((self.count, 16))
        rows[:, :9] = centred.reshape(-1, 9).view(np.uint32)
        self.words = UInt32(rows.ravel())
        # Kernels round the distances to planes; slightly larger boxes lose no hits by that.
        self.slack = np.float32(max(2e-6 * extent, 1e-30))
        self.low: NDArray[np.float32] = centred.min(axis=1) - self.slack
        self.high: NDArray[np.float32] = centred.max(axis=1) + self.slack

    def visit(self, ray: Approach, face: UInt32, found: Found) -> Found:
        """Test one triangle per lane."""
        words: list[Any] = []
        for half in (2 * face, 2 * face + 1):
            loaded: Any = dr.gather(ArrayXu, self.words, half, shape=(8, 1))
            words += [dr.reinterpret_array(Float, word) for word in loaded]
        hit = intersect_triangle(ray.plane, Point3f(words[0:3]), Point3f(words[3:6]), Point3f(words[6:9]))
        closer = hit.hit & (hit.t > 0) & (hit.t < found.t)
        return Found(dr.select(closer, hit.t, found.t), dr.select(closer, face, found.face))

    def visit_list(
        self, ray: Approach, faces: UInt32 | None, item: UInt32, end: UInt32, found: Found, any_hit: bool
    ) -> tuple[UInt32, Found]:
        """Test a list of triangles from `item` to `end`, with `any_hit` up to the first hit: the place and the hit.

        `faces` is what the list is part of; None: all triangles, in order.
        """

        def face(item: UInt32) -> UInt32:
            return item if faces is None else dr.gather(UInt32, faces, item)

        item, found = while_loop(
            (item, found),
            lambda item, found: (item < end) & ((found.face == NO_FACE) if any_hit else Bool(True)),
            lambda item, found: (item + 1, self.visit(ray, face(item), found)),
            label="list of triangles",
        )
        return item, found


class SearchedTable:
    """The queries of structures that search a `TriangleTable`."""

    table: TriangleTable

    def search(self, ray: Approach, any_hit: bool) -> Found:
        """Look for the nearest hit of a ray, or for any."""
        raise NotImplementedError

    def closest(self, ray: Ray3f) -> tuple[Float, UInt32]:
        """Distance and face of the first hit with 0 < t < maxt; infinity and 0 on a miss."""
        approach = Approach(self.table, ray)
        return approach.answer(self.search(approach, False))

    def any_hit(self, ray: Ray3f) -> Bool:
        """Whether there is a hit with 0 < t < maxt."""
        return self.search(Approach(self.table, ray), True).face != NO_FACE


def half_area(low: NDArray[np.float32], high: NDArray[np.float32]) -> NDArray[np.float64]:
    """Half the surface area of boxes with the corners `low`, `high` (..., 3)."""
    e = high.astype(np.float64) - low
    area: NDArray[np.float64] = e[..., 0] * e[..., 1] + e[..., 1] * e[..., 2] + e[..., 2] * e[..., 0]
    return area

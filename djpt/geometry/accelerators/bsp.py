"""A BSP tree: space halved by arbitrary planes, among them those of the triangles.

H. Fuchs, Z. Kedem and B. Naylor, "On visible surface generation by a priori tree structures", 1980, split polygons
by the planes of others; T. Ize, I. Wald and S. Parker, "Ray tracing with the BSP tree", 2008, choose planes by their
cost. Here a node compares planes across the axes, those of a few of its triangles, and planes along their edges, by
the surface area heuristic. Its cell is a convex body whose faces are cut as well. Planes across the mean normal cut
empty space off.

Triangles are cut by the planes, so that both sides know which part of one they have. Rounding moves the point in which
a ray crosses a plane. No hits are lost by that: each side keeps a polygon up to `slack` beyond the plane. As long as
the rounding is less, every point of a triangle is in the leaf in which a ray looks for it.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.geometry.accelerators.base import (
    NO_FACE,
    Approach,
    Found,
    SearchedTable,
    Statistics,
    TriangleTable,
)
from djpt.jit.kernels import as_vector, shared, while_loop, wide
from djpt.jit.types import ArrayXu, Bool, Float, UInt32, Vector3f

__all__ = ["BspTree", "clip"]

ENOUGH = 4
"""Nodes with at most so many triangles are leaves."""

MAX_REFERENCES = 12
"""Most references per triangle, on average."""

CORNERS = 8
"""Most corners of a polygon; one that would get more isn't cut further, which is safe."""

TRIANGLES = 2
"""Triangles of a node whose planes, and planes along an edge, are compared."""


@dataclass
class Polygons:
    """Polygons in the nodes of one level: parts of triangles, or the faces of cells."""

    corners: NDArray[np.float64]
    """(polygons, CORNERS, 3); the last corner is repeated."""
    face: NDArray[np.int32]
    """The triangle that each is a part of."""
    node: NDArray[np.int32]
    """Sorted."""

    def some(self, which: NDArray[Any]) -> Polygons:
        """A part of the polygons."""
        return Polygons(self.corners[which], self.face[which], self.node[which])

    def distances(self, planes: NDArray[np.float64]) -> NDArray[np.float64]:
        """The signed distances (polygons, CORNERS) of the corners to their nodes' planes (nodes, 4)."""
        own = planes[self.node]
        along: NDArray[np.float64] = np.einsum("pca,pa->pc", self.corners, own[:, :3]) - own[:, 3:]
        return along


class BspTree(SearchedTable):
    """A BSP tree over triangles."""

    def __init__(self, corners: NDArray[np.float32]) -> None:
        start = time.perf_counter()
        self.table = TriangleTable(corners)
        self.slack = 2 * float(self.table.slack)
        self.low: NDArray[np.float32] = self.table.low.min(axis=0)
        self.high: NDArray[np.float32] = self.table.high.max(axis=0)
        self._low, self._high = as_vector(self.low), as_vector(self.high)
        words, faces = self._build((corners - self.table.center.numpy().ravel()).astype(np.float64))
        self.nodes, self.references = len(words), len(faces)
        self._words, self._faces = shared(words), shared(faces)
        self.seconds = time.perf_counter() - start

    # ---- building --------------------------------------------------------------------

    def _build(self, corners: NDArray[np.float64]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """Build the tree, level by level: its nodes (eight words each), and the leaves' triangles.

        An inner node is the number of the first of its two children and a plane, with its normal and distance from the
        centre; a leaf has zeros there, then the place of its first triangle and their number.
        """
        count = len(corners)
        everything = np.arange(count, dtype=np.int32)
        padded = np.concatenate([corners, np.repeat(corners[:, 2:], CORNERS - 3, axis=1)], axis=1)
        level, nodes = Polygons(padded, everything, np.zeros(count, np.int32)), 1
        cells = box_faces(self.low.astype(np.float64), self.high.astype(np.float64))
        whole = float(areas(cells, 1)[0])
        deepest = int(8 + 1.6 * math.log2(count))
        rng = np.random.default_rng(0)
        words, leaves, first_item, next_node = [], [], 0, 1
        self.depth, self.cost = 0, 0.0
        while nodes:
            size, area = np.bincount(level.node, minlength=nodes), areas(cells, nodes) / whole
            full = self.depth >= deepest or first_item + len(level.face) > MAX_REFERENCES * count
            planes = np.zeros((nodes, 4), np.float32)
            inner = np.zeros(nodes, np.bool_)
            large = (size > ENOUGH) & (not full)
            if large.any():
                planes[large], inner[large] = choose(among(level, large), among(cells, large), self.slack, rng)
            self.cost += float(area.sum() + (area * size)[~inner].sum())
            rows = np.zeros((nodes, 8), np.uint32)
            rows[inner, 0] = next_node + 2 * np.arange(inner.sum())
            rows[inner, 1:5] = planes[inner].view(np.uint32)
            rows[~inner, 5] = first_item + np.cumsum(size[~inner]) - size[~inner]
            rows[~inner, 6] = size[~inner]
            words.append(rows)
            leaves.append(level.face[~inner[level.node]])
            first_item += len(leaves[-1])
            next_node += 2 * int(inner.sum())
            self.depth += 1
            exact, nodes = planes[inner].astype(np.float64), 2 * int(inner.sum())
            level = divide(among(level, inner), exact, self.slack)
            cells = halves(among(cells, inner), exact)
        return np.concatenate(words), np.concatenate(leaves).astype(np.uint32)

    # ---- queries ---------------------------------------------------------------------

    def search(self, ray: Approach, any_hit: bool) -> Found:
        enter, leave = ray.through(self._low, self._high)

        def visit(begin: Float, found: Found, active: Bool) -> tuple[Float, Found, Bool]:
            item, end, until = self._leaf_at(ray, begin, leave)
            _, found = self.table.visit_list(ray, self._faces, item, end, found, any_hit)
            # A hit behind this leaf may lie behind one in the next.
            active = active & (found.t > until) & (until < leave)
            if any_hit:
                active &= found.face == NO_FACE
            return until, found, active

        _, found, _ = while_loop(
            (enter, ray.nothing_yet(), enter <= leave), lambda begin, found, active: active, visit, label="BSP tree"
        )
        result: Found = found
        return result

    def _leaf_at(self, ray: Approach, begin: Float, leave: Float) -> tuple[UInt32, UInt32, Float]:
        """Descend from the root to the leaf at the distance `begin`: its list (start, end), and its end."""

        def node(index: UInt32) -> list[UInt32]:
            words: Any = dr.gather(ArrayXu, self._words, index, shape=(8, 1))
            return list(words)[:7]

        def down(words: list[UInt32], until: Float) -> tuple[list[UInt32], Float]:
            x, y, z, at = (Float(dr.reinterpret_array(Float, word)) for word in words[1:5])
            normal = Vector3f(x, y, z)
            rate = dr.dot(normal, ray.d)
            # A ray along the plane stays on its side.
            rate = dr.select(dr.abs(rate) < 1e-18, Float(1e-18), rate)
            # Always rounded alike: the end of one leaf is exactly the start of the next.
            t = (at - dr.dot(normal, Vector3f(ray.o))) / rate
            beyond = t <= begin
            until = dr.select(beyond, until, dr.minimum(until, t))
            return node(words[0] + dr.select(beyond ^ (rate < 0), UInt32(1), UInt32(0))), until

        def inner(words: list[UInt32], until: Float) -> Bool:
            return words[0] != 0

        words, until = while_loop(wide((node(UInt32(0)), leave), ray.lanes), inner, down, label="leaf")
        return words[5], words[5] + words[6], until

    # ---- size ------------------------------------------------------------------------

    def statistics(self) -> Statistics:
        """Measure the tree's size and quality."""
        memory = 4 * (dr.width(self._words) + dr.width(self._faces) + dr.width(self.table.words))
        return Statistics(self.table.count, self.nodes, self.references, self.depth, self.cost, memory, self.seconds)

    def leaves(self) -> list[tuple[NDArray[np.float64], NDArray[np.uint32]]]:
        """The leaves: planes (n, 4) with the cell where n . p <= d, p relative to the middle; and the faces in it."""
        words, faces = self._words.numpy().reshape(-1, 8), self._faces.numpy()
        child, items = words[:, 0], words[:, 5:7]
        plane = words[:, 1:5].copy().view(np.float32).astype(np.float64)
        axes = np.eye(3)
        box = np.concatenate([np.c_[axes, self.high], np.c_[-axes, -self.low]])
        found, waiting = [], [(0, box)]
        while waiting:
            node, cell = waiting.pop()
            if child[node] == 0:
                first, count = (int(x) for x in items[node])
                found.append((cell, faces[first : first + count]))
                continue
            for side, sign in enumerate((1, -1)):
                waiting.append((int(child[node]) + side, np.concatenate([cell, sign * plane[node][None]])))
        return found


# ---- planes ----------------------------------------------------------------------------


def choose(
    level: Polygons, cells: Polygons, slack: float, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The best of some planes for each node (nodes, 4), and whether it pays to divide the node.

    The cost of a plane is 1 + (A(left) n(left) + A(right) n(right)) / A, that of a leaf n.
    """
    size = np.bincount(level.node)
    start = np.cumsum(size) - size
    whole = vector_areas(cells.corners)
    area = areas(cells, len(size))
    best, chosen = area * size, np.zeros((len(size), 4), np.float32)
    for plane in candidates(level, start, size, slack, rng):
        exact = plane.astype(np.float64)
        s, beyond = level.distances(exact), cells.distances(exact)
        left, right = (np.add.reduceat((x.min(axis=1) <= slack).astype(np.int64), start) for x in (s, -s))
        part = whole.copy()
        part[beyond.min(axis=1) >= 0] = 0
        cut = (beyond.min(axis=1) < 0) & (beyond.max(axis=1) > 0)
        part[cut] = vector_areas(clip(cells.corners[cut], beyond[cut]))
        cap = np.linalg.norm(summed(part, cells.node, len(size)), axis=1)
        sides = [cap + summed(np.linalg.norm(x, axis=1), cells.node, len(size)) for x in (part, whole - part)]
        cost = area + sides[0] * left + sides[1] * right
        # A plane that leaves the whole cell on one side cuts nothing off.
        better = (cost < best) & (np.minimum(*sides) > 1e-9 * area)
        best[better], chosen[better] = cost[better], plane[better]
    return chosen, np.abs(chosen).sum(axis=1) > 0


def candidates(
    level: Polygons, start: NDArray[np.int64], size: NDArray[np.int64], slack: float, rng: np.random.Generator
) -> list[NDArray[np.float32]]:
    """Planes to compare, (nodes, 4) each."""
    planes: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    mean = np.add.reduceat(level.corners.mean(axis=1), start) / size[:, None]
    normals = vector_areas(level.corners)
    across = np.add.reduceat(normals, start)
    for normal in (*np.eye(3), across):
        n = unit(np.broadcast_to(normal, mean.shape))
        s = level.distances(np.c_[n, np.zeros(len(n))])
        least, most = np.minimum.reduceat(s.min(axis=1), start), np.maximum.reduceat(s.max(axis=1), start)
        planes += [(n, (n * mean).sum(axis=1)), (n, least - 2 * slack), (n, most + 2 * slack)]
    for _ in range(TRIANGLES):
        some = start + rng.integers(size)
        p, normal = level.corners[some], normals[some]
        turned = rng.integers(3)
        for n in (unit(normal), unit(np.cross(normal, p[:, turned + 1] - p[:, turned]))):
            planes.append((n, (n * p[:, turned]).sum(axis=1)))
    return [np.c_[n, at].astype(np.float32) for n, at in planes]


def unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (N, 3) of length 1; an axis stands in for those without a length."""
    length = np.linalg.norm(v, axis=1, keepdims=True)
    result: NDArray[np.float64] = np.where(length > 0, v / np.where(length > 0, length, 1), np.array([1.0, 0.0, 0.0]))
    return result


# ---- polygons --------------------------------------------------------------------------


def box_faces(low: NDArray[np.float64], high: NDArray[np.float64]) -> Polygons:
    """The six faces of a box, which turn left as seen from outside."""
    faces = []
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        for end, turns in ((low, ((0, 0), (0, 1), (1, 1), (1, 0))), (high, ((0, 0), (1, 0), (1, 1), (0, 1)))):
            corners = np.empty((CORNERS, 3))
            for k in range(CORNERS):
                at_b, at_c = turns[min(k, 3)]
                corners[k, a], corners[k, b], corners[k, c] = end[a], (low, high)[at_b][b], (low, high)[at_c][c]
            faces.append(corners)
    return Polygons(np.array(faces), np.zeros(6, np.int32), np.zeros(6, np.int32))


def vector_areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normals of polygons (N, corners, 3) whose lengths are the areas."""
    edges = corners - corners[:, :1]
    return np.asarray(0.5 * np.cross(edges[:, 1:-1], edges[:, 2:]).sum(axis=1))


def summed(values: NDArray[np.float64], node: NDArray[np.int32], nodes: int) -> NDArray[np.float64]:
    """Sums of numbers or vectors by node."""
    if values.ndim == 1:
        return np.bincount(node, values, nodes).astype(np.float64)
    return np.stack([np.bincount(node, column, nodes) for column in values.T], axis=1)


def areas(cells: Polygons, nodes: int) -> NDArray[np.float64]:
    """The surface areas of cells, by node."""
    return summed(np.linalg.norm(vector_areas(cells.corners), axis=1), cells.node, nodes)


def among(polygons: Polygons, wanted: NDArray[np.bool_]) -> Polygons:
    """The polygons of some nodes, which are numbered anew."""
    number = (np.cumsum(wanted) - 1).astype(np.int32)
    part = polygons.some(wanted[polygons.node])
    part.node = number[part.node]
    return part


def halves(cells: Polygons, planes: NDArray[np.float64]) -> Polygons:
    """The faces of the two halves of cells; that in which a plane cuts a cell is new.

    A face that turns left leaves the near side at one point, which is a corner of the new one.
    """
    s = cells.distances(planes)
    onwards, following = np.roll(s, -1, axis=1), np.roll(cells.corners, -1, axis=1)
    face, corner = np.nonzero((s <= 0) & (onwards > 0))
    share = s[face, corner] / (s[face, corner] - onwards[face, corner])
    start, end = cells.corners[face, corner], following[face, corner]
    points, node = start + share[:, None] * (end - start), cells.node[face]
    count = np.bincount(node, minlength=len(planes))
    offset = points - (summed(points, node, len(planes)) / np.maximum(count, 1)[:, None])[node]
    n = planes[:, :3]
    u = unit(np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)]))
    v = np.cross(n, u)
    angle = np.arctan2((offset * v[node]).sum(axis=1), (offset * u[node]).sum(axis=1))
    points, first = points[np.lexsort((angle, node))], np.cumsum(count) - count
    able = np.flatnonzero(count >= 3)
    caps = points[first[able][:, None] + np.minimum(np.arange(CORNERS), np.minimum(count[able], CORNERS)[:, None] - 1)]
    # To the near side the plane's normal points outwards; the other sees the same polygon from behind.
    parts = divide(cells, planes, 0.0)
    area = np.linalg.norm(vector_areas(parts.corners), axis=1)
    parts = parts.some(area > 1e-12 * area.max(initial=0))
    corners = np.concatenate([parts.corners, caps, caps[:, ::-1]])
    nodes = np.concatenate([parts.node, 2 * able, 2 * able + 1]).astype(np.int32)
    both = Polygons(corners, np.zeros(len(corners), np.int32), nodes)
    return both.some(np.argsort(both.node, kind="stable"))


def divide(level: Polygons, planes: NDArray[np.float64], slack: float) -> Polygons:
    """The polygons on the two sides of each node's plane; those across it are cut."""
    s = level.distances(planes)
    sides = []
    for side, distances in enumerate((s, -s)):
        own = distances.min(axis=1) <= slack
        part, beyond = level.some(own), distances[own] - slack
        cut = beyond.max(axis=1) > 0
        part.corners[cut] = clip(part.corners[cut], beyond[cut])
        part.node = 2 * part.node + np.int32(side)
        sides.append(part)
    near, far = sides
    both = Polygons(
        np.concatenate([near.corners, far.corners]),
        np.concatenate([near.face, far.face]),
        np.concatenate([near.node, far.node]),
    )
    return both.some(np.argsort(both.node, kind="stable"))


def clip(polygons: NDArray[np.float64], distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cut convex polygons (N, corners, 3) off where the corners' distances (N, corners) are above 0.

    I. Sutherland and G. Hodgman, "Reentrant polygon clipping", 1974. The last corner is repeated in the result, too. A
    polygon that would have too many corners stays whole.
    """
    following, onwards = np.roll(polygons, -1, axis=1), np.roll(distances, -1, axis=1)
    inside = distances <= 0
    crosses = inside != (onwards <= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crosses, distances / (distances - onwards), 0)
    met = polygons + share[..., None] * (following - polygons)
    # Repeated corners aren't needed again.
    kept = inside & ((polygons != np.roll(polygons, 1, axis=1)).any(axis=2))
    count, corners = polygons.shape[:2]
    points = np.stack([polygons, met], axis=2).reshape(count, 2 * corners, 3)
    wanted = np.stack([kept, crosses], axis=2).reshape(count, 2 * corners)
    order = np.argsort(~wanted, axis=1, kind="stable")[:, :corners]
    number = wanted.sum(axis=1)
    last = np.clip(number - 1, 0, corners - 1)[:, None]
    slots = np.take_along_axis(order, np.minimum(np.arange(corners), last), axis=1)
    result = np.take_along_axis(points, slots[..., None], axis=1)
    whole = (number == 0) | (number > corners)
    result[whole] = polygons[whole]
    return result

"""The cells of acceleration structures that one ray visits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.accelerators.bsp import BspTree, clip
from djpt.geometry.accelerators.grid import UniformGrid
from djpt.geometry.accelerators.kdtree import LEAF, KdTree
from djpt.geometry.accelerators.octree import Octree
from djpt.geometry.accelerators.simple_bvh import SimpleBvh
from places import IMAGES
from svg import BLUE, GREY, RED, Drawing

__all__ = ["cells"]

Points = NDArray[np.float64]

SIDE, GAP, TOP = 250.0, 22.0, 34.0
"""Pixels: a panel, the space between two, the space for a heading."""

VISITED, WITH_TRIANGLES = "#fde3c8", "#f9b572"

ORIGIN, DIRECTION = np.array([-1.3, 0.62]), np.array([1.0, -0.29])


def outlines() -> Points:
    """Segments (n, 2, 2) between -1 and 1: a closed curve, two bows, a few splinters, the ground."""
    t = np.linspace(0, 2 * np.pi, 25)
    curve = np.stack([0.52 + 0.34 * np.cos(t), 0.1 + (0.34 + 0.07 * np.cos(4 * t)) * np.sin(t)], axis=1)
    bow = np.linspace(0.1, np.pi - 0.1, 8)
    leaf = np.stack([-0.5 + 0.22 * np.cos(bow), -0.3 + 0.42 * np.sin(bow)], axis=1)
    bowl = np.stack([-0.28 + 0.2 * np.cos(bow), 0.92 - 0.4 * np.sin(bow)], axis=1)
    rng = np.random.default_rng(5)
    start = np.stack([rng.uniform(-0.9, 0.9, 12), rng.uniform(-0.8, -0.45, 12)], axis=1)
    splinters = np.stack([start, start + rng.normal(0, 0.06, (12, 2))], axis=1)
    ground = np.array([[[-0.98, -0.97], [0.98, -0.86]]])
    chains = [np.stack([chain[:-1], chain[1:]], axis=1) for chain in (curve, leaf, bowl)]
    return np.concatenate([*chains, splinters, ground])


def triangles_of(segments: Points) -> NDArray[np.float32]:
    """Two triangles (F, 3, 3) across the plane of the drawing for each segment: one after the other."""
    (a, b), deep = (np.moveaxis(segments, 1, 0)), 0.4
    low, high = (np.c_[p, np.full(len(p), -deep)] for p in (a, b)), (np.c_[p, np.full(len(p), deep)] for p in (a, b))
    a0, b0 = low
    a1, b1 = high
    both = np.stack([np.stack([a0, b0, b1], axis=1), np.stack([a0, b1, a1], axis=1)], axis=1)
    return both.reshape(-1, 3, 3).astype(np.float32)


def polygon(planes: Points) -> Points:
    """The part of the plane z = 0 where n . p <= d for planes (n, 4), as a polygon (corners, 2)."""
    corners = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], np.float64)
    shape = np.concatenate([corners, np.repeat(corners[-1:], 20, axis=0)])
    for plane in planes:
        s = shape @ plane[:3] - plane[3]
        if s.min() > 0:
            return np.zeros((0, 2))
        if s.max() > 0:
            shape = clip(shape[None], s[None])[0]
    return shape[:, :2]


def box_planes(low: Any, high: Any) -> Points:
    """The six planes of a box."""
    return np.concatenate([np.c_[np.eye(3), high], np.c_[-np.eye(3), -np.asarray(low)]])


def grid_cells(grid: UniformGrid) -> list[tuple[Points, int]]:
    """Cells of a grid in the plane of the drawing, and the number of triangles in each."""
    low, size = (np.ravel(v.numpy()).astype(np.float64) for v in (grid._low, grid._size))
    counts = grid.counts.reshape(tuple(int(n) for n in grid.cells[::-1]))
    z = int((1e-3 - low[2]) / size[2])
    places = [(x, y) for x in range(grid.cells[0]) for y in range(grid.cells[1])]
    return [
        (polygon(box_planes(low + size * [x, y, z], low + size * [x + 1, y + 1, z + 1])), int(counts[z, y, x]))
        for x, y in places
    ]


def kd_cells(tree: KdTree) -> list[tuple[Points, int]]:
    """Leaves of a kd-tree in the plane of the drawing."""
    words = tree._words.numpy().reshape(-1, 2)
    found, waiting = [], [(0, *(np.ravel(v.numpy()).astype(np.float64) for v in (tree._low, tree._high)))]
    while waiting:
        node, low, high = waiting.pop()
        axis, rest = int(words[node, 0]) & 3, int(words[node, 0]) >> 2
        if axis == LEAF:
            found.append((polygon(box_planes(low, high)), rest))
            continue
        at = float(words[node, 1:].view(np.float32)[0])
        below, above = high.copy(), low.copy()
        below[axis] = above[axis] = at
        waiting += [(rest, low, below), (rest + 1, above, high)]
    return found


def met(shape: Points, origin: Points, end: float) -> bool:
    """Whether the ray, up to a distance, meets a convex polygon."""
    if len(shape) == 0:
        return False
    distances = (shape - origin) @ np.array([-DIRECTION[1], DIRECTION[0]])
    along = (shape - origin) @ DIRECTION / (DIRECTION @ DIRECTION)
    if not distances.min() < 0 < distances.max():
        return False
    following, onwards = np.roll(distances, -1), np.roll(along, -1)
    crosses = (distances < 0) != (following < 0)
    share = distances[crosses] / (distances[crosses] - following[crosses])
    entries = along[crosses] + share * (onwards[crosses] - along[crosses])
    return bool(entries.min() < end)


def first_hit(segments: Points) -> float:
    """The distance along the ray of the first segment that it meets."""
    a, edge = segments[:, 0] - ORIGIN, segments[:, 1] - segments[:, 0]
    turned = DIRECTION[0] * edge[:, 1] - DIRECTION[1] * edge[:, 0]
    t = (a[:, 0] * edge[:, 1] - a[:, 1] * edge[:, 0]) / turned
    u = (a[:, 0] * DIRECTION[1] - a[:, 1] * DIRECTION[0]) / turned
    return float(t[(t > 0) & (u >= 0) & (u <= 1)].min())


def cells() -> None:
    """Draw the cells of five structures over the same triangles, those that one ray visits in colour."""
    segments = outlines()
    corners = triangles_of(segments)
    simple, octree, bsp = SimpleBvh(corners), Octree(corners), BspTree(corners)
    middle = simple.table.center.numpy().ravel()[:2].astype(np.float64)
    structures: dict[str, list[tuple[Points, int]]] = {
        "uniform grid": grid_cells(UniformGrid(corners)),
        "octree": [(polygon(box_planes(low, high)), len(faces)) for low, high, faces in octree.leaves()],
        "kd-tree": kd_cells(KdTree(corners)),
        "BSP tree": [(polygon(cell), len(faces)) for cell, faces in bsp.leaves()],
        "BVH (longest axis, median, 5)": [
            (polygon(box_planes(low, high)), len(faces)) for low, high, faces in simple.leaves()
        ],
    }
    end = first_hit(segments)
    columns, rows = 3, 2
    title = "The cells that one ray visits in five acceleration structures over the same triangles"
    drawing = Drawing(columns * (SIDE + GAP) + GAP, rows * (SIDE + TOP + GAP), title)
    for panel, (name, shapes) in enumerate(structures.items()):
        left, top = GAP + panel % columns * (SIDE + GAP), TOP + panel // columns * (SIDE + TOP + GAP)

        def place(p: Points, left: float = left, top: float = top) -> Points:
            return np.stack([left + SIDE * (p[..., 0] + 1) / 2, top + SIDE * (1 - p[..., 1]) / 2], axis=-1)

        visited = [count for shape, count in shapes if met(shape, ORIGIN - middle, end)]
        drawing.text((left, top - 14), name, 13, bold=True)
        drawing.text((left, top + SIDE + 14), f"{len(visited)} visited, {sum(visited)} triangles listed there", 11)
        for shape, count in sorted(shapes, key=lambda entry: met(entry[0], ORIGIN - middle, end)):
            if len(shape) == 0:
                continue
            seen = met(shape, ORIGIN - middle, end)
            fill = "none" if not seen else WITH_TRIANGLES if count else VISITED
            drawing.polygon(place(shape + middle), fill, GREY, 0.6, 0.75 if seen else 1)
        for segment in segments:
            drawing.line(place(segment), BLUE, 2)
        drawing.arrow(*(tuple(place(ORIGIN + t * DIRECTION)) for t in (0.3, end)), color=RED)
    left, top = GAP + 2 * (SIDE + GAP), TOP + SIDE + TOP + GAP
    for row, (fill, words) in enumerate(
        ((WITH_TRIANGLES, "visited, with triangles to test"), (VISITED, "visited, empty"), ("none", "not visited"))
    ):
        y = top + 40 + 30 * row
        drawing.polygon(np.array([[left, y], [left + 26, y], [left + 26, y + 16], [left, y + 16]]), fill, GREY, 0.6)
        drawing.text((left + 36, y + 13), words, 12)
    drawing.line(np.array([[left, top + 138], [left + 26, top + 138]]), BLUE, 2)
    drawing.text((left + 36, top + 142), "triangles, seen from their edges", 12)
    drawing.arrow((left, top + 168), (left + 26, top + 168), RED)
    drawing.text((left + 36, top + 172), "the ray, to its first hit", 12)
    (IMAGES / "cells.svg").write_text(drawing.finished())

"""The trees of a scene: one over its triangles and instances, one over each group that is instanced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.build import build
from djpt.geometry.bvh.leaves import PlacedLeaves, TriangleLeaves
from djpt.geometry.bvh.records import EMITS, LEAF, PORTAL, SOLID, Extent, Leaves, Records, pack, roots
from djpt.geometry.bvh.refit import REBUILD, grown, refit
from djpt.geometry.bvh.statistics import sah_cost
from djpt.geometry.bvh.wide import WideTree, collapse
from djpt.geometry.canonical import KINDS
from djpt.geometry.face_frames import face_frames
from djpt.geometry.mesh_set import MeshSet
from djpt.shapes.base import Shape

__all__ = ["Forest", "Placement"]


@dataclass
class Placement:
    """An instance of a group."""

    group: int
    """The number of the group's tree; groups are counted from 1."""
    to_world: NDArray[np.float64]
    """The map from the group's space to world space, (4, 4)."""


@dataclass
class Tree:
    """A tree, and what it cost when it was built."""

    wide: WideTree
    cost: float


class Forest:
    """The trees of a scene, which build its records and renew them after an edit."""

    def __init__(
        self, meshes: MeshSet, parts: Sequence[int], solids: Sequence[Shape], placements: Sequence[Placement]
    ) -> None:
        """`parts` counts the meshes of the set that belong to the world, and then to each group, in this order.

        `solids` are analytic shapes of the world, numbered after the meshes.
        """
        self._meshes, self._solids, self._placements = meshes, list(solids), list(placements)
        self._parts = [int(n) for n in np.cumsum([0, *parts])]
        self._trees: list[Tree] = []
        self._depth = 0

    def records(self) -> Records:
        """The records of the current geometry. Trees that keep their quality are refitted, others are rebuilt."""
        corners = self._meshes.corners()
        normals, directions = face_frames(self._meshes, corners)
        mesh_of_face = self._meshes.mesh_of_face()
        emits = np.array([mesh.emitter is not None for mesh in self._meshes.meshes])
        if emits.any():
            mesh_of_face |= np.where(emits, EMITS, 0).astype(np.uint32)[mesh_of_face]
        bounds = [*self._meshes.first_face, self._meshes.face_count]
        triangles = []
        for first, last in zip(self._parts, self._parts[1:], strict=False):
            part = slice(bounds[first], bounds[last])
            triangles.append(
                TriangleLeaves(corners[part], mesh_of_face[part], normals[part], directions[part], bounds[first])
            )
        groups = [self._tree(i, *boxes(leaves)) for i, leaves in enumerate(triangles) if i > 0]
        low, high = boxes(triangles[0])
        placed = [solid_box(shape) for shape in self._solids]
        placed += [placed_box(groups[p.group - 1].wide, p.to_world) for p in self._placements]
        if placed:
            low = np.concatenate([low, [box[0] for box in placed]]).astype(np.float32)
            high = np.concatenate([high, [box[1] for box in placed]]).astype(np.float32)
        trees = [self._tree(0, low, high), *groups]
        self._trees = trees
        wide = [tree.wide for tree in trees]
        leaves: list[Leaves] = [*triangles]
        if placed:
            leaves[0] = self._placed_leaves(triangles[0], wide)
        kinds = tuple(sorted({kind_of(shape) for shape in self._solids}))
        records = pack(wide, leaves, self._depth, kinds)
        self._depth = records.depth
        return records

    def _tree(self, number: int, low: NDArray[np.float32], high: NDArray[np.float32]) -> Tree:
        """A tree over boxes: the old one refitted, or a new one if rays would take too many steps through the old."""
        if self._trees and (self._trees[number].wide.child <= -2).sum() == len(low):
            old = self._trees[number]
            fitted = refit(old.wide, low, high)
            if grown(fitted, old.cost) <= REBUILD:
                return Tree(fitted, old.cost)
        wide = collapse(build(low, high))
        return Tree(wide, sah_cost(wide))

    def _placed_leaves(self, triangles: TriangleLeaves, trees: Sequence[WideTree]) -> PlacedLeaves:
        """The leaves of the world's tree, with the maps into the spaces of its shapes and groups."""
        starts, first = roots(trees), len(self._meshes.meshes)
        inverse, label, detail, side = [], [], [], []
        for i, shape in enumerate(self._solids):
            inverse.append(np.linalg.inv(shape.to_world.matrix)[:3])
            label.append(LEAF | PORTAL | SOLID | (0 if shape.emitter is None else EMITS) | (first + i))
            detail.append(kind_of(shape))
            side.append(-1.0 if shape.flip_normals else 1.0)
        for i, placement in enumerate(self._placements):
            into = np.linalg.inv(placement.to_world)[:3]
            into[:, 3] -= Extent.of(trees[placement.group]).center
            inverse.append(into)
            label.append(LEAF | PORTAL | i)
            detail.append(starts[placement.group])
            side.append(1.0)
        return PlacedLeaves(
            triangles,
            np.array(inverse),
            np.array(label, np.uint32),
            np.array(detail, np.uint32),
            np.array(side, np.float32),
        )

    @property
    def emits(self) -> bool:
        """Whether any of the shapes is a light."""
        return any(shape.emitter is not None for shape in (*self._meshes.meshes, *self._solids))

    def place(self, number: int, to_world: NDArray[np.float64]) -> None:
        """Move an instance; takes effect with the next `records`."""
        self._placements[number].to_world = to_world

    def statistics(self) -> tuple[int, int, float]:
        """Nodes and levels of all trees, and the SAH cost of the world's."""
        nodes = sum(len(tree.wide.child) for tree in self._trees)
        return nodes, self._depth, sah_cost(self._trees[0].wide)


def boxes(leaves: TriangleLeaves) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The bounding boxes of triangles."""
    return leaves.corners.min(axis=1), leaves.corners.max(axis=1)


def kind_of(shape: Shape) -> int:
    """The number of a shape's kind."""
    assert shape.canonical is not None
    return KINDS.index(shape.canonical)


def solid_box(shape: Shape) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The box about an analytic shape."""
    intervals = np.array([shape.interval(unit) for unit in np.eye(3)])
    margin = 1e-6 * (np.abs(intervals).max() + 1e-30)
    return intervals[:, 0] - margin, intervals[:, 1] + margin


def placed_box(tree: WideTree, to_world: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A box in world space about a group's box, which `to_world` has placed."""
    filled = tree.child[0] != -1
    low, high = tree.box[0, filled, :3].min(axis=0), tree.box[0, filled, 3:].max(axis=0)
    corners = np.array([[(low, high)[(i >> axis) & 1][axis] for axis in range(3)] for i in range(8)], np.float64)
    placed = corners @ to_world[:3, :3].T + to_world[:3, 3]
    # Rounding to 32 bits must not make the box smaller.
    margin = 1e-6 * (np.abs(placed).max() + 1e-30)
    return placed.min(axis=0) - margin, placed.max(axis=0) + margin

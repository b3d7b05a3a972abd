"""The trees of a scene for compiled searches: built, kept, and put into one block of memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.core.process.memory import shortage
from djpt.errors import SceneError
from djpt.geometry.bvh.build.builder import Built, build, refit, workers
from djpt.geometry.bvh.build.rows import corners_of, write_rows
from djpt.geometry.bvh.build.wide import REBUILD
from djpt.geometry.bvh.calls.engine import functions
from djpt.geometry.bvh.calls.layout import REFERENCE, ROW_WORDS
from djpt.geometry.bvh.calls.placed import Features
from djpt.geometry.bvh.calls.tree import CompiledTree
from djpt.geometry.bvh.extent import Extent
from djpt.geometry.bvh.leaves import PlacedLeaves
from djpt.geometry.mesh_part import MeshPart
from djpt.jit.kernels import aligned, as_float, as_vector
from djpt.jit.types import UInt32

__all__ = ["CompiledTrees"]

PLACED_ROWS = 2

PRIMITIVE = 200
"""Bytes that building a tree takes for each primitive: its corners, two records, two nodes, and its share of the tree.
"""


@dataclass
class Tree:
    """A tree, what it cost when it was built, and what it is over."""

    built: Built
    cost: float
    part: MeshPart
    corners: NDArray[np.float32]


class CompiledTrees:
    """The trees of a scene: number 0 over the world, the others over its groups."""

    def __init__(self) -> None:
        self._trees: dict[int, Tree] = {}

    def fit(self, number: int, part: MeshPart, boxes: NDArray[np.float32]) -> Extent:
        """Build a tree over meshes and placed boxes (P, 6), or fit it to where they are now."""
        missing = shortage(PRIMITIVE * (part.face_count + len(boxes)))
        if missing is not None:
            raise SceneError(f"a tree over {part.face_count} triangles {missing}; use instances, or coarser meshes")
        with workers(part.face_count, None) as team:
            corners = corners_of(part.meshes, team)
        built, cost = self._fitted(number, corners, boxes)
        self._trees[number] = Tree(built, cost, part, corners)
        return built.extent

    def _fitted(self, number: int, corners: NDArray[np.float32], boxes: NDArray[np.float32]) -> tuple[Built, float]:
        """The old tree refitted, or a new one if rays would take too many steps through the old."""
        old = self._trees.get(number)
        if old is not None and len(old.built.order) == len(corners):
            cost = refit(old.built, corners, boxes)
            if cost <= REBUILD * old.cost:
                return old.built, old.cost
        built = build(corners, boxes)
        return built, built.sah_cost

    def starts(self) -> list[int]:
        """Where each tree begins, as instances name it: the row of its header."""
        sizes = [len(tree.built.memory) // ROW_WORDS for tree in self._ordered()]
        return [int(n) for n in np.cumsum([0, *sizes])]

    def packed(
        self, placed: PlacedLeaves | None, kinds: tuple[int, ...], lights: bool, one_sided: bool
    ) -> CompiledTree:
        """The trees in memory."""
        trees, starts = self._ordered(), self.starts()
        count = 0 if placed is None else len(placed.label)
        first_triangle = np.cumsum([starts[-1] + PLACED_ROWS * count, *(len(tree.corners) for tree in trees)])
        if first_triangle[-1] > REFERENCE:
            raise SceneError(f"the scene has too many triangles: {first_triangle[-1]} rows of 32 bytes for its trees")
        rows = aligned((int(first_triangle[-1]), ROW_WORDS))
        for k, tree in enumerate(trees):
            own = rows[starts[k] : starts[k + 1]]
            own.ravel()[:] = tree.built.memory
            # The record of a placed primitive is its second row.
            own[0, :2] = first_triangle[k], starts[-1] + 1
            records = rows[first_triangle[k] : first_triangle[k + 1]]
            part = tree.part
            with workers(len(records), None) as team:
                write_rows(records, tree.built.order, part.meshes, part.labels, tree.corners, part.first_face, team)
            tree.corners = tree.corners[:0]
        extent = trees[0].built.extent
        if placed is not None:
            table = rows[starts[-1] : first_triangle[0]].reshape(count, PLACED_ROWS * ROW_WORDS)
            every = np.arange(count, dtype=np.int32)
            placed.write(table, every.view(np.uint32), every, extent.center)
        return CompiledTree(
            UInt32(rows.ravel()),
            functions(Features(len(trees) > 1, kinds, lights, one_sided)),
            as_vector(extent.center.astype(np.float64)),
            as_float(0.50001 * extent.diagonal),
            extent.diagonal,
            len(trees) > 1,
            kinds,
        )

    def statistics(self) -> tuple[int, int, float]:
        """Nodes and levels of all trees, and the SAH cost of the world's."""
        trees = [tree.built for tree in self._ordered()]
        depth = trees[0].depth + max((tree.depth for tree in trees[1:]), default=0)
        return sum(tree.nodes for tree in trees), depth, trees[0].sah_cost

    def _ordered(self) -> list[Tree]:
        return [self._trees[number] for number in sorted(self._trees)]

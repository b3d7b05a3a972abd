"""The trees of a scene for searches by steps: built, kept, and packed into records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.build.binary import build
from djpt.geometry.bvh.build.wide import REBUILD, WideTree, collapse, grown, refit, sah_cost
from djpt.geometry.bvh.extent import Extent
from djpt.geometry.bvh.leaves import MixedLeaves, PlacedLeaves, TriangleLeaves
from djpt.geometry.bvh.steps.records import Leaves, extent_of, pack, roots
from djpt.geometry.bvh.steps.tree import StepTree
from djpt.geometry.mesh_part import MeshPart

__all__ = ["StepTrees"]


@dataclass
class Tree:
    """A tree, and what it cost when it was built."""

    wide: WideTree
    cost: float


class StepTrees:
    """The trees of a scene: number 0 over the world, the others over its groups."""

    def __init__(self) -> None:
        self._trees: dict[int, Tree] = {}
        self._leaves: dict[int, TriangleLeaves] = {}
        self._depth = 0

    def fit(self, number: int, part: MeshPart, boxes: NDArray[np.float32]) -> Extent:
        """Build a tree over meshes and placed boxes (P, 6), or fit it to where they are now."""
        leaves = self._leaves[number] = TriangleLeaves.of(part)
        low = np.concatenate([leaves.corners.min(axis=1), boxes[:, :3]])
        high = np.concatenate([leaves.corners.max(axis=1), boxes[:, 3:]])
        self._trees[number] = self._fitted(number, low, high)
        return extent_of(self._trees[number].wide)

    def _fitted(self, number: int, low: NDArray[np.float32], high: NDArray[np.float32]) -> Tree:
        """The old tree refitted, or a new one if rays would take too many steps through the old."""
        old = self._trees.get(number)
        if old is not None and (old.wide.child <= -2).sum() == len(low):
            fitted = refit(old.wide, low, high)
            if grown(fitted, old.cost) <= REBUILD:
                return Tree(fitted, old.cost)
        wide = collapse(build(low, high))
        return Tree(wide, sah_cost(wide))

    def starts(self) -> list[int]:
        """Where each tree begins, as instances name it: the record of its root."""
        return roots(self._wide())

    def packed(self, placed: PlacedLeaves | None, kinds: tuple[int, ...], lights: bool, one_sided: bool) -> StepTree:
        """The trees in memory."""
        leaves: list[Leaves] = [self._leaves[number] for number in sorted(self._trees)]
        if placed is not None:
            leaves[0] = MixedLeaves(self._leaves[0], placed)
        self._leaves.clear()
        # The depth before an edit keeps compiled kernels usable.
        records = pack(self._wide(), leaves, self._depth, kinds, one_sided)
        self._depth = records.depth
        return StepTree.of(records)

    def statistics(self) -> tuple[int, int, float]:
        """Nodes and levels of all trees, and the SAH cost of the world's."""
        return sum(len(wide.child) for wide in self._wide()), self._depth, sah_cost(self._trees[0].wide)

    def _wide(self) -> list[WideTree]:
        return [self._trees[number].wide for number in sorted(self._trees)]

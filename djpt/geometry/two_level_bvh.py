"""The trees of a scene: one over its triangles and instances, one over each group that is instanced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.leaves import Extent, MeshPart, PlacedLeaves
from djpt.geometry.bvh.steps.records import EMITS, LEAF, ONE_SIDED, PORTAL, SOLID
from djpt.geometry.canonical import KINDS, PIECE
from djpt.geometry.curve_segments import CurveSegmentSet
from djpt.geometry.engines import new_trees
from djpt.geometry.null_meshes import NullMeshes
from djpt.geometry.query import RayTree
from djpt.shapes.base import Shape
from djpt.shapes.curve_segments import CurveSegments
from djpt.shapes.meshes.mesh_set import MeshSet

__all__ = ["Placement", "TwoLevelBVH"]


@dataclass
class Placement:
    """An instance of a group."""

    group: int
    """The number of the group's tree; groups are counted from 1."""
    to_world: NDArray[np.float64]
    """The map from the group's space to world space, (4, 4)."""


class TwoLevelBVH:
    """A BVH over the world, and one over each instanced group: builds their records, and renews them after edits."""

    pieces: CurveSegmentSet | None = None
    """The pieces of the world's shapes that consist of some; None if there are none."""
    null_meshes: NullMeshes
    """The invisible meshes of the world, as the tree knows them."""

    def __init__(
        self, meshes: MeshSet, parts: Sequence[int], solids: Sequence[Shape], placements: Sequence[Placement]
    ) -> None:
        """`parts` counts the meshes of the set that belong to the world, and then to each group, in this order.

        `solids` are analytic shapes of the world, numbered after the meshes.
        """
        self._meshes, self._solids, self._placements = meshes, list[Any](solids), list(placements)
        self._parts = [int(n) for n in np.cumsum([0, *parts])]
        self._trees = new_trees()

    def tree(self) -> RayTree:
        """The trees of the current geometry. Those that keep their quality are refitted, others are rebuilt."""
        self.null_meshes = self._find_null_meshes()
        parts = self._mesh_parts()
        parts[0].ways = self.null_meshes.ways()
        nothing = np.zeros((0, 6), np.float32)
        groups = [self._trees.fit(i, part, nothing) for i, part in enumerate(parts) if i > 0]
        in_pieces = [shape for shape in self._solids if shape.in_pieces]
        pieces = [shape.pieces() for shape in in_pieces]
        self.pieces = CurveSegmentSet(pieces) if pieces else None
        boxes = [self._solid_boxes(), *(part.boxes for part in pieces)]
        contents = [Contents.of(part, extent) for part, extent in zip(parts[1:], groups, strict=True)]
        boxes.append(box_rows([contents[p.group - 1].placed_box(p.to_world) for p in self._placements]))
        placed = np.concatenate(boxes).astype(np.float32)
        self._trees.fit(0, parts[0], placed)
        kinds = tuple(sorted({kind_of(shape) for shape in self._solids}))
        leaves = self._placed_leaves(groups, in_pieces, pieces) if len(placed) else None
        return self._trees.packed(leaves, kinds, self.emits, self._one_sided)

    def _find_null_meshes(self) -> NullMeshes:
        """The invisible meshes of the world; those of groups aren't among them."""
        return NullMeshes(self._meshes.meshes[: self._parts[1]])

    @property
    def is_current(self) -> bool:
        """Whether the tree knows which meshes of the world are invisible now, and the media on their sides."""
        return self.null_meshes.key == self._find_null_meshes().key

    def _solid_boxes(self) -> NDArray[np.float64]:
        """The boxes of the solids that aren't in pieces."""
        return box_rows([solid_box(shape) for shape in self._solids if not shape.in_pieces])

    def _mesh_parts(self) -> list[MeshPart]:
        """The meshes of the world, and of each group."""
        meshes, bounds = self._meshes.meshes, [*self._meshes.first_face, self._meshes.face_count]
        labels = np.array(
            [
                LEAF | i | (0 if m.emitter() is None else EMITS) | (ONE_SIDED if m.one_sided else 0)
                for i, m in enumerate(meshes)
            ],
            np.uint32,
        )
        return [
            MeshPart(meshes[first:last], labels[first:last], bounds[first])
            for first, last in zip(self._parts, self._parts[1:], strict=False)
        ]

    def _placed_leaves(
        self, groups: Sequence[Extent], in_pieces: Sequence[Any], pieces: Sequence[CurveSegments]
    ) -> PlacedLeaves:
        """The leaves of the world's tree, with the maps into the spaces of its shapes and groups."""
        starts, first = self._trees.starts(), len(self._meshes.meshes)
        solids = []
        for i, shape in enumerate(self._solids):
            if not shape.in_pieces:
                label = LEAF | PORTAL | SOLID | (0 if shape.emitter() is None else EMITS) | (first + i)
                side = -1.0 if shape.flip_normals else 1.0
                solids.append((np.linalg.inv(shape.to_world.matrix)[:3], label, kind_of(shape), side))
        instances = []
        for i, placement in enumerate(self._placements):
            into = np.linalg.inv(placement.to_world)[:3]
            into[:, 3] -= groups[placement.group - 1].center
            instances.append((into, LEAF | PORTAL | i, starts[placement.group], 1.0))
        parts, number = [], PIECE
        for shape, part in zip(in_pieces, pieces, strict=True):
            maps, radii = part.maps, part.radii
            own = np.full(len(maps), LEAF | PORTAL | SOLID | (first + self._solids.index(shape)), np.uint32)
            numbers = np.arange(number, number + len(maps), dtype=np.uint32)
            parts.append(PlacedLeaves(maps, own, numbers, radii[:, 0].copy(), radii[:, 1].copy()))
            number += len(maps)
        return PlacedLeaves.joined([leaves_of(solids), *parts, leaves_of(instances)])

    @property
    def _one_sided(self) -> bool:
        """Whether rays pass through the backs of some meshes."""
        return any(mesh.one_sided for mesh in self._meshes.meshes)

    @property
    def emits(self) -> bool:
        """Whether any of the shapes is a light."""
        return any(shape.emitter() is not None for shape in (*self._meshes.meshes, *self._solids))

    def place(self, number: int, to_world: NDArray[np.float64]) -> None:
        """Move an instance; takes effect with the next `records`."""
        self._placements[number].to_world = to_world

    def statistics(self) -> tuple[int, int, float]:
        """Nodes and levels of all trees, and the SAH cost of the world's."""
        return self._trees.statistics()


def leaves_of(rows: Sequence[tuple[Any, int, int, float]]) -> PlacedLeaves:
    """Leaves from rows: the inverse map, the label, the detail and the side."""
    inverse, label, detail, side = zip(*rows, strict=True) if rows else ((), (), (), ())
    return PlacedLeaves(
        np.array(inverse, np.float64).reshape(-1, 3, 4),
        np.array(label, np.uint32),
        np.array(detail, np.uint32),
        np.array(side, np.float32),
        np.zeros(len(rows), np.float32),
    )


def box_rows(boxes: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> NDArray[np.float64]:
    """Boxes, given by their corners, as rows (P, 6)."""
    return np.array([np.concatenate(box) for box in boxes], np.float64).reshape(-1, 6)


def kind_of(shape: Shape) -> int:
    """The number of a shape's kind."""
    assert shape.canonical is not None
    return KINDS.index(shape.canonical)


def solid_box(shape: Shape) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The box about an analytic shape."""
    low, high = shape.world_box()
    margin = 1e-6 * (np.abs([low, high]).max() + 1e-30)
    return low - margin, high + margin


CELLS = 8
"""The cells of a grid in a group, along each axis."""


@dataclass
class Contents:
    """Where the vertices of a group are: in small boxes, which stay small when the group is turned.

    The box about a turned ball is up to 1.7 times as wide as the ball if it is made from the box about the ball; rays
    would enter instances for nothing.
    """

    middles: NDArray[np.float64]
    """The middles of the boxes, (N, 3)."""
    halves: NDArray[np.float64]
    """Half their sides."""

    @staticmethod
    def of(part: MeshPart, extent: Extent) -> Contents:
        """The vertices of meshes, by the cells of a grid in the box about them."""
        low, high = extent.low.astype(np.float64), extent.high.astype(np.float64)
        points = np.concatenate([mesh.positions for mesh in part.meshes]).astype(np.float64)
        # A mesh may have vertices without a face.
        points = points[((points >= low) & (points <= high)).all(axis=1)]
        if not len(points):
            return Contents((low + high)[None] / 2, (high - low)[None] / 2)
        cells = ((points - low) * (CELLS / np.maximum(high - low, 1e-30))).astype(np.int16)
        cells = np.minimum(cells, CELLS - 1)
        number = (cells[:, 0] * CELLS + cells[:, 1]) * CELLS + cells[:, 2]
        order = np.argsort(number, kind="stable")
        points, number = points[order], number[order]
        first = np.flatnonzero(np.diff(number, prepend=-1))
        lows, highs = np.minimum.reduceat(points, first), np.maximum.reduceat(points, first)
        return Contents((lows + highs) / 2, (highs - lows) / 2)

    def placed_box(self, to_world: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The box in world space about everything, which `to_world` has placed."""
        linear, shift = to_world[:3, :3].T, to_world[:3, 3]
        middles, halves = self.middles @ linear, self.halves @ np.abs(linear)
        low, high = (middles - halves).min(axis=0) + shift, (middles + halves).max(axis=0) + shift
        # Rounding to 32 bits must not make the box smaller.
        margin = 1e-6 * (np.abs([low, high]).max() + 1e-30)
        return low - margin, high + margin

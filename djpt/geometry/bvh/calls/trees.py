"""Trees in memory that kernels search by calls of compiled functions, and those of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.memory import shortage
from djpt.core.records import Ray3f
from djpt.errors import SceneError
from djpt.geometry.bvh.build.builder import Built, build, refit, workers
from djpt.geometry.bvh.build.rows import corners_of, write_rows
from djpt.geometry.bvh.build.wide import REBUILD
from djpt.geometry.bvh.calls.faces import FEW, Faces
from djpt.geometry.bvh.calls.layout import (
    ANY_HIT,
    EXTENT_WORD,
    FACES_WORD,
    PASSES_LIGHTS,
    REFERENCE,
    ROW_WORDS,
)
from djpt.geometry.bvh.calls.ray import Features
from djpt.geometry.bvh.calls.searches import (
    RINGS,
    SWEEP,
    Functions,
    Met,
    call_any,
    call_closest,
    call_lengths,
    call_pairs,
    functions,
)
from djpt.geometry.bvh.leaves import Extent, MeshPart, PlacedLeaves
from djpt.geometry.query import NONE, Found, enter
from djpt.jit.kernels import aligned, as_float, as_vector
from djpt.jit.types import ArrayXu, Bool, Float, Point2f, Point3f, UInt32, Vector3f

__all__ = ["CompiledTree", "CompiledTrees"]

# ---- a tree ------------------------------------------------------------------------------------------------------


@dataclass
class Progress:
    """How far a search has come: it begins and ends with one call. Loop state."""

    t: Float
    hit: UInt32
    waits: Bool
    """True where the call is still to come."""
    b: Point2f | None
    inside: UInt32 | None

    @property
    def ended(self) -> Bool:
        """True where the search has come to its end."""
        return ~self.waits


@dataclass
class CompiledTree:
    """A tree in one block of memory: see `djpt.geometry.bvh.calls.layout`. The contract is `RayTree`."""

    memory: UInt32
    functions: Functions
    center: Point3f
    radius: Float
    extent: float
    instanced: bool
    kinds: tuple[int, ...]
    stepwise: bool = False

    @property
    def bytes(self) -> int:
        return 4 * dr.width(self.memory)

    def search(
        self, ray: Ray3f, any_hit: bool, active: Bool | bool = True, through_lights: Bool | None = None
    ) -> Found:
        origin, entry = enter(self, ray)
        maxt, flags = ray.maxt - entry, flags_of(None, through_lights)
        if any_hit:
            hit = call_any(self.functions.any, self.memory, origin, ray.d, maxt, Bool(active), flags)
            return Found(origin, entry, maxt, dr.select(hit, UInt32(1), NONE), None)
        met = call_closest(self.functions.closest, self.memory, origin, ray.d, maxt, Bool(active), flags)
        return self._found(met, origin, entry, maxt)

    def search_pairs(
        self, ray: Ray3f, to_light: Ray3f, followed: Bool, through_lights: Bool | None
    ) -> tuple[Found, Bool]:
        """Find the first hit of `ray` and, where `followed`, whether the ray `to_light` hits anything.

        There must be functions for it.
        """
        assert self.functions.pairs is not None
        origin, entry = enter(self, ray)
        start, moved = enter(self, to_light)
        maxt = ray.maxt - entry
        own, other = (origin, ray.d, maxt), (start, to_light.d, to_light.maxt - moved)
        met, hidden = call_pairs(
            *self.functions.pairs, self.memory, own, other, followed, flags_of(None, through_lights)
        )
        return self._found(met, origin, entry, maxt), hidden

    def _found(self, met: Met, origin: Point3f, entry: Float, maxt: Float) -> Found:
        """The first hit of rays that end at `maxt`."""
        inside = dr.select(met.hit, met.inside, NONE) if self.instanced else None
        t, record = dr.select(met.hit, met.t, maxt), dr.select(met.hit, met.record, NONE)
        return Found(origin, entry, t, record, inside, Point2f(met.b1, met.b2))

    def start(
        self, o: Point3f, d: Vector3f, maxt: Float, active: Bool | bool, hit: UInt32 | int, weights: bool
    ) -> Progress:
        inside = UInt32(NONE) if self.instanced else None
        return Progress(Float(maxt), UInt32(hit), Bool(active), Point2f(0) if weights else None, inside)

    def turn(self, cursor: Progress, o: Point3f, d: Vector3f, any_hit: Bool, through_lights: Bool | None) -> Progress:
        flags = flags_of(any_hit, through_lights)
        met = call_closest(self.functions.closest, self.memory, o, d, cursor.t, cursor.waits, flags)
        return Progress(
            # Whether there is any hit is told by a finite distance.
            dr.select(met.hit, dr.select(any_hit, 0, met.t), cursor.t),
            dr.select(met.hit, met.record, cursor.hit),
            cursor.waits & False,
            None if cursor.b is None else dr.select(met.hit, Point2f(met.b1, met.b2), cursor.b),
            None if cursor.inside is None else dr.select(met.hit, met.inside, cursor.inside),
        )

    def lengths(self, o: Point3f, d: Vector3f, maxt: Float, active: Bool, medium: UInt32) -> tuple[Bool, list[Float]]:
        """Whether something opaque stands in a ray's way, and if not, how far it runs through each medium.

        There must be a function for it. Media are numbered as in `djpt.geometry.null_meshes`.

        Args:
            o: The origin, as seen from the centre.
            d: The direction.
            maxt: Where the ray ends.
            active: Lanes that have a ray.
            medium: The number of the medium in which it begins.
        """
        assert self.functions.lengths is not None
        return call_lengths(self.functions.lengths, self.memory, o, d, maxt, active, medium)

    def row(self, record: UInt32) -> list[UInt32]:
        words: Any = dr.gather(ArrayXu, self.memory, record, shape=(ROW_WORDS, 1))
        return list(words)

    def word(self, record: UInt32, index: int, active: Bool | bool = True) -> UInt32:
        word: UInt32 = dr.gather(UInt32, self.memory, record * ROW_WORDS + index, active)
        return word

    def map_rows(self, record: UInt32) -> list[UInt32]:
        # Where there is no record, any row will do.
        return [*self.row(dr.select(record == NONE, NONE, record - 1)), *self.row(record)]

    def corners(self, record: UInt32) -> None:
        return None


def flags_of(any_hit: Bool | None, through_lights: Bool | None) -> UInt32:
    """The flags of rays."""
    flags = UInt32(0)
    if any_hit is not None:
        flags |= dr.select(any_hit, UInt32(ANY_HIT), 0)
    if through_lights is not None:
        flags |= dr.select(through_lights, UInt32(PASSES_LIGHTS), 0)
    return flags


# ---- the trees of a scene ----------------------------------------------------------------------------------------


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
    placed: int
    """The number of boxes beside the triangles."""


def usual_size(corners: NDArray[np.float32], otherwise: float) -> float:
    """The median of the longest sides of the boxes around triangles (P, 3, 3), of a few thousand of them."""
    some = corners[:: max(1, len(corners) // 4096)]
    sides = np.sort(np.ptp(some, axis=1).max(axis=1))
    # `np.median` would import masked arrays, which takes longer than building a small tree.
    return float(sides[(len(sides) - 1) // 2 : len(sides) // 2 + 1].mean()) if len(sides) else otherwise


class CompiledTrees:
    """The trees of a scene: number 0 over the world, the others over its groups."""

    def __init__(self, search: str, sweeps: bool) -> None:
        """`search` is one of `SEARCHES`; if it `sweeps`, few triangles are all tested in its place."""
        self._search, self._sweeps = search, sweeps
        self._trees: dict[int, Tree] = {}

    def fit(self, number: int, part: MeshPart, boxes: NDArray[np.float32]) -> Extent:
        """Build a tree over meshes and placed boxes (P, 6), or fit it to where they are now."""
        missing = shortage(PRIMITIVE * (part.face_count + len(boxes)))
        if missing is not None:
            raise SceneError(f"a tree over {part.face_count} triangles {missing}; use instances, or coarser meshes")
        with workers(part.face_count, None) as team:
            corners = corners_of(part.meshes, team)
        built, cost = self._fitted(number, corners, boxes)
        self._trees[number] = Tree(built, cost, part, corners, len(boxes))
        return built.extent

    def _fitted(self, number: int, corners: NDArray[np.float32], boxes: NDArray[np.float32]) -> tuple[Built, float]:
        """The old tree refitted, or a new one if rays would take too many steps through the old."""
        old = self._trees.get(number)
        if old is not None and len(old.built.order) == len(corners) and old.placed == len(boxes):
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
        faces = self._faces() if placed is None else None
        end = int(first_triangle[-1])
        rows = aligned((end + (0 if faces is None else len(faces.rows)), ROW_WORDS))
        measures = self._search == RINGS and any(tree.part.ways is not None for tree in trees)
        for k, tree in enumerate(trees):
            own = rows[starts[k] : starts[k + 1]]
            own.ravel()[:] = tree.built.memory
            # The record of a placed primitive is its second row.
            own[0, :2] = first_triangle[k], starts[-1] + 1
            radius = tree.built.extent.diagonal / 2
            own[0].view(np.float32)[EXTENT_WORD : EXTENT_WORD + 2] = radius, usual_size(tree.corners, radius)
            if faces is not None:
                own[0, FACES_WORD : FACES_WORD + 3] = faces.header(end)
                rows[end:] = faces.rows
            records = rows[first_triangle[k] : first_triangle[k + 1]]
            part = tree.part
            with workers(len(records), None) as team:
                write_rows(records, tree.built.order, part.meshes, part.labels, tree.corners, part.first_face, team)
            tree.corners = tree.corners[:0]
            if part.ways is not None:
                records[:, 0] = part.ways[tree.built.order]
                part.ways = None
        extent = trees[0].built.extent
        if placed is not None:
            table = rows[starts[-1] : first_triangle[0]].reshape(count, PLACED_ROWS * ROW_WORDS)
            every = np.arange(count, dtype=np.int32)
            placed.write(table, every.view(np.uint32), every, extent.center)
        return CompiledTree(
            UInt32(rows.ravel()),
            functions(
                Features(len(trees) > 1, kinds, lights, one_sided),
                SWEEP if faces is not None else self._search,
                measures,
            ),
            as_vector(extent.center.astype(np.float64)),
            as_float(0.50001 * extent.diagonal),
            extent.diagonal,
            len(trees) > 1,
            kinds,
        )

    def _faces(self) -> Faces | None:
        """The faces of the world's triangles by their records, if all rays are to be tested against each."""
        tree = self._trees[0]
        # An edit that bends faces, so that they are too many, must not compile anew each time it is taken back.
        self._sweeps &= len(self._trees) == 1 and len(tree.corners) <= 2 * FEW
        if not self._sweeps:
            return None
        order, extent = tree.built.order, tree.built.extent
        faces = Faces.of(tree.corners[order] - extent.center, tree.part.label_of_face()[order], extent.diagonal)
        self._sweeps = faces is not None
        return faces

    def statistics(self) -> tuple[int, int, float]:
        """Nodes and levels of all trees, and the SAH cost of the world's."""
        trees = [tree.built for tree in self._ordered()]
        depth = trees[0].depth + max((tree.depth for tree in trees[1:]), default=0)
        return sum(tree.nodes for tree in trees), depth, trees[0].sah_cost

    def _ordered(self) -> list[Tree]:
        return [self._trees[number] for number in sorted(self._trees)]

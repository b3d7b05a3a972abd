"""Trees whose searches are steps that all lanes take together: the search, a tree by it, the trees of a scene.

Lanes have a ray each, or take one ray after the other.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.geometry.bvh.build.binary import build
from djpt.geometry.bvh.build.wide import REBUILD, WideTree, collapse, grown, refit, sah_cost
from djpt.geometry.bvh.leaves import Extent, MeshPart, MixedLeaves, PlacedLeaves, TriangleLeaves
from djpt.geometry.bvh.steps.records import EMPTY, WORDS, Leaves, Records, extent_of, pack, roots
from djpt.geometry.bvh.steps.traversal import Cursor, load, load_second, start, triangle_corners, turn, visit
from djpt.geometry.query import Found, enter
from djpt.jit.kernels import if_stmt, while_loop, wide
from djpt.jit.types import ArrayXf, Bool, Float, Point3f, UInt32, Vector3f

__all__ = ["StepTree", "StepTrees", "search"]

# ---- search ------------------------------------------------------------------------------------------------------


BATCH = 2**17
"""The lanes of a persistent loop: eight of Dr.Jit's blocks, which the cores share evenly."""


def search(
    records: Records, ray: Ray3f, any_hit: bool, active: Bool | bool = True, through_lights: Bool | None = None
) -> Found:
    """Find the first hit with 0 < t < maxt, or with `any_hit` any one."""
    lanes = dr.width(ray, active, through_lights)
    if lanes >= 2 * BATCH and through_lights is None and not dr.flag(dr.JitFlag.SymbolicScope):
        return batched(records, ray, any_hit, active, lanes)
    origin, entry = enter(records, ray)
    (end,) = while_loop(
        (wide(start(records, origin, ray.d, ray.maxt - entry, active), lanes),),
        lambda cursor: cursor.current != EMPTY,
        lambda cursor: (visit(records, cursor, origin, ray.d, Bool(any_hit), through_lights),),
        label="any hit" if any_hit else "closest hit",
    )
    return Found(origin, entry, end.t, end.hit, end.passage and end.passage.hit_inside)


def packed(records: Records, ray: Ray3f, active: Bool | bool, lanes: int) -> Float:
    """Write rays to memory, 8 numbers each for one packet load: origin near the triangles, direction, maxt, 0."""
    o, entry = enter(records, ray)
    # The cursor of a ray whose origin is NaN starts as finished.
    x = dr.select(active, o.x, dr.nan)
    rays = dr.empty(Float, 8 * lanes)
    values = wide([x, o.y, o.z, ray.d.x, ray.d.y, ray.d.z, ray.maxt - entry, Float(0)], lanes)
    dr.scatter(rays, ArrayXf(values), dr.arange(UInt32, lanes))
    dr.eval(rays)
    return rays


@dataclass
class Flight:
    """Loop state of `batched`."""

    index: UInt32
    origin: Point3f
    d: Vector3f
    cursor: Cursor


def batched(records: Records, ray: Ray3f, any_hit: bool, active: Bool | bool, lanes: int) -> Found:
    """Search for `lanes` rays by `BATCH` lanes: a lane that has finished takes the next ray.

    Traversals differ in length; with one ray per lane a packet would wait for its longest one.
    """
    rays = packed(records, ray, active, lanes)
    count, stride = dr.opaque(UInt32, lanes), dr.opaque(UInt32, BATCH)
    t, record = dr.empty(Float, lanes), dr.empty(UInt32, lanes)
    inside = dr.empty(UInt32, lanes) if records.instanced else None

    def fetch(index: UInt32) -> Flight:
        exists = index < count
        x: Any = dr.gather(ArrayXf, rays, index, exists, shape=(8, 1))
        o, d = Point3f(x[0], x[1], x[2]), Vector3f(x[3], x[4], x[5])
        return Flight(index, o, d, start(records, o, d, x[6], exists))

    def land(flight: Flight) -> Flight:
        dr.scatter(t, flight.cursor.t, flight.index)
        dr.scatter(record, flight.cursor.hit, flight.index)
        passage = flight.cursor.passage
        if inside is not None and passage is not None:
            dr.scatter(inside, passage.hit_inside, flight.index)
        return fetch(flight.index + stride)

    def body(flight: Flight) -> tuple[Flight]:
        flight.cursor = turn(records, flight.cursor, flight.origin, flight.d, Bool(any_hit))
        ended = flight.cursor.current == EMPTY
        (flight,) = if_stmt((flight,), ended, lambda flight: (land(flight),), lambda flight: (flight,))
        return (flight,)

    first = wide(fetch(dr.arange(UInt32, BATCH)), BATCH)
    (end,) = while_loop((first,), lambda flight: flight.index < count, body, label="ray batch")
    dr.eval(end.index, t, record, inside)
    return Found(*enter(records, ray), t, record, inside)


# ---- a tree ------------------------------------------------------------------------------------------------------


@dataclasses.dataclass
class StepTree(Records):
    """Records with the searches that `djpt.geometry.bvh` has for them."""

    stepwise: bool = True

    # The searches take the records as their first parameter, so they are methods.
    search, start, turn = search, start, turn

    @staticmethod
    def of(records: Records) -> StepTree:
        """The tree of some records."""
        return StepTree(**{field.name: getattr(records, field.name) for field in dataclasses.fields(records)})

    @property
    def bytes(self) -> int:
        return 4 * dr.width(self.words)

    def row(self, record: UInt32) -> list[UInt32]:
        return load_second(self.words, record)

    def word(self, record: UInt32, index: int, active: Bool | bool = True) -> UInt32:
        word: Any = dr.gather(UInt32, self.words, record * WORDS + (WORDS // 2 + index), active)
        return UInt32(word)

    def map_rows(self, record: UInt32) -> list[UInt32]:
        return load(self.words, record)

    def corners(self, record: UInt32) -> tuple[Point3f, Point3f, Point3f]:
        return triangle_corners(load(self.words, record))


# ---- the trees of a scene ----------------------------------------------------------------------------------------


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
        """The record of the root of each tree, by which instances refer to it."""
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

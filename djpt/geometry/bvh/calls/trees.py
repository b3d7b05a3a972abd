"""Trees whose searches are calls of compiled functions: the functions, their calls in kernels, the trees of a scene."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.memory import shortage
from djpt.core.records import Ray3f
from djpt.errors import SceneError
from djpt.geometry.bvh.build.builder import Built, build, refit, workers
from djpt.geometry.bvh.build.rows import corners_of, write_rows
from djpt.geometry.bvh.build.wide import REBUILD
from djpt.geometry.bvh.calls.crossings import LENGTHS_OF_PACKET, crossing_function
from djpt.geometry.bvh.calls.faces import FEW, Faces
from djpt.geometry.bvh.calls.layout import (
    ANY_HIT,
    EXTENT_WORD,
    FACES_WORD,
    MEDIUM_BITS,
    PASSES_LIGHTS,
    REFERENCE,
    ROW_WORDS,
)
from djpt.geometry.bvh.calls.pairs import KEEP_ORIGINS, PAIRS, pair_functions
from djpt.geometry.bvh.calls.ray import Features
from djpt.geometry.bvh.calls.rings import ring_function
from djpt.geometry.bvh.calls.sweep import sweep_function
from djpt.geometry.bvh.calls.traversal import ANY, CLOSEST, name_of, packet_function
from djpt.geometry.bvh.leaves import Extent, MeshPart, PlacedLeaves
from djpt.geometry.query import NONE, Found, enter
from djpt.jit.kernels import aligned, as_float, as_vector, float_in
from djpt.jit.llvm.calls import Code, call, reason_against
from djpt.jit.llvm.compiler import compiled
from djpt.jit.llvm.lanes import instruction_set, lane_count, target
from djpt.jit.types import ArrayXu, Bool, Float, Point2f, Point3f, UInt32, Vector3f

__all__ = [
    "SEARCHES",
    "CompiledTree",
    "CompiledTrees",
    "Functions",
    "Met",
    "call_any",
    "call_closest",
    "functions",
    "why_not",
]

# ---- calls -------------------------------------------------------------------------------------------------------


@dataclass
class Met:
    """The results of a search."""

    hit: Bool
    t: Float
    """The distance; infinity on a miss."""
    b1: Float
    b2: Float
    record: UInt32
    inside: UInt32
    """The record of the instance that the hit belongs to, 0 if none."""


def call_closest(code: Code, scene: UInt32, o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> Met:
    """Find the first hit with 0 < t < maxt of each active lane's ray."""
    outputs: list[Any] = [Bool(False), Float(0), Float(0), Float(0), UInt32(0), UInt32(0)]
    return Met(*call(code, scene, arguments(o, d, maxt, active, flags), outputs))


def call_any(code: Code, scene: UInt32, o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> Bool:
    """Whether each active lane's ray has a hit with 0 < t < maxt."""
    return Bool(call(code, scene, arguments(o, d, maxt, active, flags), [Bool(False)], any_hit=True)[0])


def call_pairs(
    keep: Code,
    pairs: Code,
    scene: UInt32,
    ray: tuple[Point3f, Vector3f, Float],
    to_light: tuple[Point3f, Vector3f, Float],
    followed: Bool,
    flags: UInt32,
) -> tuple[Met, Bool]:
    """`call_closest` for each `ray`, and `call_any` for the ray `to_light` where that is `followed`.

    Rays are their origins, directions and ends.
    """
    o, d, maxt = to_light
    kept = call(keep, scene, arguments(o, d, maxt, followed, UInt32(0)), [Bool(False)], any_hit=True)[0]
    end = dr.select(Bool(kept), dr.detach(maxt), 0)
    inputs: list[Any] = arguments(*ray, Bool(True), flags)
    d = dr.detach(d)
    rest: list[Float] = [d.x, d.y, d.z, end]
    for place, number in zip(TO_LIGHT, rest, strict=True):
        inputs[place] = number if place < FIRST_WHOLE else dr.reinterpret_array(UInt32, number)
    outputs: list[Any] = [Bool(False), Float(0), Float(0), Float(0), UInt32(0), UInt32(0), UInt32(0)]
    *met, hidden = call(pairs, scene, inputs, outputs)
    return Met(*met), Bool(hidden != 0)


TO_LIGHT, FIRST_WHOLE = (5, 9, 12, 13), 11
"""The inputs that `call_pairs` uses for the direction and the end of a ray to a light; the first of whole numbers."""


def call_lengths(
    code: Code, scene: UInt32, o: Point3f, d: Vector3f, maxt: Float, active: Bool, medium: UInt32
) -> tuple[Bool, list[Float]]:
    """Measure rays up to `maxt` through media: see `CompiledTree.lengths`."""
    outputs: list[Any] = [Bool(False), Float(0), Float(0), Float(0), UInt32(0), UInt32(0)]
    inputs = arguments(o, d, maxt, active, medium << MEDIUM_BITS)
    found, first, second, third, fourth, blocked = call(code, scene, inputs, outputs)
    # Rays that aren't followed, such as those with NaN, meet nothing.
    lengths = [
        dr.select(found, length, dr.select(medium == number, maxt, 0))
        for number, length in enumerate((first, second, third, float_in(fourth)), 1)
    ]
    return Bool(found & (blocked != 0)), lengths


def arguments(o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> list[Float | UInt32 | Bool]:
    """The inputs of a call, in Embree's order."""
    # A negative end would mean "blocked" when it comes back.
    o, d, maxt = dr.detach(o), dr.detach(d), dr.select(maxt > 0, dr.detach(maxt), 0)
    # A ray with NaN would meet all boxes, also those of missing children.
    reach = dr.abs(o.x) + dr.abs(o.y) + dr.abs(o.z)
    active = active & (reach < 1e18) & dr.isfinite(d.x + d.y + d.z)
    zero, unused = Float(0), UInt32(0)
    return [Bool(False), active, o.x, o.y, o.z, zero, d.x, d.y, d.z, zero, maxt, flags, unused, unused]


# ---- a tree ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Functions:
    """The compiled functions of a tree."""

    closest: Code
    any: Code
    pairs: tuple[Code, Code] | None = None
    """Those that search for two rays of each lane; None if the search can't."""
    lengths: Code | None = None
    """The one that measures media; None if no triangle is passable, or the search can't."""


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
        own, maxt = (origin, ray.d, ray.maxt - entry), ray.maxt - entry
        start, moved = enter(self, to_light)
        other = start, to_light.d, to_light.maxt - moved
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


# ---- compiled functions ------------------------------------------------------------------------------------------


RINGS = "rings"
SEARCHES: dict[str, Callable[[str, int, Features], str]] = {RINGS: ring_function, "call": packet_function}
"""The searches in LLVM's language, the fastest first: of the rays of a packet side by side, or one after the other."""

SWEEP = "sweep"
"""The search among few faces, which no scene is asked for."""

FUNCTIONS = SEARCHES | {SWEEP: sweep_function}


@cache
def functions(features: Features, search: str, measures: bool = False) -> Functions:
    """The functions of one of `FUNCTIONS` for scenes with some features, compiled at the first call.

    If it `measures`, there is one that does, by rings; not for scenes with instances.
    """
    measures &= not features.instances
    lengths = Code.at(address_of_lengths(features)) if measures else None
    closest, any_hit, *pairs = (Code.at(address) for address in addresses(features, search))
    return Functions(closest, any_hit, (pairs[0], pairs[1]) if pairs and proof(search).pairs else None, lengths)


@cache
def addresses(features: Features, search: str) -> list[int]:
    """Where the functions for the closest hit and for any hit are in memory, then those for pairs of rays, if any.

    Rings have these, but not for scenes with solids in their trees, among which any hit is found faster alone.
    """
    width = lane_count()
    target()  # for which other threads may not be able to ask

    def search_of(kind: str) -> list[int]:
        found = compiled(FUNCTIONS[search](kind, width, features), (name_of(kind),))
        return [found[name_of(kind)]]

    def search_of_pairs() -> list[int]:
        found = compiled(pair_functions(width, features), (KEEP_ORIGINS, PAIRS))
        return [found[KEEP_ORIGINS], found[PAIRS]]

    with ThreadPoolExecutor(2) as team:
        parts = [team.submit(search_of, kind) for kind in (CLOSEST, ANY)]
        if search == RINGS and not features.kinds:
            parts.append(team.submit(search_of_pairs))
        return [address for part in parts for address in part.result()]


@cache
def address_of_lengths(features: Features) -> int:
    """Where the function that measures media is in memory."""
    return compiled(crossing_function(lane_count(), features), (LENGTHS_OF_PACKET,))[LENGTHS_OF_PACKET]


@cache
def why_not(search: str) -> str | None:
    """What stands against one of `SEARCHES` on this machine; None if it works.

    Found out at the first call, by rays whose hits are known.
    """
    if search == RINGS and instruction_set() not in RING_SETS:
        return "the processor, or Dr.Jit's packets, lack AVX2"
    return reason_against(lambda: proof(search).hits, "rays with known hits got other results")


RING_SETS = ("AVX-512", "AVX2")
"""The instruction sets by which vectors can be compressed."""


class Proof(NamedTuple):
    """What functions were proved to find."""

    hits: bool
    """The closest hits and any hits of rays."""
    pairs: bool
    """Both for two rays of each lane."""


@cache
def proof(search: str) -> Proof:
    """Let rays through a stack of triangles find the hits that follow from how it was made."""
    count, misses = 40, 3
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    # Triangle k lies at x = 2 k, in the plane z = k.
    corners = corner + np.arange(count, dtype=np.float32)[:, None, None] * np.array([2, 0, 1], np.float32)
    # Threads compile the functions that search and those that build.
    target()  # which other threads may not be able to ask for
    with ThreadPoolExecutor(1) as team:
        searches = team.submit(addresses, Features(), search)
        built = build(corners)
        searches.result()
    built.memory[0] = 0
    memory = UInt32(built.memory)
    closest, any_hit, *pair = (Code.at(address) for address in addresses(Features(), search))
    lane = dr.arange(UInt32, count + misses)
    exists = lane < count
    x, z = Float(2 * lane), Float(lane)
    center = Point3f(*(float(c) for c in built.extent.center))
    o, d = Point3f(x + 0.25, 0.5, z - 4) - center, Vector3f(0, 0, 2)
    met = call_closest(closest, memory, o, d, Float(dr.inf), Bool(True), UInt32(0))
    blocked = call_any(any_hit, memory, o, d, Float(2.5), lane != 1, UInt32(0))
    triangle = dr.gather(UInt32, UInt32(built.order), met.record, met.hit)
    right = (met.hit == exists) & (blocked == (exists & (lane != 1)))
    near = (abs(met.t - 2) < 1e-5) & (abs(met.b1 - 0.25) < 1e-5) & (abs(met.b2 - 0.5) < 1e-5)
    right &= near & (triangle == lane) & (met.inside == 0) | ~exists
    if not pair:
        return Proof(bool(dr.all(right)), False)
    far, moved = Float(dr.inf), o - Vector3f(0.125, 0, 0)
    again, hidden = call_pairs(pair[0], pair[1], memory, (o, d, far), (moved, d, Float(2.5)), lane != 1, UInt32(0))
    same = (again.t == met.t) & (again.record == met.record) | ~exists
    alike = (again.hit == met.hit) & (hidden == blocked) & same
    dr.eval(right, alike)
    return Proof(bool(dr.all(right)), bool(dr.all(alike)))


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

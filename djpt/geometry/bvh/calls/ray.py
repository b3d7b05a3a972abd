"""A ray in the form in which compiled functions test boxes and triangles, and what it meets through a transform."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

from djpt.geometry.bvh.calls.layout import CHILDREN, PASSES_LIGHTS, REFERENCE, ROW_BYTES, ROW_WORDS
from djpt.geometry.bvh.steps.records import EMITS, ONE_SIDED, SOLID
from djpt.geometry.canonical import PIECE, hit_kind
from djpt.geometry.query import LABEL, NORMAL, RADII
from djpt.jit.llvm import arithmetic
from djpt.jit.llvm.arithmetic import abs, copysign, fma, maximum, minimum, select
from djpt.jit.llvm.ir import F32, I32, I64, Function, Type, Value, vector

__all__ = [
    "ROW",
    "AxisOrder",
    "BoxRay",
    "Features",
    "Placed",
    "PlaneRay",
    "RayTerms",
    "TriangleTest",
    "Triple",
    "overlap",
    "sheared",
]

ROW = vector(F32, CHILDREN)
"""A number for each child of a node, or for each triangle of a leaf."""

SMALL = 1e-18
"""Components of directions closer to 0 are replaced: 0 x inf would arise where the origin lies in a plane of a box."""


@dataclass
class AxisOrder:
    """The cyclic order of axes in which the one along which a direction is longest comes last."""

    last_z: Value
    last_x: Value
    """Counts where `last_z` is false."""

    @staticmethod
    def of(d: Sequence[Value]) -> AxisOrder:
        """The order for a direction, or for each of several."""
        x, y, z = (abs(component) for component in d)
        return AxisOrder((z >= x) & (z >= y), x >= y)

    def apply(self, values: Sequence[Value]) -> list[Value]:
        """Put one value per axis in this order."""
        return [
            select(self.last_z, values[k], select(self.last_x, values[(k + 1) % 3], values[(k + 2) % 3]))
            for k in range(3)
        ]


@dataclass
class RayTerms:
    """What the tests of a ray need to know; fields are lists of one value per axis.

    The values are scalars, or vectors with a lane for each ray of a packet.

    The axis along which the direction is longest becomes the last one, and a shear makes the ray run along it: S.
    Woop, C. Benthin and I. Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013.
    """

    inverse: list[Value]
    shift: list[Value]
    """-origin / direction."""
    near: list[Value]
    """The bytes from the start of a node to the planes that the ray comes to first."""
    axes: list[Value]
    """The bytes from the coordinates of a corner to the one along each axis, in the order of the shear."""
    origin: list[Value]
    """The origin in this order."""
    shear: list[Value]
    """For two axes, and 1 / direction for the last."""

    @staticmethod
    def of(o: Sequence[Value], d: Sequence[Value]) -> RayTerms:
        """Compute the terms of a ray, or of several."""
        usable = [select(abs(x) < SMALL, copysign(SMALL, x), x) for x in d]
        inverse = [1.0 / x for x in usable]
        shift = [-(x * i) for x, i in zip(o, inverse, strict=True)]
        f, integer = d[0].function, Type("i", 32, d[0].type.lanes)
        numbers = [f.constant(integer, ROW_BYTES * k) for k in range(2 * 3)]
        near = [select(inverse[a] < 0.0, numbers[2 * a + 1], numbers[2 * a]) for a in range(3)]
        order = AxisOrder.of(d)
        along = order.apply(d)
        slope = 1.0 / along[2]
        return RayTerms(
            inverse,
            shift,
            near,
            order.apply(numbers[:3]),
            order.apply(o),
            [-(along[0] * slope), -(along[1] * slope), slope],
        )

    @staticmethod
    def types() -> list[Type]:
        """The types of `values`."""
        return [I32 if field.name in ("near", "axes") else F32 for field in fields(RayTerms) for _ in range(3)]

    @staticmethod
    def from_values(values: Sequence[Value]) -> RayTerms:
        """The terms from their `values`."""
        return RayTerms(*(list(values[3 * k : 3 * k + 3]) for k in range(len(fields(RayTerms)))))

    def values(self) -> list[Value]:
        """All terms, one after the other."""
        return [value for field in fields(self) for value in getattr(self, field.name)]


class BoxRay:
    """A ray that is tested against eight boxes at once, by the distances of their planes."""

    def __init__(self, function: Function, terms: RayTerms) -> None:
        self._function = function
        self._inverse = [x.spread(CHILDREN) for x in terms.inverse]
        self._shift = [x.spread(CHILDREN) for x in terms.shift]
        self._near = [x.to(I64) for x in terms.near]
        # The two rows of an axis differ in one bit.
        self._far = [x ^ ROW_BYTES for x in self._near]

    def meet(self, node: Value, reach: Value) -> tuple[Value, Value]:
        """Where the ray enters the children of a node, and a mask of those that it meets before `reach`."""
        near, far = (
            [fma(self._row(node, rows[a]), self._inverse[a], self._shift[a]) for a in range(3)]
            for rows in (self._near, self._far)
        )
        return overlap(near, far, reach)

    def _row(self, node: Value, offset: Value) -> Value:
        return self._function.load(ROW, node.at(offset), align=ROW_BYTES)


def overlap(near: Sequence[Value], far: Sequence[Value], reach: Value) -> tuple[Value, Value]:
    """Where rays enter boxes, and a mask of those that they meet before `reach`.

    `near` and `far` are the distances of the planes that they come to first and last, along each axis.
    """
    entry = maximum(maximum(near[0], near[1]), maximum(near[2], 0.0))
    return entry, entry <= minimum(minimum(far[0], far[1]), minimum(far[2], reach))


class PlaneRay:
    """A ray that is tested against eight triangles at once, watertight."""

    def __init__(self, function: Function, terms: RayTerms) -> None:
        self._function = function
        self._axes = [x.to(I64) for x in terms.axes]
        self._origin = [x.spread(CHILDREN) for x in terms.origin]
        self._shear = [x.spread(CHILDREN) for x in terms.shear]

    def meet(self, leaf: Value) -> TriangleTest:
        """Test the triangles of a leaf."""
        return TriangleTest.of(
            lambda corner, axis: self._row(leaf, corner, axis), self._axes, self._origin, self._shear
        )

    def _row(self, leaf: Value, corner: int, axis: Value) -> Value:
        return self._function.load(ROW, leaf.at(axis).at(3 * ROW_BYTES * corner), align=ROW_BYTES)


class Triple(NamedTuple):
    """A point or vector."""

    x: Value
    y: Value
    z: Value


class TriangleTest:
    """The tests of eight triangles by one ray, or of one triangle by several rays."""

    @staticmethod
    def of(
        coordinate: Callable[[int, Value], Value],
        axes: Sequence[Value],
        origin: Sequence[Value],
        shear: Sequence[Value],
    ) -> TriangleTest:
        """Test triangles by their corners: `coordinate` reads that of a corner along one of the `axes`.

        `axes`, `origin` and `shear` are those of `RayTerms`.
        """
        corners = [sheared([coordinate(corner, axes[k]) - origin[k] for k in range(3)], shear) for corner in range(3)]
        return TriangleTest.between(corners, shear[2])

    @staticmethod
    def between(corners: Sequence[Triple], inverse: Value) -> TriangleTest:
        """Test triangles between three `sheared` corners; `inverse` is the last number of the shear."""
        a, b, c = corners
        # Products and differences are rounded one by one: swapping the ends of an edge then changes
        # the sign of its function and nothing else.
        edges = c.x * b.y - c.y * b.x, a.x * c.y - a.y * c.x, b.x * a.y - b.y * a.x
        return TriangleTest(edges, [corner.z for corner in corners], inverse)

    def __init__(self, edges: Sequence[Value], heights: Sequence[Value], inverse: Value) -> None:
        w0, w1, w2 = edges
        self.edges, self.heights, self._inverse = edges, heights, inverse
        self.inside = (minimum(minimum(w0, w1), w2) >= 0.0) | (maximum(maximum(w0, w1), w2) <= 0.0)
        """Where the line through the ray meets a triangle, edges included; false for NaN."""

    def otherwise(self, other: TriangleTest) -> TriangleTest:
        """This test where it is `inside`, else another one of the same rays."""

        def choose(a: Sequence[Value], b: Sequence[Value]) -> list[Value]:
            return [select(self.inside, x, y) for x, y in zip(a, b, strict=True)]

        return TriangleTest(choose(self.edges, other.edges), choose(self.heights, other.heights), self._inverse)

    def distance(self) -> tuple[Value, Value, Value]:
        """The distances, and the weights of the second and third corners; unspecified where not `inside`.

        A distance is a convex combination of the corners' own, so that even a sliver seen edge-on doesn't give
        one far off.
        """
        w0, w1, w2 = self.edges
        z0, z1, z2 = self.heights
        inverse = 1.0 / (w0 + w1 + w2)
        t = fma(w0, z0, fma(w1, z1, w2 * z2)) * inverse * self._inverse
        return t, w1 * inverse, w2 * inverse


def sheared(point: Sequence[Value], shear: Sequence[Value]) -> Triple:
    """A point, seen from a ray's origin and in its order of axes, in the frame where the ray runs along z."""
    x, y, z = point
    return Triple(fma(shear[0], z, x), fma(shear[1], z, y), z)


# ---- instances of groups, and analytic solids --------------------------------------------------------------------


@dataclass(frozen=True)
class Features:
    """What the functions for a scene must be able to do; they have no code for anything else."""

    instances: bool = False
    kinds: tuple[int, ...] = ()
    """The kinds of analytic solids: numbers into `djpt.geometry.canonical.KINDS`."""
    lights: bool = False
    """Whether shapes emit that rays may pass through."""
    one_sided: bool = False
    """Whether rays pass through some triangles that they meet from behind."""

    @property
    def placed(self) -> bool:
        """Whether anything stands in the tree with a transform."""
        return self.instances or bool(self.kinds)

    def passed(self, f: Function, scene: Value, record: Value, flags: Value) -> Value:
        """Whether a ray with `flags` passes through the shape at a record since it is part of a light."""
        label = f.load(I32, scene.at(record.to(I64) * ROW_BYTES).at(4 * LABEL))
        return ((flags & PASSES_LIGHTS) != 0) & ((label & EMITS) != 0)

    def behind(self, f: Function, scene: Value, record: Value, d: Sequence[Value]) -> Value:
        """Whether a ray along `d` meets a one-sided triangle from behind."""
        row = scene.at(record.to(I64) * ROW_BYTES)
        x, y, z = (f.load(F32, row.at(4 * (NORMAL + axis))) for axis in range(3))
        label = f.load(I32, row.at(4 * LABEL))
        return ((label & ONE_SIDED) != 0) & (fma(x, d[0], fma(y, d[1], z * d[2])) > 0.0)


class Placed:
    """A placed primitive; `record` is the number of its second row."""

    def __init__(self, f: Function, scene: Value, record: Value) -> None:
        self._f, self._scene, self.record = f, scene, record
        self._address = scene.at(record.to(I64) * ROW_BYTES).at(-ROW_BYTES)

    @staticmethod
    def of(f: Function, scene: Value, reference: Value) -> Placed:
        """The primitive of a reference in the world's tree."""
        return Placed(f, scene, (reference & REFERENCE) * 2 + f.load(I32, scene.at(4)))

    def visit(self, features: Features, solid: Callable[[], None], instance: Callable[[], None]) -> None:
        """Build the visit of a solid, of an instance, or a branch between them if the scene has both."""
        if not features.kinds:
            instance()
        elif not features.instances:
            solid()
        else:
            with self._f.either((self.word(LABEL) & SOLID) != 0) as branch:
                solid()
                branch.otherwise()
                instance()

    def hits(self, kinds: Sequence[int], kind: Value, o: Triple, d: Triple) -> Iterator[tuple[Value, Value]]:
        """Whether and where a ray in the primitive's space hits a solid, for each of the scene's `kinds`.

        What is built before the next one runs for solids of that kind alone.
        """
        for k in kinds:
            with self._f.when(kind >= k if k == PIECE else kind == k):
                radii = [self.float(RADII + end) for end in range(2)] if k == PIECE else []
                yield hit_kind(arithmetic, k, o, d, radii)

    def word(self, index: int) -> Value:
        """A whole number of the record."""
        return self._f.load(I32, self._address.at(4 * (ROW_WORDS + index)))

    def float(self, index: int) -> Value:
        """A number of the record."""
        return self._f.load(F32, self._address.at(4 * (ROW_WORDS + index)))

    def into(self, o: Sequence[Value], d: Sequence[Value]) -> tuple[Triple, Triple]:
        """A ray in the primitive's space; distances stay the same."""
        origin, direction = [], []
        for row in range(3):
            x, y, z, shift = (self._f.load(F32, self._address.at(16 * row + 4 * k)) for k in range(4))
            origin.append(fma(x, o[0], fma(y, o[1], z * o[2])) + shift)
            direction.append(fma(x, d[0], fma(y, d[1], z * d[2])))
        return Triple(*origin), Triple(*direction)

"""The unrolled set: the tests of all its shapes one after the other, without loops or memory traffic.

For scenes of a few analytic shapes nothing is faster: all values sit in registers, and
shapes that share axes share projections. Three things are decided on the host, from the
shapes' places, and become structure of the kernel:

* which axes are shared (`djpt.shapes.axes`),
* which shapes can block the segment between a surface and a light (`Unrolled.occludes`),
* how faces are numbered: sorted by normal, so that a frame is found by a few comparisons.

An edit re-places the shapes; structure only ever becomes more general, so that moving
something back and forth compiles one kernel at most.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from functools import cached_property

import drjit as dr
import numpy as np

from djpt.core.frame import Frame3f
from djpt.core.lookup import Members, Numbers, Rows
from djpt.core.records import Ray3f
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f
from djpt.shapes.axes import Axis, AxisPool, ProjectedRay, SignedAxis
from djpt.shapes.base import Face, Shape

__all__ = ["Unrolled"]

UNITS = np.eye(3)


class Unrolled:
    """Closest-hit and any-hit queries against a list of shapes."""

    def __init__(
        self,
        shapes: Sequence[Shape],
        others: Sequence[Shape],
        lights: Sequence[Shape],
        points: Sequence[Point3f],
        open_sky: bool,
    ):
        """`others` are shapes of the scene that aren't in this set, `lights` the shapes that emit.

        `points` are finite light positions; `open_sky` is true if there is light from infinity.
        """
        self.shapes, self._others = tuple(shapes), tuple(others)
        self._lights, self._points, self._open_sky = lights, points, open_sky
        self.pool = AxisPool()
        self.occludes = [False] * len(shapes)
        for shape in shapes:
            shape.place(self.pool)
        # Lights sample shapes that stand in the BVH, too: those need their values as well.
        for shape in others:
            shape.place(AxisPool())
        self._number_faces()
        self._find_occluders()

    def move(self, shape: Shape) -> None:
        """Follow an edit of a shape's parameters."""
        self.__dict__.pop("_extent", None)
        if shape not in self.shapes:
            shape.place(AxisPool())
            self._find_occluders()
            return
        before = [self._face_key(f) for f in shape.faces()]
        shape.place(self.pool)
        if [self._face_key(f) for f in shape.faces()] != before:
            self._number_faces()
        else:
            self._tabulate()
        self._find_occluders()

    def move_points(self, points: Sequence[Point3f]) -> None:
        """Follow an edit of the finite light positions."""
        self._points = points
        self._find_occluders()

    def bounding_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest corner of all shapes, the others included; (+inf, -inf) if there are none.

        Infinite extents, those of planes, don't count.
        """
        low, high, _ = self._extent
        return low.copy(), high.copy()

    @property
    def is_bounded(self) -> bool:
        """Whether no shape, the others included, reaches to infinity."""
        return self._extent[2]

    @cached_property
    def _extent(self) -> tuple[np.ndarray, np.ndarray, bool]:
        """The corners of the bounding box, and whether all shapes lie in it; until the next move."""
        low, high, bounded = np.full(3, np.inf), np.full(3, -np.inf), True
        for shape in (*self.shapes, *self._others):
            for k, unit in enumerate(UNITS):
                a, b = shape.interval(unit)
                if math.isfinite(a) and math.isfinite(b):
                    low[k], high[k] = min(low[k], a), max(high[k], b)
                elif math.isinf(a) or math.isinf(b):
                    bounded = False
        return low, high, bounded

    # ---- structure -----------------------------------------------------------------

    @staticmethod
    def _face_key(face: Face) -> Hashable:
        return (face.normal.key(), face.shading.key(), face.tangent.key())

    def _number_faces(self) -> None:
        """Give every face of every shape a number; faces of equal normal axis get neighbouring ones."""
        entries = []
        for i, shape in enumerate(self.shapes):
            faces = shape.faces()
            for k in range(shape.sides):
                face = faces[k] if faces else None
                axis = self.pool.axes.index(face.normal.axis) if face else -1
                entries.append((axis, face.normal.negative if face else False, i, k, face))
        entries.sort(key=lambda e: e[:4])
        self.face_shape = [e[2] for e in entries]
        self.face_local = [e[3] for e in entries]
        self._frames = [e[4] for e in entries]
        self.face_number = [[0] * shape.sides for shape in self.shapes]
        for number, entry in enumerate(entries):
            self.face_number[entry[2]][entry[3]] = number
        self.face_count = len(entries)
        self._shape_of, self._local_face = Numbers(self.face_shape), Numbers(self.face_local)
        self._tabulate()

    def _tabulate(self) -> None:
        """Build the tables that kernels look frames up in."""
        self._normals = Directions([face.shading if face else None for face in self._frames])
        turned = [n for n, face in enumerate(self._frames) if face and face.normal.negative != face.shading.negative]
        self._turned = Members(turned, len(self._frames)) if turned else None
        self._tangents = Directions([face.tangent if face else None for face in self._frames])

    def _find_occluders(self) -> None:
        """Find the shapes that may stand between a surface point and a light.

        A flat shape can't if everything, lights included, lies on one side of its plane. The only light
        can't block its own light either.
        """
        low, high = self.bounding_box()
        tolerance = 1e-5 * float(np.max(high - low, initial=0.0))
        for i, shape in enumerate(self.shapes):
            self.occludes[i] |= not self._is_hull(shape, tolerance)

    def _is_hull(self, shape: Shape, tolerance: float) -> bool:
        plane = shape.plane()
        if plane is None or self._open_sky:
            return False
        if len(self._lights) == 1 and not self._points and self._lights[0] is shape:
            return True
        normal, offset = plane
        intervals = [s.interval(normal) for s in (*self.shapes, *self._others)]
        intervals += [(float(p @ normal), float(p @ normal)) for p in map(_host_point, self._points)]
        lowest, highest = min(a for a, _ in intervals), max(b for _, b in intervals)
        return lowest >= offset - tolerance or highest <= offset + tolerance

    # ---- queries -------------------------------------------------------------------

    def closest(
        self,
        ray: Ray3f,
        skip: Sequence[bool] | None = None,
        skipping: Bool | None = None,
        among: Sequence[bool] | None = None,
    ) -> tuple[Float, UInt32]:
        """Distance and face number of the first hit with 0 < t < maxt; infinity on a miss.

        Shapes marked in `skip` are ignored by the lanes where `skipping` is true; `among` marks the shapes that are
        tested at all (default: every one).
        """
        projected = ProjectedRay(ray)
        t, number = ray.maxt, UInt32(0)
        found = Bool(False)
        for i, shape in enumerate(self.shapes):
            if among is not None and not among[i]:
                continue
            hit = shape.intersect(projected, t, self.face_number[i])
            ok = hit.hit
            if skip is not None and skip[i] and skipping is not None:
                ok &= ~skipping
            t = dr.select(ok, hit.t, t)
            number = dr.select(ok, hit.number, number)
            found |= ok
        return dr.select(found, t, dr.inf), number

    def shape_of(self, number: UInt32) -> UInt32:
        """The shape that a face number belongs to."""
        return self._shape_of.at(number)

    def local_face(self, number: UInt32) -> UInt32:
        """The number of a face within its shape."""
        return self._local_face.at(number)

    def per_face(self, of_shape: Sequence[int]) -> Numbers:
        """Turn a table of numbers by shape into one by face number, for a single lookup."""
        return Numbers([of_shape[shape] for shape in self.face_shape])

    def faces_of(self, shapes: Sequence[int]) -> list[int]:
        """All face numbers of some shapes."""
        return [n for s in shapes for n in self.face_number[s]]

    def any_hit(self, ray: Ray3f, active: Bool | bool = True, among: Sequence[bool] | None = None) -> Bool:
        """Whether anything is hit with 0 < t < maxt; `among` marks the shapes that are tested (default: every one)."""
        return self._any(ray, [True] * len(self.shapes) if among is None else among) & active

    def blocked(self, ray: Ray3f) -> Bool:
        """Like `any_hit`, for a segment between a surface point and a light that shines on it."""
        return self._any(ray, self.occludes)

    def _any(self, ray: Ray3f, consider: Sequence[bool]) -> Bool:
        projected = ProjectedRay(ray)
        result = Bool(False)
        for shape, considered, numbers in zip(self.shapes, consider, self.face_number, strict=True):
            if considered:
                result |= shape.occludes(projected, numbers)
        return result

    def frame(self, number: UInt32) -> tuple[Vector3f, Frame3f]:
        """Geometric normal and shading frame of a flat face."""
        n, s = self._normals.at(number), self._tangents.at(number)
        geometric = n if self._turned is None else self._turned.negated(number, n)
        return geometric, Frame3f(s, dr.cross(n, s), n)


class Directions:
    """Signed axes by face number; for faces without an axis any direction."""

    def __init__(self, signed: Sequence[SignedAxis | None]) -> None:
        present = [x for x in signed if x is not None]
        axes = [(x or present[0]).axis for x in signed] if present else []
        # One table for each component: many share a 0 that is known when kernels are traced.
        self._components = [component_rows(axes, k) for k in range(3)] if axes else []
        self._negative = Members([i for i, x in enumerate(signed) if x is not None and x.negative], len(signed))

    def at(self, number: UInt32) -> Vector3f:
        """The direction of a face; there must be flat faces."""
        axis = Vector3f(*(component.at(number) for component in self._components))
        direction: Vector3f = self._negative.negated(number, axis)
        return direction


def component_rows(axes: Sequence[Axis], k: int) -> Rows:
    """A table of component `k` of axes; equal ones that are known when kernels are traced are one row."""
    values = [axis.vector[k] for axis in axes]
    known = [value.state == dr.VarState.Literal for value in values]
    return Rows(values, [(x[0],) if fixed else id(axis) for axis, x, fixed in zip(axes, values, known, strict=True)])


def _host_point(p: Point3f) -> np.ndarray:
    # Component by component: converting a whole vector runs a kernel, too slow for many lights.
    return np.array([x[0] for x in p], dtype=np.float64)

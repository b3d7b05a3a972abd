"""Shapes that move: a geometry whose parts are seen from their own spaces, at the time of each ray.

One part holds all that is still, and every motion has one: a ray is searched in the first and, transformed, in the
others, each bounded by the nearest hit so far. A transformed direction keeps its length in the space of the part, so
that distances are the same in all of them. The faces of the parts have consecutive numbers.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.frame import Frame3f
from djpt.core.lookup import Numbers
from djpt.core.records import PreliminaryIntersection3f, Ray3f
from djpt.core.records.flags import SurfaceDetail
from djpt.core.transforms.keyframes import Placement
from djpt.description.animation import AnimatedTransform4f
from djpt.dispatch.ensemble import Lookup
from djpt.geometry.aggregate import NO_INSTANCE, Contents, Geometry
from djpt.geometry.deforming import DeformingGeometry
from djpt.geometry.query import Near
from djpt.jit.kernels import as_vector
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32
from djpt.shapes.base import Shape, Surface
from djpt.shapes.instance import Instance
from djpt.shapes.mesh import Mesh

__all__ = ["MovingGeometry"]


class Part:
    """Shapes that move together, or all that are still, with the numbers of their faces in the whole."""

    def __init__(self, shapes: Sequence[Shape], motion: AnimatedTransform4f | None) -> None:
        """`shapes` of one `motion`, or one that deforms; instances are replaced by what they show."""
        self.motion = motion
        self.members = list(shapes)
        shown: list[Shape] = []
        self.instance_of_shape: list[Shape | None] = []
        for shape in shapes:
            inner = [shown_copy(s) for s in shape.group.shapes] if motion and isinstance(shape, Instance) else [shape]
            shown += inner
            self.instance_of_shape += [shape if inner != [shape] else None] * len(inner)
        self.shapes: list[Shape]
        """The shapes as the part's geometry numbers them."""
        if any(shape.deforms for shape in shapes):
            self.geometry: Geometry = DeformingGeometry(*shapes)  # type: ignore[arg-type]
            self.shapes = shown
        else:
            # A wall with everything on one side of it may still hide what moves on the other side.
            self.geometry = Geometry(shown, [], open_sky=True)
            self.shapes = self.geometry.contents.shapes
        self.first_face = UInt32(0)

    def placement(self, ray: Ray3f) -> Placement | None:
        """Where the part is at the time of a ray; None if it is still."""
        return None if self.motion is None else self.motion.placement(ray.time)

    def carried(self, ray: Ray3f, placement: Placement | None) -> Ray3f:
        """A ray in the space of the part."""
        if placement is None:
            return ray
        return ray.replaced(o=placement.own_point(ray.o), d=placement.own_vector(ray.d))

    def bounding_box(self) -> tuple[np.ndarray, np.ndarray]:
        """The corners of a box in the world that holds the part at all times."""
        low, high = self.geometry.bounding_box()
        return (low, high) if self.motion is None or (low > high).any() else self.motion.keyframes.box(low, high)

    def seen_from(self, points: Sequence[np.ndarray]) -> Part:
        """A view for rays that start near the `points`, in the world."""
        if self.motion is not None:
            inverses = [self.motion.keyframes.at(float(t)).inverse() for t in self.motion.keyframes.moments()]
            points = [inverse.transform_point(p) for inverse in inverses for p in points]
        geometry = self.geometry.seen_from(points)
        if geometry is self.geometry:
            return self
        view = copy.copy(self)
        view.geometry = geometry
        return view


def shown_copy(shape: Shape) -> Shape:
    """A shape of a group as a part shows it: an analytic one belongs to the unrolled set of one geometry."""
    if shape.of_triangles:
        return shape
    copied = copy.copy(shape)
    copied._axes = None
    return copied


class MovingContents:
    """The shapes of a scene in which some move: its own in their order, then what groups and instances show."""

    def __init__(self, own: Sequence[Shape], parts: Sequence[Part]) -> None:
        self.shapes: list[Shape] = list(own)
        place = {id(shape): i for i, shape in enumerate(own)}
        self.index: list[list[int]] = []
        """By part: the index here of each of its shapes."""
        self._instance: dict[int, int] = {}
        for part in parts:
            numbers = []
            for k, shape in enumerate(part.shapes):
                instance = part.instance_of_shape[k] if k < len(part.instance_of_shape) else None
                if instance is None and id(shape) in place:
                    numbers.append(place[id(shape)])
                    continue
                numbers.append(len(self.shapes))
                if instance is not None:
                    self._instance[len(self.shapes)] = place[id(instance)]
                self.shapes.append(shape)
            self.index.append(numbers)

    def instances(self) -> Numbers | None:
        """The index of the instance that moves a shape, by the index of the shape; None if there are none."""
        if not self._instance:
            return None
        return Numbers([self._instance.get(i, NO_INSTANCE) for i in range(len(self.shapes))])


class MovingGeometry(Geometry):
    """The shapes of a scene in which some move, compiled for ray queries. The first part holds what is still."""

    moves = True

    def __init__(self, shapes: Sequence[Shape]) -> None:
        rigid = [shape for shape in shapes if not shape.deforms]
        motions: dict[int, AnimatedTransform4f] = {id(s.motion): s.motion for s in rigid if s.motion is not None}
        self.parts = [Part([s for s in rigid if s.motion is None], None)]
        self.parts += [Part([s for s in rigid if s.motion is m], m) for m in motions.values()]
        self.parts += [Part([shape], shape.motion) for shape in shapes if shape.deforms]
        contents: Any = MovingContents(shapes, self.parts)
        self.contents: Contents = contents
        self._index: list[list[int]] = contents.index
        self._instances: Numbers | None = contents.instances()
        # What only geometries without motion have.
        self.triangles = None
        self.analytic_shapes = []
        self._number()
        self._measure()

    # ---- the parts -----------------------------------------------------------------------

    @property
    def every_ensemble(self) -> list[Any]:
        return [part.geometry.surfaces for part in self.parts]

    @property
    def has_trees(self) -> bool:
        return any(part.geometry.has_trees for part in self.parts)

    @property
    def stepwise(self) -> bool:
        """False: the steps of several trees aren't taken together."""
        return False

    def _number(self) -> None:
        first = 0
        for part in self.parts:
            part.first_face = dr.opaque(UInt32, first)
            first += part.geometry.face_limit
        self._own_shapes = [Numbers(numbers or [0]) for numbers in self._index]

    def _measure(self) -> None:
        low, high = self.bounding_box()
        bounded = all(part.geometry.unrolled.is_bounded for part in self.parts)
        if not bounded:
            low, high = np.full(3, -np.inf), np.full(3, np.inf)
        else:
            self.parts = [part.seen_from([low, high]) for part in self.parts]
        self._low, self._high = as_vector(low), as_vector(high)

    def follow_bsdfs(self) -> None:
        for part in self.parts:
            part.geometry.follow_bsdfs()

    def approach(self, ray: Ray3f) -> tuple[Ray3f, Float]:
        """The ray itself: each part moves origins near on its own."""
        return ray, Float(0)

    def seen_from(self, points: Sequence[np.ndarray]) -> Geometry:
        if not len(points):
            return self
        parts = [part.seen_from(points) for part in self.parts]
        if all(a is b for a, b in zip(parts, self.parts, strict=True)):
            return self
        view = copy.copy(self)
        view.parts = parts
        return view

    def move(self, shapes: Sequence[Shape]) -> None:
        for part in self.parts:
            inner = [shape for shape in shapes if shape in part.shapes]
            if inner:
                part.geometry.move(inner)
        self._number()
        self._measure()

    def move_points(self, points: Sequence[Point3f]) -> None:
        """Do nothing: no wall is left out."""

    def bounding_box(self) -> tuple[np.ndarray, np.ndarray]:
        boxes = [part.bounding_box() for part in self.parts]
        return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)

    # ---- ray queries ---------------------------------------------------------------------

    @property
    def searches_pairs(self) -> bool:
        return False

    def closest(self, ray: Ray3f, through_lights: Bool | None = None) -> PreliminaryIntersection3f:
        still = self.parts[0].geometry.closest(ray, through_lights)
        t, face, shape, near = still.t, still.face, self._own_shapes[0].at(still.shape_index), still.near
        for number, part in enumerate(self.parts[1:], 1):
            own = part.carried(ray, part.placement(ray)).replaced(maxt=dr.select(dr.isfinite(t), t, ray.maxt))
            hit = part.geometry.closest(own, through_lights)
            nearer = hit.is_valid()
            t = dr.select(nearer, hit.t, t)
            face = dr.select(nearer, hit.face + part.first_face, face)
            shape = dr.select(nearer, self._own_shapes[number].at(hit.shape_index), shape)
        return PreliminaryIntersection3f.found(t, face, shape, near=near)

    def any_hit(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        hit = Bool(False)
        for part in self.parts:
            hit |= part.geometry.any_hit(part.carried(ray, part.placement(ray)), ~hit & active)
        return hit

    def blocked(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        hit = Bool(False)
        for part in self.parts:
            hit |= part.geometry.blocked(part.carried(ray, part.placement(ray)), ~hit & active)
        return hit

    # ---- faces -----------------------------------------------------------------------------

    def of_part(self, number: int, face: UInt32) -> tuple[Bool, UInt32]:
        """Where faces belong to a part, and their numbers there; 0 elsewhere."""
        first = self.parts[number].first_face
        mine = face >= first
        if number + 1 < len(self.parts):
            mine &= face < self.parts[number + 1].first_face
        return mine, dr.select(mine, face - first, 0)

    def choose(self, face: UInt32, of_part: Any) -> Any:
        """The results ``of_part(number, part, local, mine)`` by the part that a face belongs to."""
        result = None
        for number, part in enumerate(self.parts):
            mine, local = self.of_part(number, face)
            found = of_part(number, part, local, mine)
            result = found if result is None else dr.select(mine, found, result)
        return result

    def per_face(self, of_shape: Sequence[int]) -> Any:
        return MovingFaceNumbers(self, of_shape, self._index)

    def shape_of(self, face: UInt32) -> UInt32:
        found: UInt32 = self.choose(
            face, lambda number, part, local, _: self._own_shapes[number].at(part.geometry.shape_of(local))
        )
        return found

    def instance_of(self, hit: PreliminaryIntersection3f) -> UInt32 | None:
        still = self.parts[0].geometry
        mine, local = self.of_part(0, hit.face)
        index = None
        if still.contents.instances is not None:
            inside = PreliminaryIntersection3f.found(hit.t, local, UInt32(0), near=hit.near)
            inside.shape_index = still.shape_of(local)
            index = still.instance_of(inside)
        if index is None and self._instances is None:
            return None
        of_still = (
            UInt32(NO_INSTANCE)
            if index is None
            else Numbers(self._index[0] or [0]).at(dr.select(index == NO_INSTANCE, 0, index))
        )
        if index is not None:
            of_still = dr.select(index == NO_INSTANCE, NO_INSTANCE, of_still)
        of_moving = UInt32(NO_INSTANCE) if self._instances is None else self._instances.at(hit.shape_index)
        return dr.select(hit.is_valid(), dr.select(mine, of_still, of_moving), NO_INSTANCE)

    def surface(self, ray: Ray3f, hit: PreliminaryIntersection3f, lookup: Lookup, detail: SurfaceDetail) -> Surface:
        def of_part(number: int, part: Part, local: UInt32, mine: Bool) -> Surface:
            placement = part.placement(ray)
            near = hit.near if number == 0 else None
            inner = PreliminaryIntersection3f.found(hit.t, local, UInt32(0), near=near)
            own = part.geometry.surface(part.carried(ray, placement), inner, lookup, detail)
            return own if placement is None else placed(own, placement)

        result: Surface = self.choose(hit.face, of_part)
        return result

    def near_again(self, ray: Ray3f, t: Float, found: Near | None) -> Near | None:
        return self.parts[0].geometry.near_again(ray, t, found)

    def primitive_index(self, face: UInt32, uv: Point2f, p: Point3f, lookup: Lookup) -> UInt32:
        index: UInt32 = self.choose(
            face, lambda number, part, local, _: part.geometry.primitive_index(local, uv, p, lookup)
        )
        return index

    def attribute(self, name: str, face: UInt32, uv: Point2f, active: Bool | bool) -> Any:
        result = None
        for number, part in enumerate(self.parts):
            if not any(name in shape.attributes for shape in part.shapes if isinstance(shape, Mesh)):
                continue
            mine, local = self.of_part(number, face)
            mine &= part.geometry.on_mesh(local)
            found = part.geometry.attribute(name, local, uv, mine & active)
            result = found if result is None else dr.select(mine, found, result)
        return result


class MovingFaceNumbers:
    """Whole numbers by face, of all parts."""

    def __init__(self, geometry: MovingGeometry, of_shape: Sequence[int], index: Sequence[Sequence[int]]) -> None:
        self._geometry = geometry
        self._tables = [
            part.geometry.per_face([of_shape[i] for i in numbers])
            for part, numbers in zip(geometry.parts, index, strict=True)
        ]

    def at(self, face: UInt32) -> UInt32:
        """The number at `face`."""
        number: UInt32 = self._geometry.choose(face, lambda k, part, local, _: self._tables[k].at(local))
        return number


def placed(surface: Surface, placement: Placement) -> Surface:
    """A surface point of a part in the world."""
    frame = surface.sh_frame
    n = placement.normal(frame.n)
    # The tangent stays along dp/du, and a mirroring map keeps the frame right-handed.
    s = placement.vector(frame.s)
    s = dr.fma(n, -dr.dot(n, s), s)
    s = s * dr.rsqrt(dr.squared_norm(s))
    return Surface(
        placement.point(surface.p),
        placement.normal(surface.n),
        Frame3f(s, dr.cross(n, s), n),
        surface.uv,
        placement.vector(surface.dp_du),
        placement.vector(surface.dp_dv),
        surface.prim_uv,
    )

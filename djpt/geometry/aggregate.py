"""All surfaces of a scene behind one set of queries.

Shapes with a formula of their own are unrolled into straight-line code, triangles stand in a BVH; a
ray is tested against both. Every face has one number in the scene: first the faces of the unrolled set,
then the records of the BVH. `Contents` says which shape stands where.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.frame import Frame3f
from djpt.core.lookup import Numbers, is_one_of
from djpt.core.records import RAY_EPSILON, PreliminaryIntersection3f, Ray3f
from djpt.core.records.flags import SurfaceDetail
from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.geometry.query import ANALYTIC, FACE, NONE, Cursor, Found, Hit, Near, Query, recentre
from djpt.geometry.unrolled import Unrolled
from djpt.jit.kernels import as_vector
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import AxisPool
from djpt.shapes.base import Shape, Surface
from djpt.shapes.instance import Instance
from djpt.shapes.shapegroup import ShapeGroup

if TYPE_CHECKING:
    from djpt.geometry.triangles import Triangles
    from djpt.shapes.mesh import Mesh

__all__ = ["NO_INSTANCE", "Contents", "FaceNumbers", "Geometry", "MeasuredMedia", "NullSurfaces", "unseen"]


ROW = 32
"""Bytes of the smallest row of a tree that has a number."""


def shortened(ray: Ray3f, t: Float) -> Ray3f:
    """A ray that ends at a hit, if there is one."""
    return Ray3f(ray.o, ray.d, maxt=dr.select(dr.isfinite(t), t, ray.maxt))


class Geometry:
    """The shapes of a scene, compiled for ray queries."""

    moves: ClassVar[bool] = False
    """Whether some of the shapes move, so that queries look at the time of a ray."""
    overlaps: ClassVar[bool] = False
    """Whether bodies may overlap, so that queries look at the medium of a ray: see `djpt.geometry.overlapping`."""

    def __init__(self, shapes: Sequence[Shape], points: Sequence[Point3f], open_sky: bool) -> None:
        """`points` are the positions of point lights; `open_sky` is true if there is light from infinity."""
        self.contents = Contents(shapes)
        self.analytic_shapes = self.contents.analytic
        every = self.contents.shapes
        lights = [s for s in shapes if s.emitter() is not None]
        analytic = [every[i] for i in self.analytic_shapes]
        self.unrolled = Unrolled(analytic, self.contents.bounding, lights, points, open_sky)
        self.surfaces: Ensemble[Shape] = Ensemble(analytic)
        self.triangles = self.contents.triangles()
        self._curved = [group for group in self.surfaces.groups if not group.plugins[0].faces()]
        self._emits = [s.emitter() is not None for s in analytic]
        self._number()
        self._measure()

    @property
    def every_ensemble(self) -> Sequence[Ensemble[Any]]:
        """The analytic shapes whose values kernels look up."""
        return (self.surfaces,)

    @property
    def has_trees(self) -> bool:
        """Whether rays are searched in a tree."""
        return self.triangles is not None

    @property
    def face_limit(self) -> int:
        """A number that all faces are below."""
        return self.unrolled.face_count + (0 if self.triangles is None else self.triangles.tree.bytes // ROW + 1)

    def follow_bsdfs(self) -> None:
        """Follow an edit of the meshes' BSDFs and media."""
        if self.triangles is not None:
            self.triangles.follow_bsdfs()

    def _measure(self) -> None:
        """Measure how far the shapes reach."""
        low, high = self.bounding_box()
        self.triangles = self.seen_from([low, high]).triangles
        # An infinite plane may be hit before a ray comes near the box about everything else.
        if not self.unrolled.is_bounded:
            low, high = np.full(3, -np.inf), np.full(3, np.inf)
        self._low, self._high = as_vector(low), as_vector(high)

    def approach(self, ray: Ray3f) -> tuple[Ray3f, Float]:
        """Move a ray's origin near the shapes, and return the ray and the distance moved: see `recentre`.

        Where all shapes stand in the tree, its search moves the origin.
        """
        if not self.analytic_shapes:
            return ray, Float(0)
        return recentre(ray, self._low, self._high)

    def seen_from(self, points: Sequence[np.ndarray]) -> Geometry:
        """A view of this geometry for rays that start near the `points` (3,), or this one if it will do."""
        if self.triangles is None or not len(points):
            return self
        triangles = self.triangles.seen_from(points)
        return self if triangles is self.triangles else self.with_triangles(triangles)

    def with_triangles(self, triangles: Any) -> Geometry:
        """A view of this geometry that asks another view of its triangles."""
        view = copy.copy(self)
        view.triangles = triangles
        return view

    def _number(self) -> None:
        """Build the tables by face number; they follow the unrolled set's numbering, which an edit may change."""
        self.first_record = self.unrolled.face_count
        self._shape_of = Numbers([self.analytic_shapes[s] for s in self.unrolled.face_shape])

    def move(self, shapes: Sequence[Shape]) -> None:
        """Follow an edit of the parameters of `shapes`."""
        renewed = self.contents.renewed(shapes)
        for shape in renewed:
            self.unrolled.move(shape)
        if self.triangles is not None:
            meshes = self.contents.moved_meshes(shapes)
            if self.contents.moved_instances(shapes) or self.contents.moved_solids(renewed) or meshes:
                self.triangles.move(meshes)
        self._number()
        self._measure()

    def move_points(self, points: Sequence[Point3f]) -> None:
        """Follow an edit of the positions of point lights."""
        self.unrolled.move_points(points)

    def bounding_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest corner of all shapes; (+inf, -inf) if there are none."""
        return self.unrolled.bounding_box()

    def bounding_sphere(self) -> tuple[np.ndarray, float]:
        """The sphere about the box about all shapes, a little enlarged: centre (3,) and radius."""
        low, high = self.bounding_box()
        if (low > high).any():
            low = high = np.zeros(3)
        center = 0.5 * (low + high)
        # Mitsuba's rule.
        return center, max(RAY_EPSILON, float(np.linalg.norm(high - center)) * (1 + RAY_EPSILON))

    # ---- ray queries -----------------------------------------------------------------

    def closest(self, ray: Ray3f, through_lights: Bool | None = None) -> PreliminaryIntersection3f:
        """The first hit with 0 < t < maxt. Where `through_lights`, shapes that emit are ignored."""
        if self.triangles is not None:
            return self.intersection(self.first_hit(ray, through_lights))
        t, face = self.unrolled.closest(ray, self._emits, through_lights)
        return PreliminaryIntersection3f.found(t, face, self.shape_of(face))

    def first_hit(self, ray: Ray3f, through_lights: Bool | None = None) -> Hit:
        """The hit that `closest` finds, in scenes with triangles."""
        assert self.triangles is not None
        t, face = self.unrolled.closest(ray, self._emits, through_lights)
        return self._nearer(t, face, self.triangles.search(shortened(ray, t), through_lights))

    def _nearer(self, t: Float, face: UInt32, found: Found) -> Hit:
        """The hit of an unrolled shape, or one in the tree that is nearer."""
        hit = found.record != NONE
        t, face = dr.select(hit, found.t, t), dr.select(hit, found.record + self.first_record, face)
        # The origin that the search has moved, even where a scene needs no move: nothing is computed twice.
        return Hit(t, face, Near(found.origin, found.near_t, found.entry, found.b, found.inside))

    def intersection(self, hit: Hit) -> PreliminaryIntersection3f:
        """A hit as queries give it."""
        return PreliminaryIntersection3f.found(hit.t, hit.face, self.shape_of(hit.face), near=hit.near)

    @property
    def searches_pairs(self) -> bool:
        """Whether there is `closest_and_blocked`."""
        return self.triangles is not None and self.triangles.searches_pairs

    def closest_and_blocked(
        self, ray: Ray3f, to_light: Ray3f, followed: Bool, through_lights: Bool | None = None
    ) -> tuple[Hit, Bool]:
        """`closest` for `ray`, and `blocked` for the segment `to_light` where it is `followed`, by one search."""
        assert self.triangles is not None
        t, face = self.unrolled.closest(ray, self._emits, through_lights)
        hidden = self.unrolled.blocked(to_light)
        found, blocked = self.triangles.search_pairs(shortened(ray, t), to_light, ~hidden & followed, through_lights)
        return self._nearer(t, face, found), hidden | blocked

    def any_hit(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        """Whether anything is hit with 0 < t < maxt."""
        hit = self.unrolled.any_hit(ray, active)
        return hit if self.triangles is None else hit | self.triangles.occluded(ray, ~hit & active)

    @property
    def stepwise(self) -> bool:
        """Whether the search of the tree is a sequence of steps; false also if there is no tree."""
        return self.triangles is not None and self.triangles.tree.stepwise

    def blocked(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        """Like `any_hit`, for a segment between a surface point and a light that shines on it.

        Where not `active` the answer is unspecified.
        """
        hit = self.unrolled.blocked(ray)
        return hit if self.triangles is None else hit | self.triangles.occluded(ray, ~hit & active)

    # ---- ray queries step by step: for the machine schedule ----------------------------

    def begin(
        self, ray: Ray3f, active: Bool | bool = True, shadow: Bool | None = None, through_lights: Bool | None = None
    ) -> Query:
        """Start a query where `active`: the unrolled shapes are tested at once, the BVH by `turn`.

        Where `shadow`, any hit ends it. There must be meshes.
        """
        assert self.triangles is not None
        t, face = self.unrolled.closest(ray, self._emits, through_lights)
        found = dr.isfinite(t)
        origin, entry = self.triangles.enter(ray)
        maxt = dr.select(found, t, ray.maxt)
        maxt = maxt if entry is None else maxt - entry
        if shadow is not None:
            active = active & ~(shadow & found)
        hit = dr.select(found, face | ANALYTIC, UInt32(NONE))
        # Points on instances need their corners anyway.
        tree = self.triangles.tree
        weights = not tree.stepwise or (self.triangles.meshes.smooth and not tree.instanced)
        cursor = tree.start(origin, ray.d, maxt, active, hit, weights)
        return Query(origin, ray.d, entry, cursor)

    def turn(self, query: Query, shadow: Bool, through_lights: Bool | None) -> Cursor:
        """The cursor after some steps; the masks mean what they mean for `begin`."""
        assert self.triangles is not None
        through = through_lights if self.triangles.emit else None
        return self.triangles.tree.turn(query.cursor, query.o, query.d, shadow, through)

    def end(self, query: Query) -> tuple[Ray3f, PreliminaryIntersection3f]:
        """The ray of a query whose cursor has come to the end, and its result.

        The ray's origin is moved back by `entry`, which its `t` counts from. Its `maxt` is the hit, or its end.
        """
        assert self.triangles is not None
        number = query.cursor.hit
        t, origin = query.cursor.t, query.o + self.triangles.tree.center
        if query.entry is not None:
            t, origin = t + query.entry, dr.fma(query.d, -query.entry, origin)
        ray = Ray3f(origin, query.d, maxt=t)  # of a ray without a hit that is where it ends
        t = dr.select(number != NONE, t, dr.inf)
        near = Near(query.o, query.cursor.t, query.entry, query.cursor.b, query.cursor.inside)
        face = dr.select(number >= ANALYTIC, number & FACE, number + self.first_record)
        face = dr.select(number != NONE, face, 0)
        hit = PreliminaryIntersection3f.found(t, face, self.shape_of(face), near=near)
        return ray, hit

    # ---- faces -------------------------------------------------------------------------

    def per_face(self, of_shape: Sequence[int]) -> FaceNumbers:
        """Turn a table of numbers by shape into one by face."""
        return FaceNumbers(self, of_shape)

    def shape_of(self, face: UInt32) -> UInt32:
        """The index of the shape that a face belongs to."""
        if self.triangles is None:
            return self._shape_of.at(face)
        on_mesh = self.triangles.shape_of(self.record_of(face))
        return dr.select(self.on_mesh(face), on_mesh, self._shape_of.at(face)) if self.analytic_shapes else on_mesh

    def instance_of(self, hit: PreliminaryIntersection3f) -> UInt32 | None:
        """The index of the instance that a hit of a search belongs to, or NO_INSTANCE; None in scenes without any."""
        tables = self.contents.instances
        if tables is None:
            return None
        of_copy, of_placement = tables
        index = of_copy.at(hit.shape_index)
        if self.triangles is not None and hit.near is not None and hit.near.inside is not None:
            index = dr.select(hit.near.inside == NONE, index, of_placement.at(self.triangles.owner_of(hit.near.inside)))
        return dr.select(hit.is_valid(), index, NO_INSTANCE)

    def on_mesh(self, face: UInt32) -> Bool:
        """True for triangles."""
        return face >= self.first_record

    def record_of(self, face: UInt32) -> UInt32:
        """The BVH's record of a triangle; the empty record for all other faces."""
        return dr.select(self.on_mesh(face), face - self.first_record, NONE) if self.first_record else face

    # ---- surface points ------------------------------------------------------------------

    def surface(self, ray: Ray3f, hit: PreliminaryIntersection3f, lookup: Lookup, detail: SurfaceDetail) -> Surface:
        """The surface point of a hit; beyond `detail` its parts are unspecified."""
        if self.triangles is None:
            return self._analytic_surface(ray, hit.t, hit.face, lookup, detail)
        near = hit.near or self._near(ray, hit.t)
        mesh = self.triangles.surface(near, ray.d, near.t, self.record_of(hit.face), detail)
        if not self.analytic_shapes:
            return mesh
        analytic = self._analytic_surface(ray, hit.t, hit.face, lookup, detail)
        return dr.select(self.on_mesh(hit.face), mesh, analytic)

    def near_again(self, ray: Ray3f, t: Float, found: Near | None) -> Near | None:
        """A hit as the search would give it for another ray that hits the same triangle at `t`."""
        if self.triangles is None:
            return None
        near = self._near(ray, t)
        if found is not None:
            near.inside = found.inside
        return near

    def _near(self, ray: Ray3f, t: Float) -> Near:
        """A hit that no search of this geometry found, in the form that the search for triangles gives."""
        assert self.triangles is not None
        origin, entry = self.triangles.enter(ray)
        return Near(origin, t if entry is None else t - entry, entry, None, None)

    def _analytic_surface(self, ray: Ray3f, t: Float, face: UInt32, lookup: Lookup, detail: SurfaceDetail) -> Surface:
        p = ray(t)
        n, frame = self._frame(face, p, ray.d, lookup)
        uv, dp_du, dp_dv = Point2f(0), Vector3f(0), Vector3f(0)
        if detail and self.analytic_shapes:
            local = self.unrolled.local_face(face)
            uv, dp_du, dp_dv = self.surfaces.call(
                self.unrolled.shape_of(face), lookup, lambda shape: shape.uv_and_partials(p, local), None
            )
        return Surface(p, n, frame, uv, dp_du, dp_dv, Point2f(0))

    def _frame(self, face: UInt32, p: Point3f, d: Vector3f, lookup: Lookup) -> tuple[Vector3f, Frame3f]:
        """Geometric normal and shading frame: looked up by number for flat faces, computed by curved shapes."""
        flat = any(group not in self._curved for group in self.surfaces.groups)
        result: Any = self.unrolled.frame(face) if flat else None
        for group in self._curved:
            shape = group.at(self.surfaces.slots(group, self.unrolled.shape_of(face)), lookup)
            shines = any(plugin.emitter() is not None for plugin in group.plugins)
            curved = shape.frame_at(p, d) if shines else shape.frame_at(p)
            # Curved faces have the lowest numbers, so this is one range test.
            here = is_one_of(face, self.unrolled.faces_of(group.indices))
            result = curved if result is None else dr.select(here, curved, result)
        up = Vector3f(0, 0, 1)
        return result or (up, Frame3f.from_normal(up))

    def primitive_index(self, face: UInt32, uv: Point2f, p: Point3f, lookup: Lookup) -> UInt32:
        """The number that Mitsuba gives to the primitive: to triangles of meshes, boxes and rectangles."""
        index = UInt32(0)
        if self.analytic_shapes:
            local = self.unrolled.local_face(face)
            own = self.unrolled.shape_of(face)
            index = self.surfaces.call(own, lookup, lambda shape: shape.triangle(local, uv), None)
        if self.triangles is None:
            return index
        return dr.select(self.on_mesh(face), self.triangles.primitive_index(self.record_of(face), p), index)

    def attribute(self, name: str, face: UInt32, uv: Point2f, active: Bool | bool) -> Any:
        """An attribute of the meshes at the barycentric coordinates `uv` of triangles; unspecified on other shapes."""
        assert self.triangles is not None
        return self.triangles.attribute(name, self.record_of(face), uv, active)


class FaceNumbers:
    """Whole numbers by face: looked up directly for analytic faces, through the mesh for triangles."""

    def __init__(self, geometry: Geometry, of_shape: Sequence[int]) -> None:
        self._geometry = geometry
        self._analytic = geometry.unrolled.per_face([of_shape[i] for i in geometry.analytic_shapes])
        self._mesh = geometry.triangles.per_mesh(of_shape) if geometry.triangles is not None else None

    def at(self, face: UInt32) -> UInt32:
        """The number at `face`."""
        geometry = self._geometry
        if self._mesh is None or geometry.triangles is None:
            return self._analytic.at(face)
        on_mesh = self._mesh.at(geometry.triangles.owner_of(geometry.record_of(face)))
        if not geometry.analytic_shapes:
            return on_mesh
        return dr.select(geometry.on_mesh(face), on_mesh, self._analytic.at(face))


# ---- which shape stands where ------------------------------------------------------------------------------------


MAX_UNROLLED = 24
"""Most analytic shapes that are unrolled; if there are more they stand in the BVH (docs/performance.md)."""

LARGE, MAX_LARGE = 0.5, 6
"""In a scene of many shapes, up to `MAX_LARGE` larger than `LARGE` times the largest are unrolled."""


NO_INSTANCE = 0xFFFFFFFF
"""A number that no instance has."""


class Contents:
    """The shapes of a scene and of its groups.

    `shapes` are those of the scene, then the meshes of groups, then a copy of each analytic shape of a
    group for every instance: such a shape needs no tree, and moving it is exact.
    """

    def __init__(self, shapes: Sequence[Shape]) -> None:
        self._own = tuple(shapes)
        self._instances = [s for s in shapes if isinstance(s, Instance)]
        # Groups without meshes need no tree, nor do those without instances.
        self._groups: list[ShapeGroup] = []
        for instance in self._instances:
            if instance.group not in self._groups and any(s.of_triangles for s in instance.group.shapes):
                self._groups.append(instance.group)
        inner = [mesh for group in self._groups for mesh in group.shapes if mesh.of_triangles]
        copies = [(i, s) for i in self._instances for s in i.group.shapes if not s.of_triangles]
        for _, original in copies:
            # Rays hit the copies; of the originals only the extent counts.
            original.place(AxisPool())
        self._copied = [(instance, original, placed(instance, original)) for instance, original in copies]
        self.shapes: list[Shape] = [*shapes, *inner, *(copied for _, _, copied in self._copied)]
        analytic = [i for i, s in enumerate(self.shapes) if not unseen(s) and not s.of_triangles]
        self._solids = self._for_tree(analytic) + [i for i in analytic if self.shapes[i].in_pieces]
        self.analytic = [i for i in analytic if i not in set(self._solids)]
        """Indices of the shapes to be unrolled."""
        self._meshes = [i for i, s in enumerate(self.shapes) if s.of_triangles]
        self._placed = [i for i in self._instances if i.group in self._groups]
        solids = [self.shapes[i] for i in self._solids]
        self.bounding = [*(s for s in shapes if s.of_triangles or isinstance(s, Instance)), *solids]
        """The shapes beside the unrolled ones that make up the scene's extent."""

    def triangles(self) -> Triangles | None:
        """All meshes, and the instances of those in groups; None if there are none."""
        meshes: list[Any] = [s for s in self.shapes if s.of_triangles]
        solids = [self.shapes[i] for i in self._solids]
        if not meshes and not solids:
            return None
        # Scenes without meshes need no trees, and don't import what builds and searches them.
        from djpt.geometry.triangles import Triangles
        from djpt.geometry.two_level_bvh import Placement, TwoLevelBVH
        from djpt.shapes.meshes.mesh_set import MeshSet

        mesh_set = MeshSet(meshes)
        world = sum(s.of_triangles for s in self._own)
        parts = [world, *(sum(s.of_triangles for s in group.shapes) for group in self._groups)]
        placements = [Placement(self._groups.index(i.group) + 1, i.to_world.matrix) for i in self._placed]
        self._two_level_bvh = TwoLevelBVH(mesh_set, parts, solids, placements)
        return Triangles(mesh_set, [*self._meshes, *self._solids], self._two_level_bvh)

    @cached_property
    def instances(self) -> tuple[Numbers, Numbers] | None:
        """Two tables of indices of instances (NO_INSTANCE: none); None in scenes without instances.

        The first is by shape, for the copies of analytic shapes, the second by the number of a placement in the trees.
        """
        if not self._instances:
            return None
        place = {id(shape): i for i, shape in enumerate(self._own)}
        of_copy = {id(copied): place[id(instance)] for instance, _, copied in self._copied}
        by_shape = Numbers([of_copy.get(id(shape), NO_INSTANCE) for shape in self.shapes])
        return by_shape, Numbers([place[id(instance)] for instance in self._placed])

    def _for_tree(self, analytic: Sequence[int]) -> list[int]:
        """The analytic shapes that stand in the BVH, by index: none of a few, most of many.

        Large ones stay unrolled: most rays come near them, and they often share axes.
        """
        analytic = [i for i in analytic if not self.shapes[i].in_pieces]
        if len(analytic) <= MAX_UNROLLED:
            return []
        sizes = {i: size(self.shapes[i]) for i in analytic}
        largest = max(sizes.values())
        large = sorted((i for i in analytic if sizes[i] > LARGE * largest), key=lambda i: -sizes[i])[:MAX_LARGE]
        return [i for i in analytic if i not in large and self.shapes[i].canonical is not None]

    # ---- edits -----------------------------------------------------------------------

    def moved_meshes(self, changed: Sequence[Shape]) -> list[Mesh]:
        """The meshes among the changed shapes."""
        meshes: list[Any] = [s for s in changed if s.of_triangles]
        return meshes

    def moved_instances(self, changed: Sequence[Shape]) -> bool:
        """Tell the trees where the changed instances are; true if one of them has changed."""
        moved = [s for s in changed if isinstance(s, Instance) and s in self._placed]
        for instance in moved:
            self._two_level_bvh.place(self._placed.index(instance), instance.to_world.matrix)
        return bool(moved)

    def moved_solids(self, changed: Sequence[Shape]) -> bool:
        """Whether an analytic shape in the BVH has moved."""
        solids = [self.shapes[i] for i in self._solids]
        return any(shape in solids for shape in changed)

    def renewed(self, changed: Sequence[Shape]) -> list[Shape]:
        """The shapes that the unrolled set must place again: changed ones, and copies of what has changed."""
        result = list(changed)
        for instance, original, copied in self._copied:
            if instance in changed or original in changed:
                original.place(AxisPool())
                # The copy keeps its axes, which belong to the unrolled set.
                copied.__dict__.update(placed(instance, original).__dict__ | {"_axes": copied._axes})
                result.append(copied)
        return result


def size(shape: Shape) -> float:
    """The diagonal of a shape's bounding box."""
    # Measured on a copy: the first `place` of a shape decides which axes it shares.
    copied = copy.copy(shape)
    copied.place(AxisPool())
    low, high = copied.world_box()
    return float(np.linalg.norm(high - low))


def unseen(shape: Shape) -> bool:
    """Whether rays never hit the shape itself: true for groups and instances."""
    return isinstance(shape, (ShapeGroup, Instance))


def placed(instance: Instance, original: Shape) -> Shape:
    """A copy of an analytic shape where an instance puts it."""
    copied = copy.copy(original)
    copied.to_world = copied.check_parameter("to_world", instance.to_world @ original.to_world)
    return copied


# ---- surfaces that light may pass straight through ---------------------------------------------------------------


class NullSurfaces:
    """The passable shapes of a scene, if all of them are unrolled.

    Whether something opaque stands in the way of a shadow ray is then one query without an order, as in scenes without
    passable shapes, and the way through the few that are passable needs none of the other shapes.
    """

    def __init__(self, geometry: Geometry, null: Sequence[bool]) -> None:
        """`null` says of each shape in `geometry.contents.shapes` whether light may pass straight through."""
        self._geometry = geometry
        self._null = [null[i] for i in geometry.analytic_shapes]
        self._opaque = [not passes for passes in self._null]
        self.are_apart = sum(self._null) == sum(null) and not geometry.overlaps
        """Whether all passable shapes are unrolled: only then the queries mean something."""

    def blocked(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        """Whether an opaque shape is hit with 0 < t < maxt."""
        hit = self._geometry.unrolled.any_hit(ray, active, self._opaque)
        triangles = self._geometry.triangles
        return hit if triangles is None else hit | triangles.occluded(ray, ~hit & active)

    def closest(self, ray: Ray3f) -> PreliminaryIntersection3f:
        """The first hit of a passable shape with 0 < t < maxt."""
        t, face = self._geometry.unrolled.closest(ray, among=self._null)
        return PreliminaryIntersection3f.found(t, face, self._geometry.shape_of(face))


class MeasuredMedia:
    """The media of a scene, if one search tells how far a shadow ray runs through each of them.

    That takes a tree whose search can do it, and passable shapes that are invisible meshes, all of them.
    """

    def __init__(self, geometry: Geometry, null: Sequence[bool], media: Sequence[Any]) -> None:
        """`null` is that of `NullSurfaces`; `media` are those that rays may run through."""
        self._geometry = geometry
        self.are_measured = False
        """Whether `passed` means something."""
        triangles = geometry.triangles
        if triangles is None or not triangles.can_measure or triangles.null_meshes.count != sum(null):
            return
        if geometry.overlaps:
            return
        from djpt.geometry.bvh.calls.layout import MEDIA

        numbered = triangles.null_meshes.media
        others = [medium for medium in media if not any(medium is other for other in numbered)]
        every = [*numbered, *others]
        self.are_measured = len(every) == len(media) <= MEDIA and not any(medium.is_tracked for medium in every)
        if self.are_measured:
            place = {id(medium): number for number, medium in enumerate(every)}
            self._order = [place[id(medium)] for medium in media]
            # The vacuum has no matter, and the number after the last.
            self._numbers = Numbers([*(1 + number for number in self._order), 0])

    def passed(self, ray: Ray3f, active: Bool) -> tuple[Bool, list[Float]]:
        """Whether something opaque is hit with 0 < t < maxt, and if not, the length through each of the media.

        Args:
            ray: A ray with a unit direction, and the number of a medium in which it begins.
            active: Lanes that have a ray.
        """
        assert self._geometry.triangles is not None
        hit = self._geometry.unrolled.any_hit(ray, active)
        medium = UInt32(0) if ray.medium is None else self._numbers.at(ray.medium)
        blocked, lengths = self._geometry.triangles.lengths(ray, active & ~hit, medium)
        return hit | blocked, [lengths[number] for number in self._order]

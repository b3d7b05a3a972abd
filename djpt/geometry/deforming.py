"""Ray queries against a mesh that deforms: a tree whose boxes move with the vertices.

The vertices move along straight lines from one set to the next, so a box that is interpolated between the boxes about
two sets holds the triangles at every time between them (P. Christensen et al., "RenderMan: An Advanced Path-Tracing
Architecture for Movie Rendering", ACM Trans. Graph. 37(3), 2018, section on motion blur). The tree is threaded: each
node has a link to the next one where its box is hit, and another one where it is missed, so no stack is needed. There
is a set of links for each octant of directions, by which the nearer of two children comes first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f
from djpt.core.records import PreliminaryIntersection3f, Ray3f
from djpt.core.records.flags import SurfaceDetail
from djpt.dispatch.ensemble import Lookup
from djpt.geometry.aggregate import Geometry
from djpt.geometry.bvh.build.binary import BinaryTree, build
from djpt.geometry.bvh.steps.traversal import reciprocal
from djpt.geometry.query import Near
from djpt.geometry.triangle import RayPlane, intersect_triangle
from djpt.jit.kernels import float_in, if_stmt, maximum, minimum, own_copy, while_loop, wide
from djpt.jit.types import ArrayXu, Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.base import Surface
from djpt.shapes.deforming import Deforming
from djpt.shapes.meshes.mesh_set import MeshSet

__all__ = ["DeformingGeometry"]

NO_FACE = 0xFFFFFFFF
ROW = 8
"""Words of a node's row: low and high corner of its box, its face or `NO_FACE`, unused."""


@dataclass
class Walk:
    """A ray on its way through the tree: loop state."""

    node: UInt32
    t: Float
    face: UInt32


@dataclass
class Moment:
    """Where a ray's time is among the sets of vertices."""

    first: UInt32
    """The number of the set before."""
    share: Float
    """The share of the way to the next one."""


class DeformingGeometry(Geometry):
    """The triangles of one mesh that deforms. Faces are numbered as in the mesh."""

    def __init__(self, mesh: Deforming) -> None:
        self.mesh = mesh
        super().__init__([], [], open_sky=True)
        self._tabulate()

    def _tabulate(self) -> None:
        """Build the tables that kernels read."""
        mesh = self.mesh
        self.set = MeshSet([mesh])
        corners = mesh.sets[:, mesh.indices]
        low, high = corners.min(axis=2), corners.max(axis=2)
        tree = build(low.min(axis=0), high.max(axis=0))
        self._node_count = dr.opaque(UInt32, len(tree.left))
        boxes = moving_boxes(tree, low, high)
        self._nodes, self._links = own_copy(node_rows(tree, boxes)), own_copy(links(tree, boxes))
        self._sets, vertices = len(mesh.times), len(mesh.positions)
        self._vertex_count = dr.opaque(UInt32, vertices)
        self._positions = own_copy(four_wide(mesh.sets))
        self._normals = None if mesh.normal_sets is None else own_copy(four_wide(mesh.normal_sets))
        self._starts = [dr.opaque(Float, float(t)) for t in mesh.times]
        self._inverse = [dr.opaque(Float, float(1 / d)) for d in np.diff(mesh.times)]

    # ---- as a geometry -----------------------------------------------------------------

    @property
    def has_trees(self) -> bool:
        return True

    @property
    def face_limit(self) -> int:
        return len(self.mesh.indices)

    def follow_bsdfs(self) -> None:
        """Do nothing: the tree knows of no materials."""

    def seen_from(self, points: Sequence[np.ndarray]) -> Geometry:
        return self

    def move(self, shapes: Sequence[Any]) -> None:
        self._tabulate()

    def bounding_box(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.mesh.sets.min(axis=(0, 1)), self.mesh.sets.max(axis=(0, 1))
        return low.astype(np.float64), high.astype(np.float64)

    def shape_of(self, face: UInt32) -> UInt32:
        return UInt32(0)

    def per_face(self, of_shape: Sequence[int]) -> Any:
        return OneNumber(of_shape[0])

    def on_mesh(self, face: UInt32) -> Bool:
        return Bool(True)

    def primitive_index(self, face: UInt32, uv: Point2f, p: Point3f, lookup: Lookup) -> UInt32:
        return face

    def near_again(self, ray: Ray3f, t: Float, found: Near | None) -> Near | None:
        return None

    # ---- ray queries -------------------------------------------------------------------

    @property
    def searches_pairs(self) -> bool:
        return False

    def closest(self, ray: Ray3f, through_lights: Bool | None = None) -> PreliminaryIntersection3f:
        found = self._search(ray, False, True)
        hit = found.face != NO_FACE
        face = dr.select(hit, found.face, 0)
        return PreliminaryIntersection3f.found(dr.select(hit, found.t, dr.inf), face, UInt32(0))

    def any_hit(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        return self._search(ray, True, active).face != NO_FACE

    def blocked(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        return self.any_hit(ray, active)

    def _moment(self, time: Float) -> Moment:
        """Find a time among those of the sets."""
        first, start, inverse = UInt32(0), self._starts[0], self._inverse[0]
        for k in range(1, self._sets - 1):
            later = time >= self._starts[k]
            first = dr.select(later, UInt32(k), first)
            start, inverse = dr.select(later, self._starts[k], start), dr.select(later, self._inverse[k], inverse)
        return Moment(first, dr.clip((time - start) * inverse, 0, 1))

    def _search(self, ray: Ray3f, any_hit: bool, active: Bool | bool) -> Walk:
        """Walk through the tree."""
        moment, plane, inv = self._moment(ray.time), RayPlane(ray.o, ray.d), reciprocal(ray.d)
        lanes = dr.width(ray, active)
        signs = (dr.select(ray.d[axis] < 0, UInt32(1 << axis), 0) for axis in range(3))
        octant = sum(signs, start=UInt32(0)) * self._node_count

        def visit(walk: Walk) -> tuple[Walk]:
            row = moment.first * self._node_count + walk.node
            words = [dr.gather(ArrayXu, self._nodes, r, shape=(ROW, 1)) for r in (row, row + self._node_count)]
            a, b = ([float_in(w) for w in list(part)[:6]] for part in words)
            box = [dr.fma(y - x, moment.share, x) for x, y in zip(a, b, strict=True)]
            entry, leave = Float(0), walk.t
            for axis in range(3):
                near, far = ((box[axis + side] - ray.o[axis]) * inv[axis] for side in (0, 3))
                entry, leave = maximum(entry, minimum(near, far)), minimum(leave, maximum(near, far))
            face = words[0][6]
            onwards: Any = dr.gather(ArrayXu, self._links, octant + walk.node, shape=(2, 1))
            met = entry <= leave * (1 + 4e-7)
            leaf = met & (face != NO_FACE)

            def test(t: Float, found: UInt32) -> tuple[Float, UInt32]:
                p0, p1, p2 = self._corners(face, moment, leaf)
                hit = intersect_triangle(plane, p0, p1, p2)
                closer = leaf & hit.hit & (hit.t > 0) & (hit.t < t)
                return dr.select(closer, hit.t, t), dr.select(closer, face, found)

            t, found = if_stmt((walk.t, walk.face), leaf, test, lambda t, found: (t, found), label="deforming leaf")
            onward = dr.select(met, onwards[0], onwards[1])
            if any_hit:
                onward = dr.select(found != NO_FACE, self._node_count, onward)
            return (Walk(onward, t, found),)

        start = wide(Walk(UInt32(0), ray.maxt, UInt32(NO_FACE)), lanes)
        start.node = dr.select(active, start.node, self._node_count)
        (end,) = while_loop((start,), lambda walk: walk.node < self._node_count, visit, label="deforming mesh")
        result: Walk = end
        return result

    def _between(self, table: UInt32, vertex: UInt32, moment: Moment, active: Bool | bool) -> Vector3f:
        """A row of a table of vertices at a time."""
        row = moment.first * self._vertex_count + vertex
        rows: list[Any] = [dr.gather(ArrayXu, table, r, active, shape=(4, 1)) for r in (row, row + self._vertex_count)]
        a, b = (Vector3f(*(float_in(word) for word in list(part)[:3])) for part in rows)
        return dr.fma(b - a, moment.share, a)

    def _corners(self, face: UInt32, moment: Moment, active: Bool | bool = True) -> tuple[Point3f, Point3f, Point3f]:
        row = self.set.face_row(face, active)
        p0, p1, p2 = (self._between(self._positions, row[k], moment, active) for k in range(3))
        return p0, p1, p2

    # ---- surface points ----------------------------------------------------------------

    def surface(self, ray: Ray3f, hit: PreliminaryIntersection3f, lookup: Lookup, detail: SurfaceDetail) -> Surface:
        moment = self._moment(ray.time)
        corners = self._corners(hit.face, moment)
        found = intersect_triangle(RayPlane(ray.o, ray.d), *corners)
        surface = self.set.surface(hit.face, corners, found.b1, found.b2)
        if self._normals is None:
            return surface
        row = self.set.face_row(hit.face)
        n0, n1, n2 = (self._between(self._normals, row[k], moment, True) for k in range(3))
        n = dr.fma(n2, found.b2, dr.fma(n1, found.b1, n0 * (1 - found.b1 - found.b2)))
        n = -n if self.mesh.flip_normals else n
        squared = dr.squared_norm(n)
        n = dr.select(squared > 0, n * dr.rsqrt(squared), surface.n)
        frame = self.set.shading_frame(n, surface.dp_du)
        surface.sh_frame = Frame3f(frame.s, frame.t, frame.n)
        return surface

    def attribute(self, name: str, face: UInt32, uv: Point2f, active: Bool | bool) -> Any:
        return self.set.attribute(name, face, uv.x, uv.y)


class OneNumber:
    """A number that all faces share."""

    def __init__(self, number: int) -> None:
        self._number = number

    def at(self, face: UInt32) -> UInt32:
        """The number."""
        return UInt32(self._number)


def four_wide(sets: NDArray[np.float32]) -> NDArray[np.float32]:
    """Vertices (sets, V, 3) in rows of four words."""
    rows = np.zeros((*sets.shape[:2], 4), np.float32)
    rows[..., :3] = sets
    return rows


def moving_boxes(tree: BinaryTree, low: NDArray[np.float32], high: NDArray[np.float32]) -> NDArray[np.float32]:
    """The boxes of all nodes about each set, (sets, nodes, 6), from those about triangles, (sets, F, 3)."""
    inner = tree.left >= 0
    boxes = np.zeros((len(low), len(inner), 6), np.float32)
    faces = tree.primitive[~inner]
    boxes[:, ~inner, :3], boxes[:, ~inner, 3:] = low[:, faces], high[:, faces]
    for nodes in reversed(inner_levels(tree)):
        a, b = tree.left[nodes], tree.left[nodes] + 1
        boxes[:, nodes, :3] = np.minimum(boxes[:, a, :3], boxes[:, b, :3])
        boxes[:, nodes, 3:] = np.maximum(boxes[:, a, 3:], boxes[:, b, 3:])
    # Rounding must not make the interpolated boxes smaller than what they hold.
    slack = np.float32(4e-6) * np.abs(boxes).max(initial=1e-30)
    boxes[..., :3] -= slack
    boxes[..., 3:] += slack
    return boxes


def inner_levels(tree: BinaryTree) -> list[NDArray[np.int64]]:
    """The inner nodes of a tree, level by level from the root."""
    levels: list[NDArray[np.int64]] = []
    nodes = np.zeros(1, np.int64)
    while len(nodes := nodes[tree.left[nodes] >= 0]):
        levels.append(nodes)
        nodes = np.concatenate([tree.left[nodes], tree.left[nodes] + 1]).astype(np.int64)
    return levels


def node_rows(tree: BinaryTree, boxes: NDArray[np.float32]) -> NDArray[np.uint32]:
    """The rows of all nodes, of one set after the other: (sets, nodes, 8) words."""
    rows = np.zeros((*boxes.shape[:2], ROW), np.uint32)
    rows[..., :6] = boxes.view(np.uint32)
    rows[..., 6] = np.where(tree.left >= 0, NO_FACE, tree.primitive.astype(np.int64)).astype(np.uint32)
    return rows


def links(tree: BinaryTree, boxes: NDArray[np.float32]) -> NDArray[np.uint32]:
    """The links of all nodes by octant, (8, nodes, 2): the next node where the box is hit, and where it is missed.

    The last link is the number of nodes. Bit k of an octant is set where the direction is negative along axis k.
    """
    count = len(tree.left)
    result = np.full((8, count, 2), count, np.uint32)
    middles = (boxes[..., :3] + boxes[..., 3:]).mean(axis=0)
    for nodes in inner_levels(tree):
        left = tree.left[nodes]
        apart = middles[left + 1] - middles[left]
        axis = np.abs(apart).argmax(axis=1)
        right_is_further = apart[np.arange(len(nodes)), axis] > 0
        for octant in range(8):
            forwards = (octant >> axis) & 1 == 0
            first = np.where(right_is_further == forwards, left, left + 1)
            second = 2 * left + 1 - first
            behind = result[octant, nodes, 1]
            result[octant, nodes, 0], result[octant, first, 1] = first, second
            result[octant, second, 1] = behind
    leaves = tree.left < 0
    result[:, leaves, 0] = result[:, leaves, 1]
    return result

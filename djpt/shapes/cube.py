"""The cube [-1, 1]^3; any affine image of it, intersected as three slabs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.lookup import choose
from djpt.core.numeric import cross_product
from djpt.core.records import PositionSample3f
from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import HIDDEN, ParamFlags, TraversalCallback
from djpt.description.registry import register_shape
from djpt.errors import ParameterError
from djpt.jit.kernels import as_float, as_vector, maximum, minimum
from djpt.jit.types import Float, Matrix4f, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import AxisPool, ProjectedRay, SignedAxis
from djpt.shapes.base import Face, Hit, Shape
from djpt.shapes.meshes.queries import MeshQueries
from djpt.shapes.mitsuba_api import ShapeType

if TYPE_CHECKING:
    from djpt.shapes.meshes.data import MeshData
    from djpt.shapes.silhouettes.base import Silhouette

__all__ = ["FACES", "Cube", "face_axis"]

# Local axes of each face as (axis, sign): normal, dp/du, dp/dv. The order and the senses are
# those of Mitsuba's cube mesh, so that face numbers, uv and tangents agree.
FACES = (
    ((1, -1), (2, 1), (0, 1)),
    ((1, 1), (0, -1), (2, -1)),
    ((0, 1), (1, 1), (2, -1)),
    ((2, 1), (1, 1), (0, 1)),
    ((0, -1), (1, 1), (2, 1)),
    ((2, -1), (1, -1), (0, 1)),
)
CORNERS_UV = ((0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0))


def face_axis(axis_sign: tuple[int, int]) -> NDArray[np.float64]:
    """A signed local axis as a vector."""
    return axis_sign[1] * np.eye(3)[axis_sign[0]]


def local_vertices() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The 24 vertices and normals of the cube, four per face, from dp/du, dp/dv and uv."""
    positions, normals = [], []
    for normal, du, dv in FACES:
        for u, v in CORNERS_UV:
            positions.append(face_axis(normal) + (2 * u - 1) * face_axis(du) + (2 * v - 1) * face_axis(dv))
            normals.append(face_axis(normal))
    return np.array(positions), np.array(normals)


def attached_fit(positions: Float) -> Any:
    """The affine map of the unit cube, attached to the corners: the mean of these along each axis.

    Derivatives are those of the box that fits best as corners move.
    """
    from djpt.core.transforms.lanes import Transform4f
    from djpt.shapes.silhouettes.moving import AttachedTransform

    corners = dr.unravel(Point3f, positions)
    signs = (*local_vertices()[0].T, np.ones(24))
    columns = [[dr.sum(x * as_floats(sign)) / 24 for x in corners] for sign in signs]
    rows = [[column[k] for column in columns] for k in range(3)]
    return AttachedTransform(Transform4f(Matrix4f(*rows[0], *rows[1], *rows[2], 0, 0, 0, 1)))


def as_floats(values: NDArray[np.float64]) -> Float:
    """The numbers as a Dr.Jit array."""
    return Float(values.astype(np.float32))


class Cube(MeshQueries, Shape):
    """A parallelepiped; every face has its own uv in [0, 1]^2. Scripts may ask it what they ask meshes.

    Parameters: `to_world` (affine, default identity), `flip_normals` (default false).
    Normals point outwards unless `flip_normals` is set.
    """

    in_any_frame = True
    shape_kind = ShapeType.Mesh
    triangle_count = 12
    sides = 6
    closed = True
    canonical = "cube"
    values = dict.fromkeys(("center", "edge_x", "edge_y", "edge_z", "dual_x", "dual_y", "dual_z", "areas"), HIDDEN)
    statics = ("flip_normals", "mirrored")
    attributes: Mapping[str, Any] = MappingProxyType({})

    # ---- parameters: the names of Mitsuba's cube, which is a mesh ------------------

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        callback.put("faces", self.faces_parameter, attribute="faces_parameter")
        callback.put("vertex_positions", self.vertex_positions, self.motion_flags())
        callback.put("vertex_normals", self.vertex_normals, HIDDEN | ParamFlags.Discontinuous)
        callback.put("vertex_texcoords", self.vertex_texcoords)

    @property
    def faces_parameter(self) -> UInt32:
        """The vertex indices of the 12 triangles."""
        quads = np.arange(24).reshape(6, 4)
        return UInt32(np.concatenate([quads[:, [0, 1, 2]], quads[:, [3, 0, 2]]], 1).ravel().tolist())

    @property
    def vertex_positions(self) -> Float:
        """The 24 corners (x, y, z interleaved) in world space."""
        m = self.to_world.matrix
        return Float((local_vertices()[0] @ m[:3, :3].T + m[:3, 3]).astype(np.float32).ravel().tolist())

    @vertex_positions.setter
    def vertex_positions(self, value: Any) -> None:
        fitted = self._fit(np.array(dr.detach(value), dtype=np.float64))
        self.to_world = attached_fit(value) if dr.grad_enabled(value) else fitted

    def _fit(self, positions: NDArray[np.float64]) -> ScalarTransform4f:
        """The affine map that takes the unit cube's corners to `positions`."""
        if positions.size != 72 or not np.isfinite(positions).all():
            raise ParameterError(f"{self.id()}.vertex_positions: a cube has 24 finite vertices (72 numbers)")
        target = positions.reshape(24, 3)
        source = np.concatenate([local_vertices()[0], np.ones((24, 1))], 1)
        solution = np.linalg.lstsq(source, target, rcond=None)[0]
        matrix = np.eye(4)
        matrix[:3] = solution.T
        # Vertices are float32: edges that differ from before by their rounding only stay exact.
        before = self.to_world.matrix[:3, :3]
        if np.abs(matrix[:3, :3] - before).max() < 1e-6 * np.abs(before).max():
            matrix[:3, :3] = before
        extent = np.ptp(target, axis=0).max()
        if np.abs(source @ solution - target).max() > 1e-5 * extent or abs(np.linalg.det(matrix)) < 1e-12 * extent**3:
            raise ParameterError(
                f"{self.id()}.vertex_positions: the vertices no longer form a box (an affine image of the cube)"
            )
        return ScalarTransform4f(matrix)

    @property
    def vertex_normals(self) -> Float:
        """One normal per vertex, in world space."""
        inverse = np.linalg.inv(self.to_world.matrix[:3, :3])
        n = local_vertices()[1] @ inverse
        return Float((n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32).ravel().tolist())

    @property
    def vertex_texcoords(self) -> Float:
        """One uv per vertex."""
        return Float(np.tile(np.array(CORNERS_UV, dtype=np.float32).ravel(), 6).tolist())

    def data(self) -> MeshData:
        """The 12 triangles on the host, in world space."""
        from djpt.shapes.meshes.data import MeshData  # only scripts ask for them

        flat = (self.vertex_positions, self.faces_parameter, self.vertex_normals, self.vertex_texcoords)
        positions, faces, normals, texcoords = map(np.array, flat)
        return MeshData(
            positions.reshape(24, 3), faces.reshape(12, 3), normals.reshape(24, 3), texcoords.reshape(24, 2)
        )

    def attached_parameter(self, name: str, value: Any) -> Any:
        fits = name == "vertex_positions" and self.can_be_followed()
        return value if fits else super().attached_parameter(name, value)

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.cube import CubeSilhouette

        return CubeSilhouette

    def check_parameter(self, name: str, value: Any) -> Any:
        if name in ("faces", "vertex_normals", "vertex_texcoords"):
            raise ParameterError(f"{self.id()}.{name}: a cube's {name} follow from its vertex positions")
        return super().check_parameter(name, value)

    # ---- on the host ---------------------------------------------------------------

    def place(self, pool: AxisPool) -> None:
        matrix = self.to_world.matrix
        center, edges = matrix[:3, 3], matrix[:3, :3]
        duals = np.linalg.inv(edges)  # row k . (p - center) is the local coordinate k
        self.mirrored = bool(np.linalg.det(edges) < 0)
        self._axes = pool.find((*duals, *edges.T), self._axes)
        self._host = (center, edges)

        along = [signed.axis.direction for signed in self._axes[:3]]
        reaches = [1 / np.linalg.norm(d) for d in duals]
        self.slabs = [
            (as_float(center.dot(a) - reach), as_float(center.dot(a) + reach))
            for a, reach in zip(along, reaches, strict=True)
        ]

        self.center = as_vector(center)
        self.edge_x, self.edge_y, self.edge_z = (as_vector(e) for e in edges.T)
        self.dual_x, self.dual_y, self.dual_z = (as_vector(d) for d in duals)
        pairs = ((1, 2), (2, 0), (0, 1))
        self.areas = as_vector(
            np.array([4 * np.linalg.norm(cross_product(edges[:, i], edges[:, j])) for i, j in pairs])
        )

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        center, edges = self._host
        middle, reach = center.dot(direction), np.abs(direction @ edges).sum()
        return float(middle - reach), float(middle + reach)

    def faces(self) -> Sequence[Face]:
        result = []
        for (n, n_sign), (u, u_sign), _ in FACES:
            axis, tangent = self._axes[n], self._axes[3 + u]
            negative = axis.negative ^ (n_sign < 0) ^ self.flip_normals
            result.append(
                Face(
                    normal=SignedAxis(axis.axis, negative ^ self.mirrored),
                    shading=SignedAxis(axis.axis, negative),
                    tangent=SignedAxis(tangent.axis, tangent.negative ^ (u_sign < 0)),
                )
            )
        return result

    # ---- in kernels ----------------------------------------------------------------

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        enter, leave, forward = [], [], []
        for signed, (low, high) in zip(self._axes[:3], self.slabs, strict=True):
            o, _, inv_d = ray.onto(signed.axis)
            # For a ray across the axis both are infinite, of opposite signs if it runs between the planes.
            t_low, t_high = (low - o) * inv_d, (high - o) * inv_d
            rising = t_low < t_high
            enter.append(dr.select(rising, t_low, t_high))
            leave.append(dr.select(rising, t_high, t_low))
            # Whether the ray runs towards the + face of this local axis.
            forward.append((inv_d < 0) if signed.negative else (inv_d >= 0))
        near = maximum(maximum(enter[0], enter[1]), enter[2])
        far = minimum(minimum(leave[0], leave[1]), leave[2])
        inside = near <= 0
        t = dr.select(inside, far, near)
        hit = (near <= far) & (t > 0) & (t < maxt)

        # A ray enters through the - face of an axis that it runs along, and leaves through the + face.
        plus = {axis: i for i, ((axis, sign), _, _) in enumerate(FACES) if sign > 0}
        minus = {axis: i for i, ((axis, sign), _, _) in enumerate(FACES) if sign < 0}
        candidates = [
            dr.select(forward[a] ^ inside, UInt32(numbers[minus[a]]), UInt32(numbers[plus[a]])) for a in range(3)
        ]
        first = [t == dr.select(inside, leave[a], enter[a]) for a in range(2)]
        number = dr.select(first[0], candidates[0], dr.select(first[1], candidates[1], candidates[2]))
        return Hit(hit, t, number)

    def surface_area(self) -> Float:
        return 2 * (self.areas.x + self.areas.y + self.areas.z)

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        # As Mitsuba does for meshes: y picks the triangle by area (and is used again), then a
        # uniform point in it. Faces come in pairs of equal triangles in the order of FACES.
        total = self.surface_area()
        y = sample.y * total
        face, half, remainder = UInt32(0), UInt32(0), Float(0)
        start = Float(0)
        for i, ((axis, _), _, _) in enumerate(FACES):
            for k in range(2):
                triangle_area = 0.5 * self.areas[axis]
                here = y >= start if (i, k) != (0, 0) else y == y
                face = dr.select(here, UInt32(i), face)
                half = dr.select(here, UInt32(k), half)
                remainder = dr.select(here, (y - start) * dr.rcp(triangle_area), remainder)
                start = start + triangle_area
        t = dr.safe_sqrt(1 - sample.x)
        b1, b2 = 1 - t, t * remainder
        # Corner uv of the two triangles: (0,1) (1,1) (1,0) and (0,0) (0,1) (1,0).
        u = dr.select(half == 0, b1 + b2, b2)
        v = dr.select(half == 0, 1 - b2, b1)
        normal, du, dv = self._face_vectors(face)
        p = self.center + normal + dr.fma(2, u, -1) * du + dr.fma(2, v, -1) * dv
        return PositionSample3f.of(p, self._outward(face), Point2f(u, v), dr.rcp(total))

    def _face_vectors(self, face: UInt32) -> tuple[Vector3f, Vector3f, Vector3f]:
        """The vector from the centre to the face's centre, and half of dp/du and dp/dv."""
        edges = (self.edge_x, self.edge_y, self.edge_z)
        picked = []
        for column in range(3):
            rows = [spec[column][1] * edges[spec[column][0]] for spec in FACES]
            picked.append(choose(face, rows))
        return picked[0], picked[1], picked[2]

    def _outward(self, face: UInt32) -> Vector3f:
        duals = (self.dual_x, self.dual_y, self.dual_z)
        sign = -1 if self.flip_normals else 1
        return choose(face, [sign * s * dr.normalize(duals[a]) for (a, s), _, _ in FACES])

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        local = p - self.center
        coordinates = [dr.dot(d, local) for d in (self.dual_x, self.dual_y, self.dual_z)]
        u = choose(face, [dr.fma(0.5 * s, coordinates[a], 0.5) for _, (a, s), _ in FACES])
        v = choose(face, [dr.fma(0.5 * s, coordinates[a], 0.5) for _, _, (a, s) in FACES])
        _, du, dv = self._face_vectors(face)
        return Point2f(u, v), 2 * du, 2 * dv

    def triangle(self, face: UInt32, uv: Point2f) -> UInt32:
        # Two triangles per face, cut along the diagonal u + v = 1.
        return 2 * face + dr.select(uv.x + uv.y < 1, UInt32(1), UInt32(0))


register_shape("cube", Cube)

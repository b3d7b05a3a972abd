"""Queries of meshes: areas and extent, whether they are closed, vertices and triangles by number."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property
from typing import IO, TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import PreliminaryIntersection3f, Ray3f
from djpt.errors import ParameterError, near_miss
from djpt.jit.types import Bool, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f, backend

__all__ = ["Measures", "MeshQueries", "is_closed", "is_remote", "opposite_edges"]

SAME_PLACE = 2.0**-23
"""The distance of coordinates, relative to the largest one, that rounding may leave between equal ones."""

REMOTE = 16


def is_remote(positions: NDArray[np.float32]) -> bool:
    """Whether vertices (V, 3) lie further from the origin than REMOTE times their extent."""
    if not len(positions):
        return False
    low, high = positions.min(axis=0), positions.max(axis=0)
    return bool(np.abs(0.5 * (low + high)).max() > REMOTE * (high - low).max())


class Measures:
    """Measurements of a mesh's triangles, made on demand; the arrays must not change."""

    def __init__(
        self, positions: NDArray[np.float32], indices: NDArray[np.uint32], areas: NDArray[np.float64] | None = None
    ) -> None:
        """`areas` are those of the triangles if they are known."""
        self._positions, self._indices = positions, indices
        if areas is not None:
            self.face_areas = areas

    @cached_property
    def face_areas(self) -> NDArray[np.float64]:
        """The areas of all triangles, (F,)."""
        from djpt.shapes.meshes.normals import face_areas  # cubes answer as meshes and need none of it

        return face_areas(self._positions, self._indices)

    @cached_property
    def area(self) -> float:
        """The area of all triangles."""
        return float(self.face_areas.sum())

    @cached_property
    def _used(self) -> NDArray[np.float32]:
        """The positions of the vertices that triangles use, axis by axis: (3, V)."""
        used = np.zeros(len(self._positions), bool)
        used[self._indices.ravel()] = True
        return np.ascontiguousarray((self._positions if used.all() else self._positions[used]).T)

    @cached_property
    def _box(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        return self._used.min(axis=1), self._used.max(axis=1)

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        """The lowest and the highest coordinate along a direction (3,)."""
        (axes,) = np.nonzero(direction)
        if len(axes) == 1 and direction[axes[0]] == 1:
            low, high = self._box
            return float(low[axes[0]]), float(high[axes[0]])
        along = direction @ self._used
        return float(along.min()), float(along.max())


# ---- edges -------------------------------------------------------------------------------------------------------


def is_closed(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> bool:
    """Whether every edge belongs to an even number of triangles.

    Then any ray from a point far away crosses the mesh an even number of times on its way out, and parity
    tells inside from outside. Vertices at the same place count as one: seams of texture coordinates
    double them.
    """
    corners = vertex_places(positions)[indices].astype(np.uint64)
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    ends.sort(axis=1)
    _, uses = np.unique(ends[:, 0] << np.uint64(32) | ends[:, 1], return_counts=True)
    return bool((uses % 2 == 0).all())


def vertex_places(positions: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Numbers of the places of vertices, (V,): equal for vertices at the same place, up to rounding."""
    # Files have 6e-17 and 0 for the sines of whole turns. Adding zero turns -0 into 0: equal numbers have equal bits.
    size = np.abs(positions).max(initial=0)
    step = size * SAME_PLACE if 0 < size < np.inf else 1
    steps = np.round(positions / np.float32(step)) + np.float32(0)
    bits = np.ascontiguousarray(steps, np.float32).view(np.dtype((np.void, 12))).ravel()
    return np.unique(bits, return_inverse=True)[1].ravel().astype(np.uint32)


def opposite_edges(indices: NDArray[np.uint32], vertex_count: int) -> NDArray[np.uint32]:
    """The directed edge that runs against each directed edge, (3 F,); 2^32 - 1 where it isn't exactly one.

    Edge k of triangle f, number 3 f + k, runs from its corner k to the next one.
    """
    start = indices.astype(np.int64).ravel()
    end = np.roll(indices, -1, axis=1).astype(np.int64).ravel()
    forward, backward = start * vertex_count + end, end * vertex_count + start
    order = np.argsort(forward, kind="stable")
    ranked = forward[order]
    first, past = np.searchsorted(ranked, backward, "left"), np.searchsorted(ranked, backward, "right")
    own_first, own_past = np.searchsorted(ranked, forward, "left"), np.searchsorted(ranked, forward, "right")
    single = (past - first == 1) & (own_past - own_first == 1)
    result = np.full(len(start), 0xFFFFFFFF, np.uint32)
    result[single] = order[first[single]]
    return result


if TYPE_CHECKING:
    from drjit.llvm.ad import Array2u as Vector2u
    from drjit.llvm.ad import Array3u as Vector3u

    from djpt.shapes.meshes.data import MeshData
else:
    Vector2u, Vector3u = backend.Array2u, backend.Array3u


class MeshQueries:
    """Queries of meshes by scripts; the arrays are those that `traverse` reports, flat and in world space.

    Lookups take numbers of vertices or triangles, one per lane; inactive lanes get zeros.
    """

    attributes: Mapping[str, Any]

    if TYPE_CHECKING:
        # What the mesh computes when it is asked for.

        @property
        def faces_parameter(self) -> UInt32:
            """The corners of all triangles, one after the other."""

        @property
        def vertex_positions(self) -> Float:
            """The coordinates of all vertices, one after the other."""

        @property
        def vertex_normals(self) -> Float:
            """The vertex normals, one after the other; empty if there are none."""

        @property
        def vertex_texcoords(self) -> Float:
            """The texture coordinates of all vertices, one after the other; empty if there are none."""

        def data(self) -> MeshData:
            """The mesh on the host."""

    def write_ply(self, filename: str | os.PathLike[str] | IO[bytes] = "", stream: IO[bytes] | None = None) -> None:
        """Write the mesh as it is now, in world space, to a binary PLY file or stream, with all its attributes.

        Raises:
            FileError: the file can't be written.
        """
        from djpt.shapes.meshes.ply import write_ply  # only scripts write meshes

        write_ply(filename if stream is None else stream, self.data())

    # ---- counts --------------------------------------------------------------------------

    def vertex_count(self) -> int:
        """The number of vertices."""
        return dr.width(self.vertex_positions) // 3

    def face_count(self) -> int:
        """The number of triangles."""
        return dr.width(self.faces_parameter) // 3

    def has_vertex_normals(self) -> bool:
        """Whether vertices have normals, so that shading is smooth."""
        return dr.width(self.vertex_normals) > 0

    def has_vertex_texcoords(self) -> bool:
        """Whether vertices have texture coordinates."""
        return dr.width(self.vertex_texcoords) > 0

    def has_mesh_attributes(self) -> bool:
        """Whether there are further attributes of vertices or triangles."""
        return bool(self.attributes)

    def has_face_normals(self) -> bool:
        """Whether triangles are shaded flat although a file had normals (the key ``face_normals``)."""
        return self.flat

    flat: bool = False

    # ---- whole arrays --------------------------------------------------------------------

    def faces_buffer(self) -> UInt32:
        """The corners of all triangles, (3 F,)."""
        return self.faces_parameter

    def vertex_positions_buffer(self) -> Float:
        """The positions, (3 V,)."""
        return self.vertex_positions

    def vertex_normals_buffer(self) -> Float:
        """The normals, (3 V,); empty without them."""
        return self.vertex_normals

    def vertex_texcoords_buffer(self) -> Float:
        """The texture coordinates, (2 V,); empty without them."""
        return self.vertex_texcoords

    def attribute_buffer(self, name: str) -> Float:
        """The numbers of an attribute, flat.

        Raises:
            ParameterError: there is no such attribute.
        """
        if name not in self.attributes:
            raise ParameterError(f"the mesh has no attribute '{name}'{near_miss(name, self.attributes)}")
        values: Float = getattr(self, name)
        return values

    # ---- lookups -------------------------------------------------------------------------

    def face_indices(self, index: UInt32 | int, active: Bool | bool = True) -> Vector3u:
        """The vertices of triangles."""
        return dr.gather(Vector3u, self.faces_parameter, UInt32(index), active)

    def edge_indices(self, tri_index: UInt32 | int, edge_index: UInt32 | int, active: Bool | bool = True) -> Vector2u:
        """The two vertices of edge 0, 1 or 2 of triangles."""
        start, edge = 3 * UInt32(tri_index), UInt32(edge_index)
        following = dr.select(edge == 2, 0, edge + 1)
        return Vector2u(*(dr.gather(UInt32, self.faces_parameter, start + k, active) for k in (edge, following)))

    def vertex_position(self, index: UInt32 | int, active: Bool | bool = True) -> Point3f:
        """The positions of vertices in world space."""
        return dr.gather(Point3f, self.vertex_positions, UInt32(index), active)

    def vertex_normal(self, index: UInt32 | int, active: Bool | bool = True) -> Normal3f:
        """The unit normals of vertices; raises `ParameterError` if there are none."""
        if not self.has_vertex_normals():
            raise ParameterError("vertex_normal: the mesh has no vertex normals; face_normal gives those of triangles")
        return dr.gather(Normal3f, self.vertex_normals, UInt32(index), active)

    def vertex_texcoord(self, index: UInt32 | int, active: Bool | bool = True) -> Point2f:
        """The texture coordinates of vertices; raises `ParameterError` if there are none."""
        if not self.has_vertex_texcoords():
            raise ParameterError("vertex_texcoord: the mesh has no texture coordinates")
        return dr.gather(Point2f, self.vertex_texcoords, UInt32(index), active)

    def face_normal(self, index: UInt32 | int, active: Bool | bool = True) -> Vector3f:
        """The unit normals of triangles, on the side from which corners run counter-clockwise."""
        corners = self.face_indices(index, active)
        a, b, c = (self.vertex_position(corner, active) for corner in corners)
        return dr.normalize(dr.cross(b - a, c - a))

    def ray_intersect_triangle(
        self, index: UInt32 | int, ray: Ray3f, active: Bool | bool = True
    ) -> PreliminaryIntersection3f:
        """The hit of each ray with triangle number `index` alone, for 0 <= t < maxt; it belongs to no scene.

        Source: T. Moeller, B. Trumbore, "Fast, minimum storage ray-triangle intersection", Journal of Graphics Tools,
        1997.
        """
        corner, second, third = (self.vertex_position(i, active) for i in self.face_indices(index, active))
        edge_1, edge_2 = second - corner, third - corner
        across = dr.cross(ray.d, edge_2)
        determinant = dr.dot(edge_1, across)
        inverse = dr.rcp(determinant)
        from_corner = ray.o - corner
        turned = dr.cross(from_corner, edge_1)
        u, v = dr.dot(from_corner, across) * inverse, dr.dot(ray.d, turned) * inverse
        t = dr.dot(edge_2, turned) * inverse
        hit = (determinant != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t < ray.maxt) & active
        pi = PreliminaryIntersection3f()
        pi.t, pi.prim_uv = dr.select(hit, t, dr.inf), dr.select(hit, Point2f(u, v), 0)
        pi.prim_index = dr.select(hit, UInt32(index), 0)
        return pi

    # ---- neighbours ----------------------------------------------------------------------

    def build_directed_edges(self) -> None:
        """Find the neighbours of all triangles anew: `opposite_dedge` does it at its first call."""
        for name in ("_opposite_edges", "joints"):
            self.__dict__.pop(name, None)

    @cached_property
    def joints(self) -> tuple[UInt32, Bool, Bool]:
        """Of each directed edge the one that runs against it, whether shading jumps there, and whether it is a seam.

        As `opposite_dedge`, but vertices at the same place count as one. Where they have several numbers there is a
        seam. Shading jumps there, and everywhere if there are no interpolated normals.
        """
        positions: NDArray[np.float32] = np.array(dr.detach(self.vertex_positions), np.float32).reshape(-1, 3)
        corners: NDArray[np.uint32] = np.array(self.faces_parameter, np.uint32).reshape(-1, 3)
        places = vertex_places(positions)
        own = np.array(self._opposite_edges)
        joined = opposite_edges(places[corners], len(places)) if places.max(initial=0) + 1 < len(places) else own
        seams = joined != own
        return UInt32(joined), Bool(seams | (not self.has_vertex_normals())), Bool(seams)

    @cached_property
    def _opposite_edges(self) -> UInt32:
        corners: NDArray[np.uint32] = np.array(self.faces_parameter, np.uint32).reshape(-1, 3)
        return UInt32(opposite_edges(corners, self.vertex_count()))

    def opposite_dedge(self, index: UInt32 | int, active: Bool | bool = True) -> UInt32:
        """The directed edge of the neighbour that runs the other way; 4294967295 at borders.

        Edge k of triangle f is number 3 f + k.
        """
        return dr.gather(UInt32, self._opposite_edges, UInt32(index), active)

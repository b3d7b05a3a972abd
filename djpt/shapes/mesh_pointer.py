"""Per-lane meshes, for scripts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import PreliminaryIntersection3f, Ray3f
from djpt.description.plugin import Plugin
from djpt.dispatch.family import NONE, Pointer
from djpt.jit.types import Bool, Normal3f, Point2f, Point3f, UInt32, Vector3f, backend
from djpt.shapes.meshes.queries import MeshQueries
from djpt.shapes.pointer import ShapePtr

if TYPE_CHECKING:
    from drjit.llvm.ad import Array2u as Vector2u
    from drjit.llvm.ad import Array3u as Vector3u
else:
    Vector2u, Vector3u = backend.Array2u, backend.Array3u

__all__ = ["MeshPtr"]


class MeshPtr(ShapePtr):
    """The mesh of each lane, or none; other shapes count as none, also rectangles: they have no vertices.

    Lookups are those of `djpt.Mesh`, asked of one mesh after the other; numbers are 0 where there is none.
    """

    def __init__(self, plugins: Any = None, **fields: Any) -> None:
        super().__init__(plugins, **fields)
        if isinstance(plugins, Pointer) and not isinstance(plugins, MeshPtr):
            self.index = dr.select(plugins.holds(self.may_hold), plugins.index, NONE)

    @classmethod
    def may_hold(cls, plugin: Plugin | None) -> bool:
        return isinstance(plugin, MeshQueries)

    def present(self) -> Sequence[int]:
        return [i for i in super().present() if self.may_hold(self.plugins[i])]

    # ---- what it has -----------------------------------------------------------------------------

    def vertex_count(self) -> UInt32:
        """The number of vertices."""
        return self._ask(lambda mesh, mine: UInt32(mesh.vertex_count()), UInt32(0))

    def face_count(self) -> UInt32:
        """The number of triangles."""
        return self._ask(lambda mesh, mine: UInt32(mesh.face_count()), UInt32(0))

    def has_vertex_normals(self) -> Bool:
        """True where the mesh has normals at its vertices."""
        return self._ask(lambda mesh, mine: Bool(mesh.has_vertex_normals()), Bool(False))

    def has_vertex_texcoords(self) -> Bool:
        """True where the mesh has texture coordinates."""
        return self._ask(lambda mesh, mine: Bool(mesh.has_vertex_texcoords()), Bool(False))

    def has_mesh_attributes(self) -> Bool:
        """True where the mesh has further attributes."""
        return self._ask(lambda mesh, mine: Bool(mesh.has_mesh_attributes()), Bool(False))

    def has_face_normals(self) -> Bool:
        """True where the mesh has the key ``face_normals``."""
        return self._ask(lambda mesh, mine: Bool(mesh.has_face_normals()), Bool(False))

    # ---- lookups ---------------------------------------------------------------------------------

    def face_indices(self, index: UInt32 | int, active: Bool | bool = True) -> Vector3u:
        """The vertices of triangles."""
        return self._ask(lambda mesh, mine: mesh.face_indices(index, mine & active), Vector3u(0))

    def edge_indices(self, tri_index: UInt32 | int, edge_index: UInt32 | int, active: Bool | bool = True) -> Vector2u:
        """The two vertices of edge 0, 1 or 2 of triangles."""
        return self._ask(lambda mesh, mine: mesh.edge_indices(tri_index, edge_index, mine & active), Vector2u(0))

    def vertex_position(self, index: UInt32 | int, active: Bool | bool = True) -> Point3f:
        """The positions of vertices in world space."""
        return self._ask(lambda mesh, mine: mesh.vertex_position(index, mine & active), Point3f(0))

    def vertex_normal(self, index: UInt32 | int, active: Bool | bool = True) -> Normal3f:
        """The unit normals of vertices; raises `ParameterError` if one of the meshes has none."""
        return self._ask(lambda mesh, mine: mesh.vertex_normal(index, mine & active), Normal3f(0))

    def vertex_texcoord(self, index: UInt32 | int, active: Bool | bool = True) -> Point2f:
        """The texture coordinates of vertices; raises `ParameterError` if one of the meshes has none."""
        return self._ask(lambda mesh, mine: mesh.vertex_texcoord(index, mine & active), Point2f(0))

    def face_normal(self, index: UInt32 | int, active: Bool | bool = True) -> Vector3f:
        """The unit normals of triangles."""
        return self._ask(lambda mesh, mine: mesh.face_normal(index, mine & active), Vector3f(0))

    def opposite_dedge(self, index: UInt32 | int, active: Bool | bool = True) -> UInt32:
        """The directed edge of the neighbour that runs the other way: see `djpt.Mesh.opposite_dedge`."""
        return self._ask(lambda mesh, mine: mesh.opposite_dedge(index, mine & active), UInt32(0))

    def ray_intersect_triangle(
        self, index: UInt32 | int, ray: Ray3f, active: Bool | bool = True
    ) -> PreliminaryIntersection3f:
        """The hit of each ray with triangle number `index`: see `djpt.Mesh.ray_intersect_triangle`."""
        miss = dr.zeros(PreliminaryIntersection3f)
        miss.scene_ref = {}
        return self._ask(lambda mesh, mine: mesh.ray_intersect_triangle(index, ray, mine & active), miss)

    def _ask(self, method: Callable[[Any, Bool], Any], otherwise: Any) -> Any:  # type: ignore[override]
        return self.each(method, otherwise)

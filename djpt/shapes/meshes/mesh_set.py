"""All meshes of a scene together: one numbering of faces, and the tables that kernels read.

Numbers are set-wide: the faces of the first mesh come first, then those of the second; vertices
likewise. Rows of tables are padded to powers of two, so that a kernel reads each with one packet load,
and tables lie in memory of their own (see `own_copy`). What no mesh has isn't read: kernels for a set
without vertex normals have no code for them. Points on meshes are chosen uniformly by area, as lights need them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f, coordinate_system
from djpt.errors import SceneError, near_miss
from djpt.jit.kernels import float_in, if_stmt, own_copy
from djpt.jit.types import ArrayXu, Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.base import Surface

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["AreaTable", "Corners", "MeshSet"]

Corners = tuple[Point3f, Point3f, Point3f]

HAS_NORMALS, HAS_TEXCOORDS, FLIPS = 1, 2, 4
"""Flags of faces: the mesh has vertex normals, texture coordinates, `flip_normals`."""

CORNER_WORDS = 16
"""Words of a face's row in the table of corners: three normals, three pairs of texture coordinates, flags."""


@dataclass
class CornerRow:
    """The row of a face in the table of corners: its vertices' normals and texture coordinates."""

    normals: tuple[Vector3f, Vector3f, Vector3f]
    texcoords: tuple[Point2f, Point2f, Point2f]
    flags: UInt32


class MeshSet:
    """The meshes of a scene, as kernels read them.

    `first_face[i]` is the set-wide number of the first face of mesh i; `face_count` counts all.
    """

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        self.meshes = tuple(meshes)
        self._areas: AreaTable | None = None
        self._steps = (0, 0)
        self._topology: list[Topology] = []
        self._tabulate()

    def refresh(self) -> None:
        """Build the tables again after an edit of meshes; tables keep their sizes unless the topology has changed."""
        self._tabulate()

    # ---- on the host -----------------------------------------------------------------

    def _tabulate(self) -> None:
        counts = [len(mesh.indices) for mesh in self.meshes]
        self.first_face = [int(n) for n in np.cumsum([0, *counts])[:-1]]
        self.face_count = sum(counts)
        self._has_normals = Presence([mesh.normals is not None for mesh in self.meshes], HAS_NORMALS)
        self._has_texcoords = Presence([mesh.texcoords is not None for mesh in self.meshes], HAS_TEXCOORDS)
        self._flips = Presence([mesh.flip_normals for mesh in self.meshes], FLIPS)
        self._positions = self._table([mesh.positions for mesh in self.meshes], 4)
        self._corners = self._corner_table()
        topology = [Topology(mesh.indices, len(mesh.positions)) for mesh in self.meshes]
        if topology != self._topology or not topology:
            # A scene's BVH may hold analytic shapes alone: the table is then never read.
            self._faces = own_copy(self._face_rows() if topology else np.zeros((1, 4), np.uint32))
            self._topology = topology
        self._attributes = {name: Attribute(self.meshes, name) for mesh in self.meshes for name in mesh.attributes}
        self._areas = None
        if any(mesh.emitter() is not None for mesh in self.meshes):
            # Kernels will want it: recording them is no time to build a table.
            _ = self.areas
        for mesh, first in zip(self.meshes, self.first_face, strict=True):
            mesh.join(self, first)

    def _corner_table(self) -> UInt32 | None:
        """What is interpolated on faces, in one cache line for each; None if there is nothing but flags of all."""
        if not (self._has_normals.any or self._has_texcoords.any or self._flips.mixed):
            return None
        rows = np.zeros((self.face_count, CORNER_WORDS), np.float32)
        for i, (mesh, first) in enumerate(zip(self.meshes, self.first_face, strict=True)):
            part = rows[first : first + len(mesh.indices)]
            if mesh.normals is not None:
                part[:, :9] = mesh.normals[mesh.indices].reshape(-1, 9)
            if mesh.texcoords is not None:
                part[:, 9:15] = mesh.texcoords[mesh.indices].reshape(-1, 6)
            part[:, 15] = np.uint32(self._bits(i)).view(np.float32)
        return own_copy(rows)

    def _face_rows(self) -> NDArray[np.uint32]:
        """Per face its three set-wide vertices, and 0."""
        rows = np.zeros((self.face_count, 4), np.uint32)
        vertex = 0
        for mesh, first in zip(self.meshes, self.first_face, strict=True):
            part = rows[first : first + len(mesh.indices)]
            part[:, :3] = mesh.indices
            part[:, :3] += np.uint32(vertex)
            vertex += len(mesh.positions)
        return rows

    def _bits(self, mesh: int) -> int:
        """The flags of a mesh."""
        return self._has_normals.bit(mesh) | self._has_texcoords.bit(mesh) | self._flips.bit(mesh)

    def _table(self, parts: Sequence[NDArray[np.float32] | None], width: int) -> UInt32 | None:
        """Vertex data of all meshes in rows of `width`; zeros where a mesh has none. None if no mesh has any."""
        if all(part is None for part in parts):
            return None
        counts = [len(mesh.positions) for mesh in self.meshes]
        rows = np.zeros((sum(counts), width), np.float32)
        start = 0
        for part, count in zip(parts, counts, strict=True):
            if part is not None:
                rows[start : start + count, : part.shape[1]] = part
            start += count
        return own_copy(rows)

    @property
    def areas(self) -> AreaTable:
        """The areas of faces, for the choice of points; computed when asked for."""
        if self._areas is None:
            self._areas = AreaTable(self.meshes, self._steps)
            self._steps = self._areas.steps
        return self._areas

    # ---- in kernels ------------------------------------------------------------------

    def vertices(self, face: UInt32, active: Bool | bool = True) -> Corners:
        """The corners of a face."""
        row = self.face_row(face, active)
        assert self._positions is not None
        p0, p1, p2 = (load_vector(self._positions, row[k], active) for k in range(3))
        return p0, p1, p2

    def face_row(self, face: UInt32, active: Bool | bool = True) -> list[UInt32]:
        """The vertices of a face."""
        return load(self._faces, face, 4, active)

    def corner_row(self, face: UInt32) -> CornerRow | None:
        """What is interpolated on a face; None if no mesh has anything."""
        if self._corners is None:
            return None
        half = CORNER_WORDS // 2
        words = [*load(self._corners, 2 * face, half), *load(self._corners, 2 * face + 1, half)]
        x = [float_in(word) for word in words[:15]]
        n0, n1, n2 = (Vector3f(*x[k : k + 3]) for k in (0, 3, 6))
        uv0, uv1, uv2 = (Point2f(*x[k : k + 2]) for k in (9, 11, 13))
        return CornerRow((n0, n1, n2), (uv0, uv1, uv2), words[15])

    def normal_of(self, row: CornerRow | None, b: Sequence[Float], otherwise: Vector3f) -> Vector3f:
        """The interpolated unit normal at barycentric weights `b`; `otherwise`, a unit normal, where there is none."""
        if not self.smooth or row is None:
            return otherwise
        n0, n1, n2 = row.normals
        n = dr.fma(n2, b[2], dr.fma(n1, b[1], n0 * b[0]))
        # A vertex without a normal, or normals that cancel.
        squared = dr.squared_norm(n)
        return dr.select(squared > 0, n * dr.rsqrt(squared), otherwise)

    def uv(self, row: CornerRow | None, b: Point2f) -> Point2f:
        """The interpolated texture coordinates at the weights `b` of the second and third corner; `b` without any."""
        if not self._has_texcoords.any or row is None:
            return b
        uv0, uv1, uv2 = row.texcoords
        interpolated = dr.fma(uv2, b.y, dr.fma(uv1, b.x, uv0 * (1 - b.x - b.y)))
        return self._has_texcoords.choose(row, interpolated, b)

    def point(self, face: UInt32, b1: Float, b2: Float) -> tuple[Point3f, Vector3f, Point2f]:
        """Position, shading normal and uv of a point with weights `b1`, `b2`: what light sampling needs."""
        p0, p1, p2 = self.vertices(face)
        row = self.corner_row(face)
        b0 = 1 - b1 - b2
        edge1, edge2 = p1 - p0, p2 - p0
        n = self.normal_of(row, (b0, b1, b2), unit_or_up(dr.cross(edge1, edge2)))
        n = self._flips.choose(row, -n, n) if self._flips.any else n
        uv = Point2f(b1, b2)
        if self._has_texcoords.any and row is not None:
            uv0, uv1, uv2 = row.texcoords
            interpolated = dr.fma(uv0, b0, dr.fma(uv1, b1, uv2 * b2))
            uv = self._has_texcoords.choose(row, interpolated, uv)
        return dr.fma(edge1, b1, dr.fma(edge2, b2, p0)), n, uv

    def surface(self, face: UInt32, corners: Corners, b1: Float, b2: Float) -> Surface:
        """The surface point with weights `b1`, `b2` of the second and third corner.

        As in Mitsuba: without texture coordinates uv = (b1, b2), so that dp/du and dp/dv are edges; where
        texture coordinates don't determine them they are unit tangents. `flip_normals` turns both
        normals. `corners` must be those of `face`.
        """
        b0 = 1 - b1 - b2
        p0, p1, p2 = corners
        edge1, edge2 = p1 - p0, p2 - p0
        n = unit_or_up(dr.cross(edge1, edge2))
        row = self.corner_row(face)
        uv, dp_du, dp_dv = Point2f(b1, b2), edge1, edge2
        if self._has_texcoords.any and row is not None:
            uv0, uv1, uv2 = row.texcoords
            d1, d2 = uv1 - uv0, uv2 - uv0
            determinant = dr.fma(d1.x, d2.y, -d1.y * d2.x)
            solvable, inv = determinant != 0, dr.rcp(determinant)
            tangents = coordinate_system(n)
            mapped = (
                dr.fma(uv2, b2, dr.fma(uv1, b1, uv0 * b0)),
                dr.select(solvable, (d2.y * edge1 - d1.y * edge2) * inv, tangents[0]),
                dr.select(solvable, (d1.x * edge2 - d2.x * edge1) * inv, tangents[1]),
            )
            uv, dp_du, dp_dv = self._has_texcoords.choose(row, mapped, (uv, dp_du, dp_dv))
        shading = self.normal_of(row, (b0, b1, b2), n)
        if self._flips.any:
            n, shading = self._flips.choose(row, -n, n), self._flips.choose(row, -shading, shading)
        p = dr.fma(p0, b0, dr.fma(p1, b1, p2 * b2))
        return Surface(p, n, self.shading_frame(shading, dp_du), uv, dp_du, dp_dv, Point2f(b1, b2))

    @property
    def smooth(self) -> bool:
        """Whether any mesh has vertex normals."""
        return self._has_normals.any

    def smooth_frame(self, row: CornerRow | None, b: Point2f, n: Vector3f, dp_du: Vector3f) -> Frame3f:
        """The shading frame at a point of a face with the normal `n` and the tangent `dp_du`."""
        # `n` has been flipped, the vertex normals haven't.
        flipped = self._flips.choose(row, -n, n) if self._flips.any else n
        shading = self.normal_of(row, (1 - b.x - b.y, b.x, b.y), flipped)
        shading = self._flips.choose(row, -shading, shading) if self._flips.any else shading
        return self.shading_frame(shading, dp_du)

    def shading_frame(self, n: Vector3f, dp_du: Vector3f) -> Frame3f:
        """The shading frame whose `s` follows dp/du."""
        s = dr.fma(n, -dr.dot(n, dp_du), dp_du)
        squared = dr.squared_norm(s)
        # A shading normal along dp/du leaves nothing but rounding errors.
        usable = squared > 1e-10 * dr.squared_norm(dp_du)
        s = dr.select(usable, s * dr.rsqrt(squared), coordinate_system(n)[0])
        return Frame3f(s, dr.cross(n, s), n)

    def attribute(self, name: str, face: UInt32, b1: Float, b2: Float) -> Any:
        """A mesh attribute at a surface point: a `Float` if it has one channel, a `Color3f` if three.

        Vertex attributes are interpolated; 0 on meshes that don't have it.

        Raises:
            SceneError: no mesh has it, or it has another number of channels.
        """
        if name not in self._attributes:
            raise SceneError(f"no mesh has the attribute '{name}'{near_miss(name, self._attributes)}")
        attribute = self._attributes[name]
        if attribute.by_face:
            return attribute.at(face)
        row = self.face_row(face)
        c0, c1, c2 = (attribute.at(row[k]) for k in range(3))
        return dr.fma(c2, b2, dr.fma(c1, b1, c0 * (1 - b1 - b2)))


@dataclass(eq=False)
class Topology:
    """The input that the rows of a mesh's faces were made from."""

    indices: NDArray[np.uint32]
    vertex_count: int

    def __eq__(self, other: object) -> bool:
        """Whether the rows would be the same; edits put new arrays in the place of old ones."""
        return isinstance(other, Topology) and (
            self.indices is other.indices and self.vertex_count == other.vertex_count
        )


class Presence:
    """Which meshes have a kind of data, such as vertex normals; `flag` is its bit among those of faces."""

    def __init__(self, present: Sequence[bool], flag: int) -> None:
        self._present, self._flag = present, flag
        self.any = any(present)
        self.mixed = self.any and not all(present)

    def bit(self, mesh: int) -> int:
        """The flag if the mesh has the data, else 0."""
        return self._flag if self._present[mesh] else 0

    def choose(self, row: CornerRow | None, present: Any, absent: Any) -> Any:
        """`present` on faces of meshes that have the data, else `absent`; at least one mesh must have it."""
        if not self.mixed or row is None:
            return present
        return dr.select((row.flags & self._flag) != 0, present, absent)


class Attribute:
    """One attribute of all meshes, as a table."""

    def __init__(self, meshes: Sequence[Mesh], name: str) -> None:
        self.name, self.by_face = name, name.startswith("face_")
        widths = {mesh.attributes[name][0].shape[1] for mesh in meshes if name in mesh.attributes}
        self.channels = sorted(widths)
        width = 1 if self.channels == [1] else 4
        blocks = []
        for mesh in meshes:
            count = len(mesh.indices if self.by_face else mesh.positions)
            block = np.zeros((count, width), np.float32)
            if name in mesh.attributes and len(self.channels) == 1:
                values = mesh.attributes[name][0][:, :width]
                block[:, : values.shape[1]] = values
            blocks.append(block)
        self._table = own_copy(np.concatenate(blocks))

    def at(self, row: UInt32) -> Any:
        """The value of a vertex or face."""
        if self.channels == [1]:
            return float_in(dr.gather(UInt32, self._table, row))
        if self.channels != [3]:
            found = " and ".join(str(n) for n in self.channels)
            raise SceneError(f"the mesh attribute '{self.name}' has {found} channels; 1 or 3 are possible")
        return load_vector(self._table, row)


def unit_or_up(v: Vector3f) -> Vector3f:
    """`v` made a unit vector; +z if it has no length (an edit may flatten a triangle)."""
    squared = dr.squared_norm(v)
    return dr.select(squared > 0, v * dr.rsqrt(squared), Vector3f(0, 0, 1))


def load(table: UInt32, row: UInt32, width: int, active: Bool | bool = True) -> list[UInt32]:
    """The words of a row, by one packet load."""
    words: Any = dr.gather(ArrayXu, table, row, active, shape=(width, 1))
    return list(words)


def load_vector(table: UInt32, row: UInt32, active: Bool | bool = True) -> Vector3f:
    """The first three of a row's four floats."""
    x, y, z, _ = load(table, row, 4, active)
    return Vector3f(float_in(x), float_in(y), float_in(z))


# ---- points on meshes --------------------------------------------------------------------------------------------


class AreaTable:
    """The running sums of the areas of faces, for one mesh after the other."""

    def __init__(self, meshes: Sequence[Mesh], least_steps: tuple[int, int] = (0, 0)) -> None:
        """Build the table; `least_steps` are the `steps` before an edit, lest fewer faces need a new kernel."""
        sums = [np.cumsum(mesh.face_areas()).astype(np.float32) for mesh in meshes]
        self._sums = Float(np.concatenate(sums)) if sums else Float(1)
        # Unevaluated arithmetic would make its inputs a part of kernels.
        dr.make_opaque(self._sums)
        counts = [len(part) for part in sums] or [1]
        lit = [count for mesh, count in zip(meshes, counts, strict=False) if mesh.emitter() is not None] or counts
        self.steps = max(least_steps[0], max(lit).bit_length()), max(least_steps[1], max(counts).bit_length())
        """The steps of a search among the faces of a light, and among those of any mesh."""

    def sample(self, first: UInt32, count: UInt32, total: Float, sample: Float) -> tuple[UInt32, Float]:
        """Choose a face with a probability proportional to its area, and stretch the sample for use within it.

        Args:
            first: the set-wide number of the mesh's first face.
            count: the number of its faces.
            total: the area of all of them.
            sample: uniform in [0, 1).

        Returns:
            The number of the face in the mesh, and the stretched sample, uniform in [0, 1) again as in Mitsuba.
        """
        wanted = sample * total

        def halved(below: UInt32, steps: range) -> UInt32:
            """The number of faces whose sum lies below, by halving steps; a face without area is never chosen."""
            for k in reversed(steps):
                probe = below + (1 << k)
                inside = probe < count
                value = dr.gather(Float, self._sums, first + probe - 1, inside)
                further = inside & ((value < wanted) | (value == 0)) & (value != total)
                below = dr.select(further, probe, below)
            return below

        of_lights, of_all = self.steps
        below = UInt32(0)
        if of_all > of_lights:  # only scripts draw points of other meshes
            large, more = count > (1 << of_lights), range(of_lights, of_all)
            (below,) = if_stmt(
                (below,), large, lambda below: (halved(below, more),), lambda below: (below,), label="large meshes"
            )
        below = halved(below, range(of_lights))
        before = dr.gather(Float, self._sums, first + below - 1, below > 0)
        after = dr.gather(Float, self._sums, first + below)
        return below, (wanted - before) * dr.rcp(after - before)

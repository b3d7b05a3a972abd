"""The corners of meshes' triangles, and their records in a tree, written by all threads.

A record is the row of a triangle, see `djpt.geometry.bvh.calls.layout`: its frame, as `djpt.geometry.bvh.leaves`
computes it, its label and its face.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.build.builder import Workers, chunks, floats
from djpt.geometry.bvh.build.functions import functions
from djpt.geometry.bvh.build.row_functions import PART_BYTES
from djpt.geometry.bvh.calls.layout import ROW_WORDS

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["corners_of", "write_rows"]

FACES = 1 << 14
"""The faces of one task, more or less."""

SIDES = np.array([1, -1], np.float32).view(np.uint32).tolist()
"""The factor of normals as bits: without and with `flip_normals`."""


def corners_of(meshes: Sequence[Mesh], team: Workers) -> NDArray[np.float32]:
    """The corners of all triangles, (F, 3, 3): face, corner, axis."""
    parts = Parts(meshes)
    corners = np.empty((parts.face_count, 3, 3), np.float32)
    table, target = parts.table.ctypes.data, corners.ctypes.data
    team.map(lambda task: functions().take_corners(table, *task, target), parts.tasks)
    return corners


def write_rows(
    target: NDArray[np.uint32],
    order: NDArray[np.uint32],
    meshes: Sequence[Mesh],
    labels: Sequence[int] | NDArray[np.uint32],
    corners: NDArray[np.float32],
    first_face: int,
    team: Workers,
) -> None:
    """Write the records of all triangles into `target`, (F, 8): row i is that of triangle `order[i]`.

    Args:
        target: Contiguous memory.
        order: A permutation of the numbers of triangles, which count through `meshes`.
        meshes: What the triangles belong to.
        labels: The label of each mesh.
        corners: The triangles' corners (F, 3, 3).
        first_face: Added to the numbers of triangles in the records.
        team: The threads to use.
    """
    parts = Parts(meshes, labels)
    shape = (parts.face_count, ROW_WORDS)
    assert target.shape == shape and target.dtype == np.uint32 and target.flags.c_contiguous
    assert len(order) == len(corners) == parts.face_count
    order, corners = np.ascontiguousarray(order, np.uint32), floats(corners)
    place = np.empty(parts.face_count, np.uint32)
    source, there = order.ctypes.data, place.ctypes.data
    team.map(lambda part: functions().invert(source, *part, there), chunks(parts.face_count, FACES))
    table, addresses = parts.table.ctypes.data, (corners.ctypes.data, there, target.ctypes.data)
    team.map(lambda task: functions().write_rows(table, *task, *addresses, first_face), parts.tasks)


class Parts:
    """The faces of meshes in parts, as `djpt.geometry.bvh.build.row_functions` reads them, and in tasks.

    `tasks`: for each the first part, and the end.
    """

    def __init__(self, meshes: Sequence[Mesh], labels: Sequence[int] | NDArray[np.uint32] | None = None) -> None:
        """Labels are 0 unless given."""
        # The table has only addresses of arrays: those that had to be copied must stay.
        self._arrays: list[NDArray[np.float32] | NDArray[np.uint32]] = []
        rows, first = [], 0
        for mesh, label in zip(meshes, [0] * len(meshes) if labels is None else labels, strict=True):
            indices, positions = np.ascontiguousarray(mesh.indices, np.uint32), floats(mesh.positions)
            self._arrays += [indices, positions]
            address, texcoords = indices.ctypes.data, 0
            if mesh.texcoords is not None:
                self._arrays.append(floats(mesh.texcoords))
                texcoords = self._arrays[-1].ctypes.data
            shared = (positions.ctypes.data, texcoords, SIDES[bool(mesh.flip_normals)], int(label))
            rows += [(first + a, first + b, address + 12 * a, *shared) for a, b in chunks(len(indices), FACES)]
            first += len(indices)
        self.face_count = first
        self.table = np.array(rows, np.uint64).reshape(-1, PART_BYTES // 8)
        starts = np.flatnonzero(np.diff(self.table[:, 0] // FACES, prepend=np.uint64(2**64 - 1))).tolist()
        self.tasks = list(zip(starts, [*starts[1:], len(rows)], strict=True)) if starts else []

"""The reading of OBJ files by compiled functions: up to thirty times as fast as by NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from djpt.jit.llvm.host import HostFunctions
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.obj_functions import CORNERS, FACES, LINES, TRIANGLES, WIDTHS, add_obj_functions
from djpt.shapes.meshes.obj_text import EXACT_POWERS, UNKNOWN

__all__ = ["read_compiled"]

PARAMETERS = {"measure": 3, "scan": 9, "merge": 8, "pick": 6, "cut": 4}
"""The functions, and how many parameters each has."""

FUNCTIONS = HostFunctions(add_obj_functions, PARAMETERS, small=1 << 15, few=16)
"""What reads large files, or many."""

POWERS = np.array([float(10**k) for k in range(EXACT_POWERS + 1)])


def read_compiled(data: bytes) -> MeshData | None:
    """Read the mesh in an OBJ file, as `djpt.shapes.meshes.obj.read_obj`; None if that must do it.

    That is so for files that have a mistake, continued lines or very long numbers, for the first few if they are small,
    and without LLVM.
    """
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    # A backslash at the end of a line continues it.
    run = None if b"\\\n" in data else FUNCTIONS.for_size(len(data))
    if run is None:
        return None
    data += b"\n"
    text = np.frombuffer(data, np.uint8)
    counts = np.zeros(TRIANGLES + 1, np.int64)
    run("measure", text, len(data), counts)
    tables = [np.empty((n, width), np.float32) for n, width in zip(counts[:LINES], WIDTHS, strict=True)]
    faces, corners = np.empty(counts[FACES], np.uint32), np.empty((counts[CORNERS], 3), np.uint32)
    if run("scan", text, *tables, faces, corners, counts, POWERS, len(data)) == UNKNOWN:
        return None
    total = int(counts[CORNERS])
    chains = np.zeros(1 << int(counts[:LINES].max()).bit_length(), np.uint32)
    links, numbers = np.empty(total, np.uint32), np.empty(total, np.uint32)
    vertices = np.empty((total, 3), np.uint32)
    distinct = run("merge", corners, counts, chains, links, vertices, numbers, total, len(chains) - 1) - 1
    if distinct < 0:
        return None
    indices = np.empty((counts[TRIANGLES], 3), np.uint32)
    run("cut", faces, numbers, indices, int(counts[FACES]))
    columns: list[NDArray[np.float32] | None] = []
    for k, (table, width) in enumerate(zip(tables, WIDTHS, strict=True)):
        rows = np.empty((distinct, width), np.float32)
        used = run("pick", table, vertices, rows, k, width, distinct) > 1
        columns.append(rows if used or k == 0 else None)
    positions, texcoords, normals = columns
    assert positions is not None
    return MeshData(positions, indices, normals, texcoords)

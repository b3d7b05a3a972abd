"""Small files in the format of OpenVDB, written by its description alone (version 224, without compression)."""

from __future__ import annotations

import struct

import numpy as np

__all__ = ["vdb_bytes"]

LEAF, MIDDLE, TOP = 8, 16 * 8, 32 * 16 * 8
"""The edges of the cubes that nodes of the three levels cover."""


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def node(edge: int, child: int, cells: dict[tuple[int, int, int], bytes]) -> bytes:
    """An inner node: masks of its children and of its values, no values of its own, and the children."""
    side = edge // child
    mask = np.zeros(side**3, np.uint8)
    for x, y, z in cells:
        mask[(x * side + y) * side + z] = 1
    bits = np.packbits(mask, bitorder="little").tobytes()
    ordered = b"".join(cells[key] for key in sorted(cells))
    return bits + bytes(side**3 // 8) + b"\6" + bytes(4 * side**3) + ordered


def grid_bytes(numbers: np.ndarray, start: tuple[int, int, int], background: float) -> tuple[bytes, bytes]:
    """The topology and the buffers of a tree of floats; `numbers` are (X, Y, Z), within a middle node."""
    whole = np.full((TOP // 32,) * 3, background, np.float32)
    active = np.zeros(whole.shape, bool)
    box = tuple(slice(s, s + n) for s, n in zip(start, numbers.shape, strict=True))
    active[box] = ~np.isnan(numbers)
    whole[box] = np.nan_to_num(numbers, nan=background)
    leaves: dict[tuple[int, int, int], bytes] = {}
    buffers = b""
    for x, y, z in np.ndindex(16, 16, 16):
        part = tuple(slice(LEAF * k, LEAF * (k + 1)) for k in (x, y, z))
        if active[part].any():
            mask = np.packbits(active[part].ravel(), bitorder="little").tobytes()
            leaves[x, y, z] = mask
            buffers += mask + b"\6" + whole[part].astype("<f4").tobytes()
    tree = node(TOP, MIDDLE, {(0, 0, 0): node(MIDDLE, LEAF, leaves)})
    root = struct.pack("<ifII3i", 1, background, 0, 1, 0, 0, 0)
    return root + tree, buffers


def vdb_bytes(
    grids: dict[str, np.ndarray],
    start: tuple[int, int, int] = (0, 0, 0),
    voxel: float = 1.0,
    background: float = 0.0,
    stated: int | None = None,
) -> bytes:
    """A file of float grids.

    Args:
        grids: the voxels by name, (X, Y, Z), within 128 along each axis; those that aren't active are NaN.
        start: the index of the first active voxel.
        voxel: the edge of a voxel in the world; voxel (0, 0, 0) has its centre at the origin.
        background: the value of the others.
        stated: the count of active voxels that the file says, if it does.
    """
    count = b"" if stated is None else text("file_voxel_count") + text("int64") + struct.pack("<Iq", 8, stated)
    data = struct.pack("<qIIIb", 0x56444220, 224, 11, 0, 1) + b"0" * 36 + struct.pack("<II", 0, len(grids))
    scale = np.array([voxel, voxel, 1 / voxel, 1 / voxel**2, 0.5 / voxel])
    transform = text("UniformScaleMap") + np.repeat(scale, 3).astype("<f8").tobytes()
    for name, numbers in grids.items():
        data += text(name) + text("Tree_float_5_4_3") + text("")
        topology, buffers = grid_bytes(numbers, start, background)
        head = struct.pack("<II", 0, len(count) > 0) + count + transform + topology
        begin = len(data) + 24
        data += struct.pack("<3q", begin, begin + len(head), begin + len(head) + len(buffers)) + head + buffers
    return data

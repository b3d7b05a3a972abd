"""Files of OpenVDB: what is read of them, and what is refused."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import FileError, SceneError
from djpt.volumes.volume_grid import read_openvdb

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


NUMBERS = np.random.default_rng(0).random((10, 5, 12), dtype=np.float32) + 0.1


@pytest.fixture
def path(tmp_path: Path) -> Path:
    pytest.importorskip("tinyvdb")
    file = tmp_path / "smoke.vdb"
    file.write_bytes(vdb_bytes({"density": NUMBERS, "heat": 2 * NUMBERS}, (6, 3, 9), 0.25))
    return file


def test_voxels_and_their_box(path: Path) -> None:
    grid = read_openvdb(path)
    np.testing.assert_array_equal(np.array(grid), NUMBERS.transpose(2, 1, 0))
    np.testing.assert_allclose(np.array(grid.bbox().min), (np.array([6, 3, 9]) - 0.5) / 4)
    np.testing.assert_allclose(np.array(grid.bbox().max), (np.array([15, 7, 20]) + 0.5) / 4)
    np.testing.assert_array_equal(np.array(read_openvdb(path, "heat")), 2 * NUMBERS.transpose(2, 1, 0))


def test_a_volume_stands_where_the_file_says(path: Path) -> None:
    """At the centres of voxels interpolation gives their numbers."""
    named = {"filename": str(path), "grid_name": "heat", "use_grid_bbox": True}
    volume = djpt.load_dict({"type": "gridvolume", **named})
    place = np.random.default_rng(1).integers(NUMBERS.shape, size=(50, 3))
    it = dr.zeros(djpt.Interaction3f, 50)
    it.p = djpt.Point3f(((place + np.array([6, 3, 9])) / 4).T.astype(np.float32))
    np.testing.assert_allclose(np.array(volume.eval_1(it)), 2 * NUMBERS[tuple(place.T)], rtol=1e-4)


def test_voxels_that_are_not_active_are_background(tmp_path: Path) -> None:
    pytest.importorskip("tinyvdb")
    file = tmp_path / "corners.vdb"
    numbers = np.full((9, 30, 9), np.nan, np.float32)
    numbers[0, 0, 0] = numbers[8, 29, 8] = 2
    file.write_bytes(vdb_bytes({"only": numbers}, (0, 0, 0), background=0.5))
    found = np.array(read_openvdb(file))
    np.testing.assert_array_equal(found, np.nan_to_num(numbers, nan=0.5).transpose(2, 1, 0))


def test_messages_name_what_is_wrong(path: Path) -> None:
    with pytest.raises(FileError, match="has no grid of numbers called 'density2'; did you mean 'density'"):
        read_openvdb(path, "density2")
    with pytest.raises(SceneError, match=r"'filename' .*has no grid of numbers called 'soot'; possible: density"):
        djpt.load_dict({"type": "gridvolume", "filename": str(path), "grid_name": "soot"})
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(FileError, match="can't be read as an OpenVDB file"):
        read_openvdb(path)


def test_files_with_tiles_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("tinyvdb")
    file = tmp_path / "tiles.vdb"
    file.write_bytes(vdb_bytes({"density": NUMBERS}, stated=NUMBERS.size + 512))
    with pytest.raises(FileError, match="has 1112 active voxels, of which 600 are stored one by one"):
        read_openvdb(file)
    file.write_bytes(vdb_bytes({"density": NUMBERS}, stated=NUMBERS.size))
    assert read_openvdb(file).buffer_size() == 4 * NUMBERS.size


def test_without_the_package_a_message_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tinyvdb", None)
    with pytest.raises(FileError, match=r"need the package tinyvdb: pip install tinyvdb"):
        read_openvdb(tmp_path / "smoke.vdb")

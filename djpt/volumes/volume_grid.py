"""Grids of numbers in space, on the host, and their files: those of Mitsuba, and of OpenVDB."""

from __future__ import annotations

import importlib
import math
import os
import struct
from collections.abc import Sequence
from typing import Any, BinaryIO

import drjit as dr
import numpy as np
from drjit.scalar import Array3f as ScalarPoint3f
from drjit.scalar import Array3u as ScalarArray3u
from numpy.typing import NDArray

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.files import as_path, read_bytes, require_regular, writing
from djpt.core.limits import MAX_NUMBERS, NUMBERS_PER_BYTE
from djpt.description.files import confined
from djpt.errors import ArgumentError, FileError, near_miss

__all__ = ["VolumeGrid", "as_grid", "read_openvdb"]

HEADER = struct.Struct("<3sBiiiii6f")
"""Magic, version, type of numbers, counts along x, y and z, channels, and the corners of the box; little-endian."""

VERSION, FLOAT32 = 3, 1


class VolumeGrid:
    """Numbers on a grid: (Z, Y, X, C), or (Z, Y, X) for a single channel.

    Args:
        path: a file in Mitsuba's format (``.vol``, version 3), an open binary file, or an array of one of these
            shapes: NumPy's or a tensor of Dr.Jit.
        compute_max: whether the largest numbers are found; files always are searched.
        bbox: the box that an array fills; default: the unit cube.

    Raises:
        FileError: the file can't be read, or isn't one of volumes.
        ArgumentError: an array of another shape.
    """

    def __init__(
        self,
        path: Any = None,
        compute_max: bool = True,
        *,
        array: Any = None,
        stream: Any = None,
        bbox: ScalarBoundingBox3f | None = None,
    ) -> None:
        source = next((given for given in (path, array, stream) if given is not None), None)
        self._box = ScalarBoundingBox3f(ScalarPoint3f(0), ScalarPoint3f(1)) if bbox is None else bbox
        self._data = self._read(source) if is_file(source) else as_grid(source)
        self._max, self._max_per_channel = 0.0, [-math.inf] * self.channel_count()
        if compute_max or is_file(source):
            self._max_per_channel = self._data.max(axis=(0, 1, 2)).tolist()
            self._max = max(self._max_per_channel)

    def _read(self, source: Any) -> NDArray[np.float32]:
        name = getattr(source, "name", source)
        try:
            data = source.read() if hasattr(source, "read") else read_bytes(source)
        except OSError as error:
            if isinstance(error, FileError):
                raise
            raise FileError(f"'{name}' can't be read: {error.strerror}") from None
        if len(data) < HEADER.size or data[:3] != b"VOL":
            raise FileError(f"'{name}' isn't a volume file: it doesn't begin with 'VOL' and a header")
        _, version, kind, x, y, z, channels, *corners = HEADER.unpack_from(data)
        if (version, kind) != (VERSION, FLOAT32):
            raise FileError(
                f"'{name}' has version {version} and numbers of type {kind}; possible: version 3, type 1 (float32)"
            )
        if min(x, y, z, channels) < 1 or len(data) < HEADER.size + 4 * x * y * z * channels:
            raise FileError(f"'{name}' ends too early for {x} x {y} x {z} points with {channels} numbers each")
        self._box = ScalarBoundingBox3f(ScalarPoint3f(corners[:3]), ScalarPoint3f(corners[3:]))
        numbers = np.frombuffer(data, "<f4", x * y * z * channels, HEADER.size)
        return numbers.astype(np.float32).reshape(z, y, x, channels)

    # ---- asking ------------------------------------------------------------------------

    def size(self) -> ScalarArray3u:
        """The number of points along x, y and z."""
        z, y, x, _ = self._data.shape
        return ScalarArray3u(x, y, z)

    def channel_count(self) -> int:
        """The count of numbers at a point."""
        return int(self._data.shape[3])

    def bbox(self) -> ScalarBoundingBox3f:
        """The box that a file gives; the unit cube for arrays."""
        return self._box

    def max(self) -> float:
        """The largest number; 0 if it wasn't computed."""
        return self._max

    def max_per_channel(self) -> list[float]:
        """The largest number of each channel; -inf if they weren't computed."""
        return list(self._max_per_channel)

    def set_max(self, max: float, /) -> None:
        """State the largest number."""
        self._max = float(max)

    def set_max_per_channel(self, max: Sequence[float], /) -> None:
        """State the largest number of each channel."""
        if len(max) != self.channel_count():
            raise ArgumentError(f"set_max_per_channel: expected {self.channel_count()} numbers, found {len(max)}")
        self._max_per_channel = [float(x) for x in max]

    def bytes_per_voxel(self) -> int:
        """The size of a point's numbers in bytes."""
        return 4 * self.channel_count()

    def buffer_size(self) -> int:
        """The size of all numbers in bytes."""
        return 4 * self._data.size

    def voxels(self) -> NDArray[np.float32]:
        """The numbers, (Z, Y, X, C); not a copy."""
        return self._data

    @property
    def __array_interface__(self) -> dict[str, Any]:
        """NumPy's way to the numbers: (Z, Y, X, C), without C if it is 1."""
        shown = self._data[..., 0] if self.channel_count() == 1 else self._data
        found: dict[str, Any] = shown.__array_interface__
        return found

    # ---- writing -----------------------------------------------------------------------

    def write(self, path: str | os.PathLike[str] | BinaryIO = "", *, stream: BinaryIO | None = None) -> None:
        """Write the grid to a file: its path (ending in ``.vol``), or an open binary file.

        Raises:
            FileError: the file can't be written.
        """
        path = path if stream is None else stream
        z, y, x, channels = self._data.shape
        corners = [float(c) for corner in self._box for c in corner]
        data = HEADER.pack(b"VOL", VERSION, FLOAT32, x, y, z, channels, *corners) + self._data.astype("<f4").tobytes()
        if hasattr(path, "write"):
            path.write(data)
            return
        with writing(as_path(path)) as temporary:
            temporary.write_bytes(data)

    def __repr__(self) -> str:
        largest = ", ".join(f"{x:g}" for x in self._max_per_channel)
        return (
            f"VolumeGrid[\n  size = {self.size()},\n  channels = {self.channel_count()},\n  max = {self._max:g},\n"
            f"  max_channels = [{largest}],\n  data = [ {self.buffer_size()} B of volume data ]\n]"
        )


def is_file(source: Any) -> bool:
    """True if the source of a grid is a path or an open file."""
    return isinstance(source, (str, os.PathLike)) or hasattr(source, "read")


def as_grid(value: Any) -> NDArray[np.float32]:
    """A copy of an array of numbers, (Z, Y, X, C).

    Raises:
        ArgumentError: not an array of numbers, or of another shape.
    """
    array = np.asarray(dr.detach(value) if dr.is_array_v(value) else value)
    if array.dtype.kind not in "fiu" or array.ndim not in (3, 4) or not array.size:
        raise ArgumentError(
            f"a grid must be numbers of the shape (z, y, x) or (z, y, x, channels), found {array.dtype} {array.shape}"
        )
    with np.errstate(over="ignore"):
        grid = np.array(array, np.float32, order="C")
    return grid[..., None] if grid.ndim == 3 else grid


FLOATS = "Tree_float_5_4_3"
"""The type of grids of single numbers, in files of either precision."""


def read_openvdb(path: str | os.PathLike[str], name: str = "") -> VolumeGrid:
    """A grid of numbers in a file of OpenVDB: its active voxels, and the background between them.

    It is read by tinyvdb, which is installed by ``pip install tinyvdb``. Only what is stored voxel by voxel arrives:
    tinyvdb 0.9 skips constant tiles, so a file whose own count of voxels says that there are some is refused.

    Args:
        path: the file (``.vdb``).
        name: the grid's name; default: 'density', or the only grid of numbers.

    Returns:
        The grid, with the box of the world that its voxels fill.

    Raises:
        FileError: tinyvdb isn't installed, the file can't be read, it has no such grid, or the grid can't be used.
    """
    try:
        tinyvdb: Any = importlib.import_module("tinyvdb")
    except ImportError:
        raise FileError(f"'{path}': OpenVDB files need the package tinyvdb: pip install tinyvdb") from None
    require_regular(path)
    try:
        with tinyvdb.open(os.fspath(path)) as file:
            file.read_grids()
            grids = [file.grid(i) for i in range(file.grid_count)]
            numbers = {grid.name: grid for grid in grids if grid.type_name.startswith(FLOATS)}
            grid = numbers[chosen(path, name, list(numbers))]
            return dense(f"'{path}': the grid '{grid.name}'", grid)
    except (tinyvdb.VDBError, OSError) as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"'{path}' can't be read as an OpenVDB file: {error}") from None


def chosen(path: str | os.PathLike[str], name: str, names: list[str]) -> str:
    """The name of the grid that is asked for."""
    if not name and len(names) == 1:
        return names[0]
    name = name or "density"
    if name not in names:
        raise FileError(f"'{path}' has no grid of numbers called '{name}'{near_miss(name, names)}")
    return name


def dense(where: str, grid: Any) -> VolumeGrid:
    """All voxels of the smallest box of indices that holds the active ones; `where` starts messages."""
    sparse = grid.to_sparse()
    places = np.frombuffer(sparse["coords"], np.int32).reshape(-1, 3)
    stated = grid.metadata.get("file_voxel_count")
    if not len(places):
        raise FileError(f"{where} has no active voxels")
    if stated is not None and int(stated) != len(places):
        raise FileError(
            f"{where} has {stated} active voxels, of which {len(places)} are stored one by one; constant tiles can't "
            "be read: store it without them (OpenVDB's voxelizeActiveTiles)"
        )
    low, high = places.min(axis=0), places.max(axis=0)
    box = math.prod(int(n) for n in high.astype(np.int64) - low + 1)
    if confined() and box > max(MAX_NUMBERS, NUMBERS_PER_BYTE * len(places)):
        raise FileError(
            f"{where} has {len(places)} active voxels in a box of {box}, more than an untrusted scene may ask for"
        )
    voxels = np.full((high - low + 1)[::-1], grid.float_background(), np.float32)
    x, y, z = (places - low).T
    voxels[z, y, x] = np.frombuffer(sparse["values"], np.float32)
    transform = grid.transform
    linear = np.array(transform["matrix"])[:3, :3]
    if not np.array_equal(linear, np.diag(np.diag(linear))):
        raise FileError(f"{where} is rotated in its file; possible: axis-aligned grids, rotated by 'to_world'")
    # Indices are those of the voxels' centres.
    size, start = np.array(transform["voxel_size"]), np.array(transform["translation"])
    corners = ((low - 0.5) * size + start, (high + 0.5) * size + start)
    return VolumeGrid(voxels, bbox=ScalarBoundingBox3f(*(ScalarPoint3f(corner.tolist()) for corner in corners)))

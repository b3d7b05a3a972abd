"""Files of OpenVDB: sparse grids of voxels.

They are read by tinyvdb, which is installed by ``pip install tinyvdb``. Only what is stored voxel by voxel arrives:
tinyvdb 0.9 skips constant tiles, so a file whose own count of voxels says that there are some is refused.
"""

from __future__ import annotations

import importlib
import math
import os
from typing import Any

import numpy as np
from drjit.scalar import Array3f as ScalarPoint3f

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.files import require_regular
from djpt.core.limits import MAX_NUMBERS, NUMBERS_PER_BYTE
from djpt.description.files import confined
from djpt.errors import FileError, near_miss
from djpt.volumes.volume_grid import VolumeGrid

__all__ = ["read_openvdb"]

FLOATS = "Tree_float_5_4_3"
"""The type of grids of single numbers, in files of either precision."""


def read_openvdb(path: str | os.PathLike[str], name: str = "") -> VolumeGrid:
    """A grid of numbers in a file of OpenVDB: its active voxels, and the background between them.

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

"""The numbers of a grid volume: their sources, and the checks that they pass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.limits import LARGEST
from djpt.description.files import resolve
from djpt.description.properties import Properties
from djpt.errors import ArgumentError, FileError, SceneError
from djpt.jit.types import TensorXf
from djpt.textures.texels import numbers_of
from djpt.volumes.openvdb import read_openvdb
from djpt.volumes.volume_grid import VolumeGrid, as_grid

__all__ = ["as_voxels", "check_voxels", "load_voxels"]

SOURCES = ("filename", "grid", "data")
CHANNELS = (1, 3, 6)


def load_voxels(props: Properties) -> tuple[TensorXf, ScalarBoundingBox3f | None]:
    """The numbers that `filename`, `grid` or `data` give, (Z, Y, X, C), and the box that the first two give."""
    given = [key for key in SOURCES if key in props]
    if len(given) != 1:
        found = " and ".join(f"'{key}'" for key in given) or "none"
        raise SceneError(f"{props.node}: '{props.plugin_name()}' needs one of {', '.join(SOURCES)}; found {found}")
    key = given[0]
    box = None
    try:
        if key == "data":
            voxels = as_voxels(props.raw(key))
        else:
            source = read_grid(props) if key == "filename" else props.raw(key)
            grid = source if isinstance(source, VolumeGrid) else VolumeGrid(source)
            voxels, box = as_voxels(grid.voxels()), grid.bbox()
        check_voxels(numbers_of(voxels))
    except (ArgumentError, FileError) as error:
        raise props.error(key, str(error)) from None
    except SceneError as error:
        raise props.error(key, str(error)) from None
    return voxels, box


def read_grid(props: Properties) -> VolumeGrid:
    """The grid in the file `filename`, by the file's suffix; `grid_name` names one of several in a file of OpenVDB."""
    path = resolve(props.string("filename"))
    if path.suffix.lower() == ".vdb":
        return read_openvdb(path, props.string("grid_name", ""))
    return VolumeGrid(path)


def as_voxels(value: Any) -> TensorXf:
    """A tensor (Z, Y, X, C), attached to the gradients of `value`; (Z, Y, X) is one channel.

    Raises:
        SceneError: not an array of numbers, or of another shape.
    """
    try:
        if isinstance(value, TensorXf):
            shape = tuple(value.shape)
            voxels = TensorXf(value.array, (*shape, 1)) if len(shape) == 3 else TensorXf(value)
        else:
            voxels = TensorXf(as_grid(value))
    except ArgumentError as error:
        raise SceneError(str(error)) from None
    shape = tuple(voxels.shape)
    if len(shape) != 4 or shape[3] not in CHANNELS or 0 in shape:
        raise SceneError(f"must have the shape (z, y, x) or (z, y, x, channels) with 1, 3 or 6 channels, found {shape}")
    return voxels


def check_voxels(numbers: NDArray[np.float32]) -> None:
    """Raise `SceneError` unless all numbers are finite."""
    # False for NaN, which is both the least and the greatest number wherever it occurs.
    if not (numbers.min() >= -LARGEST and numbers.max() <= LARGEST):
        z, y, x, channel = np.argwhere(~(np.abs(numbers) <= LARGEST))[0]
        raise SceneError(f"must be finite, found {numbers[z, y, x, channel]} at x = {x}, y = {y}, z = {z}")

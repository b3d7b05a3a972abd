"""The data of meshes that are made in Python, from arrays or from counts, and of meshes whose parameters are edited."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_integer, describe
from djpt.description.properties import Properties
from djpt.errors import ParameterError, SceneError
from djpt.shapes.meshes.data import MeshData, check_indices

__all__ = ["Edits", "check_prefix", "index_rows", "of_arrays", "of_zeros", "rows"]


def of_arrays(
    name: str,
    vertex_positions: Any,
    faces: Any,
    vertex_normals: Any = None,
    vertex_texcoords: Any = None,
    props: Properties | Mapping[str, Any] | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> tuple[MeshData, Properties, Any]:
    """The data of a mesh that is given by arrays, its properties, and `props` as given."""
    own = properties(name, props)
    positions = rows(own.node, "vertex_positions", vertex_positions, 3)
    data = MeshData(positions, index_rows(own.node, faces))
    if vertex_normals is not None:
        data.normals = rows(own.node, "vertex_normals", vertex_normals, 3, len(positions))
    if vertex_texcoords is not None:
        data.texcoords = rows(own.node, "vertex_texcoords", vertex_texcoords, 2, len(positions))
    for key, value in (attributes or {}).items():
        check_prefix(own.node, key)
        count = len(positions if key.startswith("vertex_") else data.indices)
        data.attributes[key] = rows(own.node, key, value, None, count)
    return data, own, props


def check_prefix(node: str, name: str) -> None:
    """Raise `SceneError` unless the name of an attribute says what it belongs to."""
    if not name.startswith(("vertex_", "face_")):
        raise SceneError(f"{node}: the name of attribute '{name}' must begin with 'vertex_' or 'face_'")


def of_zeros(
    name: str,
    vertex_count: int,
    face_count: int,
    props: Properties | Mapping[str, Any] | None = None,
    has_vertex_normals: bool = False,
    has_vertex_texcoords: bool = False,
) -> tuple[MeshData, Properties, Any]:
    """The data of a mesh of zeros, its properties, and `props` as given."""
    own = properties(name, props)
    vertices, faces = count(own.node, "vertex_count", vertex_count), count(own.node, "face_count", face_count)
    try:
        data = MeshData(np.zeros((vertices, 3), np.float32), np.zeros((faces, 3), np.uint32))
        data.normals = np.zeros((vertices, 3), np.float32) if has_vertex_normals else None
        data.texcoords = np.zeros((vertices, 2), np.float32) if has_vertex_texcoords else None
    except MemoryError:
        raise SceneError(f"{own.node}: not enough memory for {vertices} vertices and {faces} faces") from None
    return data, own, props


def count(node: str, name: str, value: Any) -> int:
    """A number of vertices or faces; raise `SceneError` unless indices of 32 bits can count them."""
    try:
        found = as_integer(value)
    except SceneError as error:
        raise SceneError(f"{node}: '{name}' {error}") from None
    if not 0 <= found < 2**32:
        raise SceneError(f"{node}: '{name}' must lie in [0, 2^32), found {describe(value)}")
    return found


def properties(name: str, props: Properties | Mapping[str, Any] | None) -> Properties:
    """The properties of a mesh that is made in Python; nested dicts become plugins."""
    from djpt.description.loader import load_dict

    if isinstance(props, Properties):
        if not props.node:
            props.node = name
        if not props.id():
            props.set_id(name)
        return props
    if props is not None and not isinstance(props, Mapping):
        raise SceneError(f"{name}: props must be a dict, found {describe(props)}")
    values = dict(props or {})
    for key, value in values.items():
        if isinstance(value, Mapping):
            values[key] = plugin = load_dict(value)
            plugin.set_id(f"{name}.{key}")
    return Properties("mesh", name, values)


def rows(node: str, name: str, value: Any, width: int | None, count: int | None = None) -> NDArray[np.float32]:
    """Convert numbers to rows, (N, `width`) float32; flat arrays (also of Dr.Jit) are cut into rows."""
    found = numbers(node, name, value)
    if found.ndim == 1 and (width or count):
        width = width or found.size // max(count or 1, 1)
        found = found.reshape(-1, width) if width and found.size % width == 0 else found
    if found.ndim != 2 or (width and found.shape[1] != width) or (count is not None and len(found) != count):
        wanted = f"({'N' if count is None else count}, {width or 'channels'})"
        raise SceneError(f"{node}: '{name}' must have the shape {wanted}, found {found.shape}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(found, np.float32)


def index_rows(node: str, value: Any) -> NDArray[np.uint32]:
    """Convert vertex indices to (F, 3) uint32."""
    found = numbers(node, "faces", value)
    found = found.reshape(-1, 3) if found.ndim == 1 and found.size % 3 == 0 else found
    if found.ndim != 2 or found.shape[1] != 3:
        raise SceneError(f"{node}: 'faces' must have the shape (F, 3), found {found.shape}")
    if found.size and not ((found >= 0) & (found < 2**32) & (found == np.floor(found))).all():
        raise SceneError(f"{node}: 'faces' must be whole numbers from 0 on, found {describe(value)}")
    return np.ascontiguousarray(found, np.uint32)


def numbers(node: str, name: str, value: Any) -> NDArray[Any]:
    """Convert to an array of numbers; NaN is allowed, since cleaning deals with it."""
    try:
        found = np.array(dr.detach(value) if dr.is_array_v(value) else value)
    except Exception:
        found = np.array(None)
    if found.dtype.kind not in "iuf":
        raise SceneError(f"{node}: '{name}' must be an array of numbers, found {describe(value)}")
    return found


# ---- edits -------------------------------------------------------------------------------------------------------


@dataclass
class Edits:
    """The parameters of a mesh: those that have changed must fit the mesh, the others follow its size.

    Args:
        node: the mesh's name in messages.
        parameter: gives the flat array of a parameter by the parameter's name.
        changed: the names of the parameters that were edited.
    """

    node: str
    parameter: Callable[[str], Any]
    changed: Set[str]

    def rows(self, name: str, width: int) -> NDArray[Any]:
        """Read a parameter as rows, (N, `width`); raises `ParameterError` if its numbers don't make whole ones."""
        flat = np.array(dr.detach(self.parameter(name)))
        if flat.size % width:
            raise ParameterError(f"{self.node}.{name}: {flat.size} numbers don't make rows of {width}")
        return flat.reshape(-1, width)

    def faces(self, old: NDArray[np.uint32], vertices: int) -> NDArray[np.uint32]:
        """The corners of all triangles, (F, 3): `old` ones unless they were edited.

        Raises:
            ParameterError: no triangle, or an index that isn't less than the number of `vertices`.
        """
        indices = self.rows("faces", 3).astype(np.uint32) if "faces" in self.changed else old
        if not len(indices):
            raise ParameterError(f"{self.node}.faces: a mesh needs at least one triangle")
        try:
            check_indices(indices, vertices, f"{self.node}.faces")
        except SceneError as error:
            raise ParameterError(str(error)) from None
        return indices

    def fitting_rows(self, name: str, width: int, count: int) -> NDArray[np.float32] | None:
        """Read the rows, (`count`, `width`), that belong to vertices or faces; None if the parameter is empty.

        They are zeros if only the number of vertices or faces has changed; normals become zeros in silence, since they
        are computed anew.

        Raises:
            ParameterError: the parameter was edited, and has another number of rows.
        """
        value = self.rows(name, width)
        if not len(value):
            return None
        if len(value) != count:
            if name in self.changed:
                raise ParameterError(f"{self.node}.{name}: must be {count} rows of {width}, found {len(value)}")
            if name != "vertex_normals":
                warnings.warn(f"{self.node}.{name}: the size of the mesh has changed; set to zero", stacklevel=2)
            value = np.zeros((count, width), np.float32)
        return value

"""The reader and the writer of meshes in PLY files, with attributes of vertices and faces."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from typing import IO

import numpy as np
from numpy.typing import NDArray

from djpt.core.files import as_path, writing
from djpt.errors import SceneError
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.ply_format import Column, Element, read_elements

__all__ = ["fans", "read_ply", "write_ply"]

TEXCOORDS = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))
LISTS = ("vertex_indices", "vertex_index")
SEQUENCES = ("0123", "1234", "xyzw", "rgba")
"""Endings of the names of an attribute's channels: ``curvature_0``; ``flow_x, flow_y, flow_z``."""


def read_ply(data: bytes, where: str) -> MeshData:
    """Read the mesh in a PLY file.

    As in Mitsuba, properties ``r, g, b`` or ``red, green, blue`` (and ``a`` or ``alpha``) become the
    attribute ``vertex_color`` or ``face_color``, as they are; others whose names end in ``_0``, ``_1``,
    ... or ``_x``, ``_y``, ... become attributes of one or three channels. Polygons become fans of
    triangles.

    Args:
        data: the file's contents.
        where: names the file in messages.

    Raises:
        SceneError: no PLY file or no mesh, or the file is cut short.
    """
    elements = {element.name: element for element in read_elements(data, where)}
    for name in ("vertex", "face"):
        if name not in elements:
            found = ", ".join(elements) or "none"
            raise SceneError(f"{where}: a mesh needs the elements 'vertex' and 'face', found: {found}")
    vertex, face = elements["vertex"], elements["face"]
    positions = table(vertex, ("x", "y", "z"))
    if positions is None:
        found = ", ".join(vertex.columns) or "none"
        raise SceneError(f"{where}: vertices need the properties x, y, z; found: {found}")
    used = {"x", "y", "z"}
    normals = table(vertex, ("nx", "ny", "nz"))
    used |= {"nx", "ny", "nz"}
    texcoords = None
    for names in TEXCOORDS:
        if texcoords is None and (texcoords := table(vertex, names)) is not None:
            used |= set(names)

    column = next((face.columns[name] for name in LISTS if name in face.columns), None)
    if column is None or column.counts is None:
        if face.count:
            raise SceneError(
                f"{where}: faces need the list 'vertex_indices', found: {', '.join(face.columns) or 'none'}"
            )
        column = Column(np.zeros(0, np.int64), np.zeros(0, np.int64))
    indices, polygon = triangles(column, len(positions), where)
    attributes = read_attributes(vertex, "vertex_", used, where)
    for name, values in read_attributes(face, "face_", set(LISTS), where).items():
        attributes[name] = values[polygon]
    return MeshData(positions, indices, normals, texcoords, attributes)


def table(element: Element, names: Sequence[str]) -> NDArray[np.float32] | None:
    """The named properties side by side, (N, C); None if one is missing."""
    columns = [element.columns.get(name) for name in names]
    result = np.empty((element.count, len(names)), np.float32)
    for k, column in enumerate(columns):
        if column is None or column.counts is not None:
            return None
        with np.errstate(over="ignore"):
            result[:, k] = column.values
    return result


def triangles(column: Column, vertex_count: int, where: str) -> tuple[NDArray[np.uint32], NDArray[np.int64]]:
    """The triangles of all faces, and the face that each is a part of."""
    assert column.counts is not None
    values = column.values
    # Checked before the conversion to unsigned numbers, which would wrap; `not` catches NaN.
    if len(values) and not (values.min() >= 0 and values.max() < vertex_count):
        worst = int(np.argmin((values >= 0) & (values < vertex_count)))
        row = int(np.searchsorted(np.cumsum(column.counts), worst, side="right"))
        raise SceneError(
            f"{where}: face {row} refers to vertex {values[worst]:.9g}; there are {vertex_count}, counted from 0"
        )
    own = values.astype(np.uint32)
    if (column.counts == 3).all():
        return own.reshape(-1, 3), np.arange(len(column.counts))
    corners, polygon = fans(column.counts)
    return own[corners], polygon


def read_attributes(element: Element, prefix: str, used: set[str], where: str) -> dict[str, NDArray[np.float32]]:
    """Group the properties that aren't `used` into attributes."""
    names = [p.name for p in element.properties if p.name not in used and not p.count_type]
    groups: dict[str, list[str]] = {}
    for rgb in (("r", "g", "b", "a"), ("red", "green", "blue", "alpha")):
        if "color" not in groups and all(name in names for name in rgb[:3]):
            groups["color"] = [name for name in rgb if name in names]
    names = [name for name in names if name not in groups.get("color", ())]
    ignored = []
    for name in names:
        base, _, ending = name.rpartition("_")
        channels = groups.setdefault(base, []) if base and len(ending) == 1 else None
        sequence = "".join([*(other[-1] for other in channels), ending]) if channels is not None else ""
        if channels is None or not any(s.startswith(sequence) for s in SEQUENCES):
            ignored.append(name)
        else:
            channels.append(name)
    result = {}
    for base, channels in groups.items():
        if len(channels) in (1, 3) or base == "color":
            values = table(element, channels)
            assert values is not None
            result[prefix + base] = values
        else:
            ignored += channels
    if ignored:
        warnings.warn(f"{where}: ignored properties of '{element.name}': {', '.join(ignored)}", stacklevel=2)
    return result


# ---- polygons ----------------------------------------------------------------------------------------------------


def fans(counts: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut polygons whose corners lie one after the other in a list.

    Args:
        counts: corners of each polygon, (P,); those with less than three give nothing.

    Returns:
        The triangles as positions in the list, (F, 3), and the polygon of each, (F,).
    """
    starts = np.cumsum(counts) - counts
    triangles = np.maximum(counts.astype(np.int64) - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    first = starts[polygon]
    return np.stack([first, first + step + 1, first + step + 2], axis=1), polygon


def write_ply(path: str | os.PathLike[str] | IO[bytes], mesh: MeshData) -> None:
    """Write a PLY file: see `ply_bytes`. `path` may be a binary stream, too.

    The file is written under another name first, so that a failure leaves an older one whole.

    Raises:
        FileError: it can't be written.
    """
    if hasattr(path, "write"):
        path.write(ply_bytes(mesh))
        return
    with writing(as_path(path)) as temporary:
        temporary.write_bytes(ply_bytes(mesh))


def ply_bytes(mesh: MeshData) -> bytes:
    """A little-endian PLY file, with the names that `read_ply` and Mitsuba understand."""
    vertex = {"xyz": mesh.positions}
    names = ["x", "y", "z"]
    if mesh.normals is not None:
        vertex["normals"] = mesh.normals
        names += ["nx", "ny", "nz"]
    if mesh.texcoords is not None:
        vertex["texcoords"] = mesh.texcoords
        names += ["u", "v"]
    face: dict[str, NDArray[np.float32]] = {}
    face_names: list[str] = []
    for name, values in mesh.attributes.items():
        kind, _, base = name.partition("_")
        channels = channel_names(base, values.shape[1])
        (vertex if kind == "vertex" else face)[name] = values
        (names if kind == "vertex" else face_names).extend(channels)

    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(mesh.positions)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(mesh.indices)}", "property list uchar int vertex_indices"]
    header += [f"property float {name}" for name in face_names]
    rows = np.zeros(len(mesh.indices), [("n", "u1"), ("i", "<u4", 3), ("f", "<f4", len(face_names))])
    rows["n"], rows["i"] = 3, mesh.indices
    if face:
        rows["f"] = np.concatenate(list(face.values()), axis=1)
    text = "\n".join([*header, "end_header\n"]).encode()
    return text + np.concatenate(list(vertex.values()), axis=1).astype("<f4").tobytes() + rows.tobytes()


def channel_names(base: str, count: int) -> list[str]:
    """The names of the properties that hold an attribute's channels."""
    if base == "color" and count in (3, 4):
        return list("rgba"[:count])
    return [f"{base}_{k}" for k in range(count)]

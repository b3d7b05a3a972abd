"""The writer of meshes as binary PLY files."""

from __future__ import annotations

import os
from typing import IO

import numpy as np
from numpy.typing import NDArray

from djpt.core.files import as_path, writing
from djpt.shapes.meshes.data import MeshData

__all__ = ["write_ply"]


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

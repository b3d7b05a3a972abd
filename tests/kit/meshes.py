"""Meshes for tests, and files of them."""

from __future__ import annotations

import atexit
import shutil
import struct
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

import djpt

__all__ = [
    "bumpy_sheet",
    "properties",
    "tetrahedron_file",
    "write_binary_ply",
    "write_obj",
    "write_ply",
    "write_serialized",
]

Array = np.ndarray


def bumpy_sheet(n: int = 5, seed: int = 0) -> dict[str, Any]:
    """Vertices, faces, normals and texture coordinates of a crumpled square of 2 (n - 1)^2 triangles."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    positions = np.stack([x, y, 0.3 * rng.normal(size=x.shape)], axis=-1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    lower = np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([i[:-1, :-1], i[1:, 1:], i[1:, :-1]], axis=-1).reshape(-1, 3)
    normals = rng.normal(size=positions.shape) * 0.3 + [0, 0, 1]
    texcoords = rng.random((n * n, 2))
    return {
        "positions": positions.astype(np.float32),
        "faces": np.concatenate([lower, upper]).astype(np.int32),
        "normals": (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32),
        "texcoords": texcoords.astype(np.float32),
    }


def properties(*names: str, kind: str = "float") -> str:
    """Header lines that declare some properties."""
    return "".join(f"property {kind} {name}\n" for name in names)


XYZ, FACES = properties("x", "y", "z"), "property list uchar int vertex_indices\n"


def write_ply(path: Path, vertices: str, faces: str, more_vertex: str = "", more_face: str = "") -> Path:
    """An ascii file from its rows, as text; `more_...` declare further properties."""
    header = (
        f"ply\nformat ascii 1.0\ncomment by hand\nelement vertex {len(vertices.splitlines())}\n{XYZ}{more_vertex}"
        f"element face {len(faces.splitlines())}\n{FACES}{more_face}end_header\n"
    )
    path.write_text(header + vertices + "\n" + faces + "\n")
    return path


def write_binary_ply(path: Path, mesh: dict[str, Any], order: str = "<", normals: bool = True, uv: bool = True) -> Path:
    """A binary file of `bumpy_sheet`'s arrays."""
    columns = [mesh["positions"]]
    names = XYZ
    if normals:
        columns.append(mesh["normals"])
        names += properties("nx", "ny", "nz")
    if uv:
        columns.append(mesh["texcoords"])
        names += properties("u", "v")
    rows = np.zeros(len(mesh["faces"]), np.dtype([("n", "u1"), ("i", order + "i4", 3)]))
    rows["n"], rows["i"] = 3, mesh["faces"]
    endian = "little" if order == "<" else "big"
    header = (
        f"ply\nformat binary_{endian}_endian 1.0\nelement vertex {len(mesh['positions'])}\n{names}"
        f"element face {len(rows)}\n{FACES}end_header\n"
    )
    path.write_bytes(header.encode() + np.concatenate(columns, axis=1).astype(order + "f4").tobytes() + rows.tobytes())
    return path


def write_obj(path: Path, mesh: dict[str, Any]) -> Path:
    """An OBJ file of `bumpy_sheet`'s arrays; its quads are cut in reading."""
    lines = []
    for key, values in (("v", mesh["positions"]), ("vt", mesh["texcoords"]), ("vn", mesh["normals"])):
        lines += [key + "".join(f" {float(x):.9g}" for x in row) for row in values]
    lines += ["f " + " ".join(f"{i + 1}/{i + 1}/{i + 1}" for i in face) for face in mesh["faces"]]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_serialized(path: Path, meshes: list[dict[str, Any]], version: int = 4, double: bool = False) -> Path:
    """A file of several meshes; what a dict lacks (`normals`, `texcoords`, `colors`) is left out."""
    parts = []
    for mesh in meshes:
        optional = [("normals", 1), ("texcoords", 2), ("colors", 8)]
        flags = sum(bit for key, bit in optional if key in mesh) | (0x2000 if double else 0x1000)
        arrays = [mesh["positions"], *(mesh[key] for key, _ in optional if key in mesh)]
        body = struct.pack("<I", flags) + (b"a name\0" if version == 4 else b"")
        body += struct.pack("<QQ", len(mesh["positions"]), len(mesh["faces"]))
        body += b"".join(np.asarray(a).astype("<f8" if double else "<f4").tobytes() for a in arrays)
        body += np.asarray(mesh["faces"]).astype("<u4").tobytes()
        parts.append(struct.pack("<HH", 0x041C, version) + zlib.compress(body))
    offsets = np.cumsum([0, *(len(part) for part in parts)])[:-1]
    tail = offsets.astype("<u8" if version == 4 else "<u4").tobytes() + struct.pack("<I", len(parts))
    path.write_bytes(b"".join(parts) + tail)
    return path


def tetrahedron_file() -> str:
    """A PLY file: a tetrahedron over the origin, with vertex normals."""
    path = Path(tempfile.mkdtemp(prefix="djpt-")) / "tetrahedron.ply"
    atexit.register(shutil.rmtree, path.parent, ignore_errors=True)
    corners = np.array([[0.0, 0, 1], [1, 0.2, 1.3], [0.1, 0.8, 1.2], [0.2, 0.3, 2]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    djpt.Mesh("tetrahedron", vertex_positions=corners, faces=faces).write_ply(path)
    return str(path)

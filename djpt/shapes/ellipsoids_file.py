"""The reader of ellipsoids in PLY files, those of 3D Gaussian splatting among them.

B. Kerbl, G. Kopanas, T. Leimkuehler and G. Drettakis, "3D Gaussian Splatting for Real-Time Radiance Field Rendering",
SIGGRAPH 2023.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError
from djpt.shapes.meshes.ply_format import read_elements

__all__ = ["Table", "read_ellipsoids"]

Table = NDArray[np.float64]

FIRST = ("x", "y", "z", "nx", "ny", "nz")
LAST = ("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
LEAST_SCALE, LEAST_OPACITY = 1e-6, 1e-8


def read_ellipsoids(data: bytes, where: str, factor: float, to_world: Table) -> tuple[Table, dict[str, Table]]:
    """Read ellipsoids (N, 10) and their attributes from the first element of a PLY file.

    Its properties begin with x y z nx ny nz and end with scale_0 .. scale_2, logarithms of the scales, and rot_0 ..
    rot_3, a quaternion w x y z. Those between are attributes: names that end in _0, _1, .. become one. In files of 3D
    Gaussian splatting they are colours, which become the attribute `sh_coeffs`, three numbers for each spherical
    harmonic, and `opacity`, whose logistic function becomes `opacities`.

    Args:
        data: the file's contents.
        where: names the file in messages.
        factor: multiplies the scales.
        to_world: moves the ellipsoids, (4, 4): scales by the mean of its scales.

    Raises:
        SceneError: no such file.
    """
    elements = read_elements(data, where)
    if not elements:
        raise SceneError(f"{where}: the file has no elements; ellipsoids are the rows of the first one")
    element = elements[0]
    names = list(element.columns)
    if tuple(names[:6]) != FIRST or tuple(names[-7:]) != LAST:
        raise SceneError(
            f"{where}: ellipsoids need the properties {' '.join(FIRST)} .. {' '.join(LAST)}, found: {' '.join(names)}"
        )
    rows = np.stack([np.asarray(element.columns[name].values, np.float64) for name in names], axis=1)
    # The rotation of the polar decomposition, and what is left.
    u, stretch, v = np.linalg.svd(to_world[:3, :3])
    turn = u @ v
    scale = float(np.trace(v.T @ np.diag(stretch) @ v)) / 3
    centers = rows[:, :3] @ to_world[:3, :3].T + to_world[:3, 3]
    scales = np.maximum(np.exp(rows[:, -7:-4]), LEAST_SCALE) * factor * scale
    quaternions = product(quaternion_of(turn), rows[:, [-3, -2, -1, -4]])
    quaternions /= np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-300)
    between = names[6:-7]
    splats = bool(between) and between[0] == "f_dc_0" and between[-1] == "opacity"
    attributes = of_splats(rows[:, 6:-7]) if splats else by_prefix(between, rows[:, 6:-7])
    return np.concatenate([centers, scales, quaternions], axis=1), attributes


def of_splats(rows: Table) -> dict[str, Table]:
    """The attributes in a file of 3D Gaussian splatting: colours by harmonic, opacities."""
    colors, count = rows[:, :-1], (rows.shape[1] - 1) // 3
    # The file has the first harmonic's three colours, then all others of red, of green, and of blue.
    others = colors[:, 3:].reshape(len(rows), 3, count - 1).transpose(0, 2, 1)
    harmonics = np.concatenate([colors[:, :3], others.reshape(len(rows), -1)], axis=1)
    opacities = np.clip(1 / (1 + np.exp(-rows[:, -1:])), LEAST_OPACITY, 1 - LEAST_OPACITY)
    return {"sh_coeffs": harmonics, "opacities": opacities}


def by_prefix(names: list[str], rows: Table) -> dict[str, Table]:
    """The attributes in columns, of which those with a common name before the last _ are one."""
    columns: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        columns.setdefault(name.rpartition("_")[0] or name, []).append(k)
    return {name: rows[:, which] for name, which in columns.items()}


def quaternion_of(turn: Table) -> Table:
    """The quaternion x y z w of a rotation, (4,); of a reflection that of the rotation with the axes reversed."""
    m = turn * np.sign(np.linalg.det(turn))
    # The largest eigenvector of Bar-Itzhack's matrix (2000).
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )
    q: Table = np.linalg.eigh(k)[1][:, -1]
    return q if q[3] >= 0 else -q


def product(a: Table, b: Table) -> Table:
    """The products of a quaternion (4,) with others, (N, 4), all x y z w."""
    (x, y, z, w), (bx, by, bz, bw) = a, b.T
    return np.stack(
        [
            w * bx + x * bw + y * bz - z * by,
            w * by - x * bz + y * bw + z * bx,
            w * bz + x * by - y * bx + z * bw,
            w * bw - x * bx - y * by - z * bz,
        ],
        axis=1,
    )

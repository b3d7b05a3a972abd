"""The base of shapes that are clouds of ellipsoids: data, attributes, extents, and the reader of their files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array
from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import ParameterError, SceneError, near_miss
from djpt.jit.kernels import own_floats
from djpt.jit.types import ArrayXf, Bool, Color3f, Float, UInt32
from djpt.shapes.base import Shape
from djpt.shapes.mesh import MeshFile
from djpt.shapes.meshes.ply_format import read_elements
from djpt.shapes.silhouettes.moving import exchanged_value

__all__ = ["Cloud", "Table", "read_ellipsoids"]

Table = NDArray[np.float64]

FIRST = ("x", "y", "z", "nx", "ny", "nz")
LAST = ("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
LEAST_SCALE, LEAST_OPACITY = 1e-6, 1e-8


def read_ellipsoids(data: bytes, where: str, factor: float, to_world: Table) -> tuple[Table, dict[str, Table]]:
    """Read ellipsoids (N, 10) and their attributes from the first element of a PLY file.

    Those of 3D Gaussian splatting are among them: B. Kerbl, G. Kopanas, T. Leimkuehler and G. Drettakis, "3D Gaussian
    Splatting for Real-Time Radiance Field Rendering", SIGGRAPH 2023.

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


WIDTH = 10
"""Numbers of an ellipsoid: centre (3), half-axes (3), rotation as a quaternion x y z w."""
PARTS = {"ellipsoid": (0, WIDTH), "center": (0, 3), "scale": (3, 3), "quaternion": (6, 4)}
"""Attributes that are parts of these numbers: the first one, and how many."""
SOURCES = ("filename", "data", "centers")
FULL = "scales must be positive, and quaternions not 0"
LEAST_RESPONSE = 0.01
"""The fraction of its opacity at which a Gaussian's support ends, with `extent_adaptive_clamping`."""


class Cloud(Shape):
    """The data, the extents and the attributes of many ellipsoids; see `djpt.shapes.ellipsoids.Ellipsoids`."""

    has_area = False

    def read_cloud(self, props: Properties) -> None:
        """Take the ellipsoids from a file or from arrays, and all entries that nothing has asked for as attributes."""
        if self.flip_normals:
            raise props.error("flip_normals", "can't be true: ellipsoids are visible only from outside")
        if self._emitter is not None:
            raise SceneError(f"{props.node}: ellipsoids can't emit light: points can't be sampled on them")
        given = [key for key in SOURCES if key in props]
        if len(given) != 1:
            found = " and ".join(f"'{key}'" for key in given) or "none"
            raise SceneError(f"{props.node}: give one of 'filename', 'data' and 'centers'; found: {found}")
        if given[0] != "filename" and (wrong := [key for key in ("scale_factor", "to_world") if key in props]):
            raise props.error(wrong[0], "applies to files only")
        data, attributes = self._from_file(props) if given[0] == "filename" else (from_arrays(props), {})
        self.extent = props.float("extent", 3.0, low=0.0, low_open=True)
        self.extent_adaptive_clamping = props.boolean("extent_adaptive_clamping", False)
        count = len(data)
        for key in props.unqueried():
            if not isinstance(props._values[key], Plugin):
                attributes[key] = numbers(props, key, (count, None))
        self.numbers: Any = own_floats(data.astype(np.float32).ravel())
        self.count = count
        self.channels: dict[str, int] = {}
        """The number of channels of each attribute; the shape holds its numbers under the same name."""
        for name, table in attributes.items():
            if hasattr(self, name):
                raise props.error(name, "can't be the name of an attribute: it has another meaning")
            self.channels[name] = table.shape[1]
            setattr(self, name, own_floats(table.astype(np.float32).ravel()))
        if self.extent_adaptive_clamping and "opacities" not in self.channels:
            raise props.error("extent_adaptive_clamping", "needs the attribute 'opacities'")
        if not self._have_volume():
            raise props.error(given[0], f"gives flat ellipsoids: {FULL}")

    def _from_file(self, props: Properties) -> tuple[NDArray[np.float64], dict[str, Table]]:
        path: Path = MeshFile.find(props)
        scale = props.float("scale_factor", 1.0, low=0.0, low_open=True)
        return read_ellipsoids(MeshFile.load(props, path), f"{props.node}: {path.name}", scale, self.to_world.matrix)

    # ---- parameters ------------------------------------------------------------------

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        fixed = ParamFlags.ReadOnly | ParamFlags.NonDifferentiable
        callback.put("data", self.numbers, ParamFlags.Differentiable, "numbers")
        for name in self.channels:
            callback.put(name, getattr(self, name), ParamFlags.Differentiable)
        callback.put("extent", self.extent, fixed)
        callback.put("extent_adaptive_clamping", self.extent_adaptive_clamping, fixed)

    def check_parameter(self, name: str, value: Any) -> Any:
        return value if name == "data" or name in self.channels else super().check_parameter(name, value)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self._check()

    def _check(self) -> None:
        """Raise `ParameterError` unless there are as many numbers as ellipsoids need, none of them flat."""
        attributes = [(name, width, getattr(self, name)) for name, width in self.channels.items()]
        for name, width, values in (("data", WIDTH, self.numbers), *attributes):
            size = dr.width(values)
            if size != width * self.count:
                raise ParameterError(f"{self.id()}.{name}: must be {width * self.count} numbers, found {size}")
        if not self._have_volume():
            raise ParameterError(f"{self.id()}.data: {FULL}")

    # ---- on the host -----------------------------------------------------------------

    def _table(self) -> NDArray[np.float64]:
        return np.array(dr.detach(self.numbers), np.float64).reshape(-1, WIDTH)

    def _have_volume(self) -> bool:
        return bool((np.abs(np.linalg.det(self._half_axes())) > 0).all())

    def _half_axes(self) -> NDArray[np.float64]:
        """The maps from the unit ball to the ellipsoids about the origin, (N, 3, 3)."""
        data, extents = self._table(), np.full(self.count, self.extent)
        if self.extent_adaptive_clamping:
            opacities = np.array(dr.detach(self.opacities), np.float64)  # type: ignore[attr-defined]
            extents = extents * np.sqrt(2 * np.log(np.maximum(opacities / LEAST_RESPONSE, 1 + 1e-6))) / 3
        return rotations(data[:, 6:]) * (data[:, 3:6] * extents[:, None])[:, None, :]

    def primitive_count(self) -> int:
        return self.count

    def is_ellipsoids(self) -> bool:
        """True."""
        return True

    def has_attribute(self, name: str, active: Bool | bool = True) -> bool:
        return name in self.channels or name in PARTS

    def is_moving(self) -> bool:
        return bool(dr.grad_enabled(self.numbers))

    def attached_names(self) -> list[str]:
        with dr.resume_grad():
            return [name for name in ("numbers", *self.channels) if dr.grad_enabled(getattr(self, name))]

    # ---- attributes ------------------------------------------------------------------

    def _attribute(self, name: str, si: Any, active: Bool | bool) -> Any:
        """An attribute at a point: a `Float`, a `Color3f`, or a list of channels."""
        if name in self.channels:
            owner, begin, width = name, 0, self.channels[name]
            stride = width
        elif name in PARTS:
            owner, (begin, width), stride = "numbers", PARTS[name], WIDTH
        else:
            raise SceneError(f"{self.id()}: there is no attribute '{name}'{near_miss(name, [*self.channels, *PARTS])}")
        source = exchanged_value(self, owner)
        if source is None:
            source = getattr(self, owner)
        first = UInt32(si.prim_index) * stride + begin
        channels = [dr.gather(Float, source, first + k, active) for k in range(width)]
        return channels[0] if width == 1 else Color3f(*channels) if width == 3 else channels

    def eval_attribute_x(self, name: str, si: Any, active: Bool | bool = True) -> ArrayXf:
        value = self._attribute(name, si, active)
        return ArrayXf(value if isinstance(value, list) else [value] if dr.depth_v(value) == 1 else list(value))


def numbers(props: Properties, key: str, shape: tuple[int | None, int | None]) -> NDArray[np.float64]:
    """The entry of a key as a table; None in `shape` stands for any size."""
    value = props.raw(key)
    with props.naming(key):
        found = as_array(np.array(dr.detach(value)) if dr.is_array_v(value) else value)
    if found.ndim == 1 and shape[1]:
        found = found.reshape(-1, shape[1]) if found.size % shape[1] == 0 else found
    if found.ndim != 2 or any(n is not None and n != m for n, m in zip(shape, found.shape, strict=True)):
        wanted = ", ".join(name if n is None else str(n) for n, name in zip(shape, ("N", "D"), strict=True))
        raise props.error(key, f"must have the shape ({wanted}), found {found.shape}")
    return found


def from_arrays(props: Properties) -> NDArray[np.float64]:
    """The data (N, 10) of ellipsoids that are given by arrays."""
    if "data" in props:
        return numbers(props, "data", (None, WIDTH))
    centers = numbers(props, "centers", (None, 3))
    scales, quaternions = numbers(props, "scales", (len(centers), 3)), numbers(props, "quaternions", (len(centers), 4))
    return np.concatenate([centers, scales, quaternions], axis=1)


def rotations(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrices (N, 3, 3) of quaternions x y z w, (N, 4)."""
    x, y, z, w = (q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-300)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)

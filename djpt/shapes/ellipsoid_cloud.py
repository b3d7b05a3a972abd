"""The base of shapes that are clouds of ellipsoids: data, attributes, extents."""

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
from djpt.errors import DjptError, ParameterError, SceneError, near_miss
from djpt.jit.kernels import own_floats
from djpt.jit.types import ArrayXf, Bool, Color3f, Float, UInt32
from djpt.shapes.base import Shape
from djpt.shapes.ellipsoids_file import Table, read_ellipsoids
from djpt.shapes.mesh_file import MeshFile
from djpt.shapes.silhouettes.moving import exchanged_value

__all__ = ["Cloud"]

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
        """How many each attribute has; its numbers are the attribute of this name of the shape."""
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
    try:
        found = as_array(np.array(dr.detach(value)) if dr.is_array_v(value) else value)
    except DjptError as error:
        raise props.error(key, str(error)) from None
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

"""Surfaces given by signed distances on a grid."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f, coordinate_system
from djpt.core.numeric import describe
from djpt.description.files import resolve
from djpt.description.plugin import HIDDEN, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.errors import DjptError, FileError, ParameterError
from djpt.jit.types import Array4f, Float, Int32, Point2f, Point3f, TensorXf, UInt32, Vector3f
from djpt.shapes.level_set import PLACE, LevelSet, gradient
from djpt.shapes.mitsuba_api import ShapeType
from djpt.volumes.volume_grid import VolumeGrid

__all__ = ["SDFGrid", "read_volume"]

SERIAL = itertools.count()
MOST_CELLS = 2**26
"""Most cells of a grid; each takes 32 bytes."""


class SDFGrid(LevelSet):
    """The zeros of a trilinear interpolant of samples on a grid over [0, 1]^3; negative values are inside.

    Parameters: `grid` (array or tensor (Z, Y, X, 1), at least 2 samples along each axis; the outermost lie on the faces
    of the cube) or `filename` (Mitsuba's volume format with one channel), `normals` ("smooth", the default: blended
    over the eight cells around a grid point; "analytic": the gradient), `to_world` (affine), `flip_normals`.
    As in Mitsuba there are no uv. Unlike there, the shape may be a light, and the grid may have unequal sides (with
    which Mitsuba 3.9.1 loses most of the surface).

    Smooth normals: H. Hansson-Söderlund, A. Evans and T. Akenine-Möller, "Ray Tracing of Signed Distance Function
    Grids", JCGT 11(3), 2022.
    """

    in_any_frame = True
    shape_kind = ShapeType.SDFGrid
    values = dict.fromkeys(PLACE, HIDDEN)
    # Every grid has kernel code of its own, since its `serial` differs.
    statics = ("flip_normals", "normals", "serial")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.serial = next(SERIAL)
        self.normals = props.string("normals", "smooth", choices=("smooth", "analytic"))
        if ("filename" in props) == ("grid" in props):
            raise props.error("grid", "or 'filename' must be given, and not both")
        try:
            if "filename" in props:
                values = read_volume(resolve(props.string("filename")))
            else:
                values = samples(props.raw("grid"))
            self._index(values)
        except FileError as error:
            raise FileError(f"{props.node}: {error}") from None
        except DjptError as error:
            raise props.error("grid", str(error)) from None
        self.grid = TensorXf(np.ascontiguousarray(values[..., None]))

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        if self.motion is None:
            callback.put("to_world", self.to_world)
        callback.put("grid", self.grid)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        if "grid" in keys:
            self._index(samples(self.grid))

    # ---- on the host ---------------------------------------------------------------

    def _index(self, values: NDArray[np.float32]) -> None:
        """Compute all that is derived from the samples, (Z, Y, X)."""
        corners = [values[k : k - 1 or None, j : j - 1 or None, i : i - 1 or None] for k, j, i in CORNERS]
        if corners[0].size > MOST_CELLS:
            raise ParameterError(f"has {corners[0].size} cells; at most {MOST_CELLS} are possible")
        filled = (np.minimum.reduce(corners) <= 0) & (np.maximum.reduce(corners) >= 0)
        if not filled.any():
            raise ParameterError("has no surface: all values have the same sign")
        counts = np.array(filled.shape[::-1])
        # Nothing of the surface is outside of the filled cells.
        where = np.nonzero(filled)[::-1]
        low = np.array([w.min() for w in where]) / counts
        self.box = (low, np.array([w.max() + 1 for w in where]) / counts)
        # Along an axis the interpolant is as steep as the steepest of a cell's four edges.
        steep = [np.abs(np.diff(values.astype(np.float64), axis=2 - axis)) * counts[axis] for axis in range(3)]
        per_cell = [np.maximum.reduce(list(around(s, 2 - axis))) ** 2 for axis, s in enumerate(steep)]
        self.slope = 1.0001 * float(np.sqrt(sum(per_cell).max()))
        self.steps = int(256 * np.linalg.norm(counts)) + 1

        flat = np.stack(corners, axis=-1).astype(np.float32)
        # Packet gathers need a buffer of its own, aligned.
        self.cells = Float(flat.ravel()) + dr.opaque(Float, 0)
        self.counts = [dr.opaque(Int32, int(n)) for n in counts]
        dr.eval(self.cells)

    # ---- in kernels ----------------------------------------------------------------

    def _cell(self, p: Point3f) -> tuple[list[Int32], list[Float]]:
        """The cell around a local point, and the point's place in it, from 0 to 1."""
        index, place = [], []
        for k in range(3):
            scaled = p[k] * Float(self.counts[k])
            i = dr.clip(Int32(dr.floor(dr.detach(scaled))), 0, self.counts[k] - 1)
            index.append(i)
            place.append(scaled - Float(i))
        return index, place

    def _corners(self, index: Sequence[Int32]) -> list[Float]:
        """The samples at the corners of a cell in the order of CORNERS."""
        nx, ny, _ = self.counts
        at = UInt32((index[2] * ny + index[1]) * nx + index[0]) * 2
        lower, upper = dr.gather(Array4f, self.cells, at), dr.gather(Array4f, self.cells, at + 1)
        return [*lower, *upper]

    def field(self, p: Point3f) -> Float:
        index, (x, y, z) = self._cell(p)
        f = self._corners(index)
        rows = [mix(f[i], f[i + 1], x) for i in range(0, 8, 2)]
        return mix(mix(rows[0], rows[1], y), mix(rows[2], rows[3], y), z)

    def geometric_normal(self, p: Point3f) -> Vector3f:
        """The unit normal in world space: the direction of the gradient, reversed by `flip_normals`."""
        n = dr.normalize(self.normal_to_world(gradient(self.field, self.local_point(p))))
        return -n if self.flip_normals else n

    def normal_at(self, p: Point3f) -> Vector3f:
        if self.normals == "analytic":
            return self.geometric_normal(p)
        n = self.normal_to_world(self._smooth(self.local_point(p)))
        length = dr.squared_norm(n)
        n = dr.select(length > 0, n * dr.rsqrt(length), Vector3f(0, 0, 1))
        return -n if self.flip_normals else n

    def frame_at(self, p: Point3f, d: Vector3f | None = None) -> tuple[Vector3f, Frame3f]:
        return self.geometric_normal(p), Frame3f.from_normal(self.normal_at(p))

    def tangent_at(self, p: Point3f) -> Vector3f:
        return coordinate_system(self.normal_at(p))[0]

    def uv(self, p: Point3f) -> Point2f:
        return Point2f(0)

    def partials(self, p: Point3f) -> tuple[Vector3f, Vector3f]:
        return Vector3f(0), Vector3f(0)

    def _smooth(self, p: Point3f) -> Vector3f:
        """The blended unit gradients of the eight cells around the nearest grid point.

        The component of a cell's gradient along an axis is the difference over the cell, interpolated at the point's
        place along the other axes.
        """
        index, place = self._cell(p)
        f = self._corners(index)
        low, high, weight, present = [], [], [], []
        for a in range(3):
            scaled = p[a] * Float(self.counts[a])
            first = Int32(dr.round(scaled)) - 1
            present.append(first >= 0)
            weight.append(dr.select(present[a], scaled - Float(first) - 0.5, 1))
            # The point's own cell is the lower or the upper of the two along this axis; the other one is its neighbour.
            upper = index[a] != first
            neighbour = index[a] + dr.select(upper, Int32(-1), Int32(1))
            exists = (neighbour >= 0) & (neighbour < self.counts[a])
            there = list(index)
            there[a] = dr.select(exists, neighbour, index[a])
            own = difference(f, place, a) * Float(self.counts[a])
            beside = difference(self._corners(there), place, a) * Float(self.counts[a])
            beside = dr.select(exists, beside, 0)
            low.append(dr.select(upper, beside, own))
            high.append(dr.select(upper, own, beside))
        total = Vector3f(0)
        for corner in itertools.product((0, 1), repeat=3):
            g = Vector3f(*(high[a] if corner[a] else low[a] for a in range(3)))
            share = Float(1)
            for a in range(3):
                share = share * (weight[a] if corner[a] else dr.select(present[a], 1 - weight[a], 0))
            length = dr.squared_norm(g)
            total += dr.select(length > 0, g * (share * dr.rsqrt(length)), 0)
        return total


CORNERS = tuple(itertools.product((0, 1), repeat=3))
"""The corners of a cell as (z, y, x); x runs fastest."""


def mix(a: Float, b: Float, t: Float) -> Float:
    """Interpolate from `a` at t = 0 to `b` at t = 1, both reached exactly."""
    return dr.fma(b, t, dr.fma(-a, t, a))


def difference(f: Sequence[Float], place: Sequence[Float], axis: int) -> Float:
    """The difference of the corners' values along `axis`, interpolated along the other axes."""
    stride = 1 << axis
    edges = [f[i + stride] - f[i] for i in range(8) if not i & stride]
    b, c = (k for k in range(3) if k != axis)
    return mix(mix(edges[0], edges[1], place[b]), mix(edges[2], edges[3], place[b]), place[c])


def around(edges: NDArray[np.float64], axis: int) -> list[NDArray[np.float64]]:
    """Gather the values of the four edges along `axis` of each cell, from an array of values on edges."""
    b, c = (k for k in range(3) if k != axis)
    result = []
    for i, j in itertools.product((0, 1), repeat=2):
        part: list[slice] = [slice(None)] * 3
        part[b], part[c] = slice(i, i - 1 or None), slice(j, j - 1 or None)
        result.append(edges[tuple(part)])
    return result


def samples(value: Any) -> NDArray[np.float32]:
    """Convert a grid to float32 (Z, Y, X); raise `ParameterError` if it can't be used."""
    try:
        array = np.array(value, dtype=np.float32)
    except (TypeError, ValueError):
        raise ParameterError(f"must be numbers, found {describe(value)}") from None
    if array.ndim == 4 and array.shape[3] == 1:
        array = array[..., 0]
    if array.ndim != 3 or min(array.shape) < 2:
        raise ParameterError(f"must have the shape (Z, Y, X, 1) with at least 2 samples each, found {array.shape}")
    if not np.isfinite(array).all():
        raise ParameterError("must be finite")
    return array


def read_volume(path: Path) -> NDArray[np.float32]:
    """Read a file of one channel in Mitsuba's volume format, (Z, Y, X); its box isn't used."""
    grid = VolumeGrid(path)
    if grid.channel_count() != 1:
        raise FileError(f"'{path}' must hold one number at each point, found {grid.channel_count()}")
    return grid.voxels()[..., 0]


register_shape("sdfgrid", SDFGrid)

"""Volumes given by numbers on a grid."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from drjit.scalar import Array3i as ScalarArray3i
from numpy.typing import NDArray

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.color import LUMINANCE
from djpt.core.limits import LARGEST
from djpt.core.transforms import ScalarTransform4f, as_transform
from djpt.description.files import resolve
from djpt.description.plugin import HIDDEN, ParamFlags, TraversalCallback
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_volume
from djpt.dispatch.tables import entry_at
from djpt.errors import ArgumentError, SceneError
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float, as_vector, lerp, maximum
from djpt.jit.types import Bool, Color3f, Float, Point3f, TensorXf, UInt32, Vector3f
from djpt.textures.texels import WRAP_MODES, mean_texel, numbers_of, wrapped
from djpt.volumes.base import Volume
from djpt.volumes.volume_grid import VolumeGrid, as_grid, read_openvdb

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["GridVolume", "as_voxels", "check_voxels", "load_voxels", "maxima_of_cells"]


class GridVolume(Volume):
    """Numbers on a grid of X x Y x Z points; point (i, j, k) lies at ((i + 0.5) / X, (j + 0.5) / Y, (k + 0.5) / Z).

    Parameters: one of

    * `filename`: a file in Mitsuba's format (``.vol``), or one of OpenVDB (``.vdb``), of
      which `grid_name` chooses a grid (default: 'density', or the only one);
    * `grid`: a `djpt.VolumeGrid`;
    * `data`: a tensor or an array, (Z, Y, X) or (Z, Y, X, C) with C = 1, 3 or 6 channels;

    and `filter_type` between points ('trilinear', default, or 'nearest'), `wrap_mode` outside of the grid ('clamp',
    default, 'repeat' or 'mirror'), `to_world` (default: the grid fills the unit cube), `use_grid_bbox` (default false;
    true: the grid fills the box that its file gives, before `to_world`), `max_value` (the result of `max`; default: the
    largest number), `raw` and `accel` (no effect: numbers are never converted).

    The parameter `data` is a `TensorXf` (Z, Y, X, C), differentiable; an edit may change its size. `to_world` can be
    edited, too.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(
        ("grid_x", "grid_y", "grid_z", "grid_origin", "counts", "average"), HIDDEN
    )
    tables: ClassVar[Mapping[str, ParamFlags]] = {"data": ParamFlags.Differentiable}
    children: ClassVar[Sequence[str]] = ()
    statics: ClassVar[Sequence[str]] = ("channels", "filter_type", "wrap_mode")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.filter_type = props.string("filter_type", "trilinear", choices=("trilinear", "nearest"))
        self.wrap_mode = props.string("wrap_mode", "clamp", choices=WRAP_MODES)
        props.boolean("raw", False)
        props.boolean("accel", True)
        self._fixed_max = props.float("max_value") if "max_value" in props else None
        # In kernels, a `djpt.dispatch.tables.Table` stands in place of the tensor.
        self.data: Any
        self.data, box = load_voxels(props)
        self._box = ScalarTransform4f()
        if props.boolean("use_grid_bbox", False):
            if box is None:
                raise props.error("use_grid_bbox", "needs a 'filename' or a 'grid': 'data' has no bounding box")
            self._box = ScalarTransform4f().translate(box.min).scale(box.extents())
        self.channels = int(self.data.shape[3])
        self._allowed = Allowed()
        self._place()

    def move_into(self, frame: Frame) -> None:
        self.to_world = frame.moved(self.to_world)
        self._place()

    # ---- on the host -------------------------------------------------------------------

    def placement(self) -> ScalarTransform4f:
        return self.to_world @ self._box

    def _place(self) -> None:
        """Compute what kernels know of the grid as a whole: the map to its points, and their counts."""
        resolution = np.array(self.data.shape[2::-1], np.float64)
        matrix = resolution[:, None] * self.placement().inverse().matrix[:3]
        self.grid_x, self.grid_y, self.grid_z = (as_vector(row[:3]) for row in matrix)
        self.grid_origin = as_vector(matrix[:, 3])
        self.counts = as_vector(resolution)
        if not recording():
            average = mean_texel(numbers_of(self.data).reshape(-1, 1, self.channels))
            shares = self._shares()
            self.average = as_float(sum(float(x) * share for x, share in zip(average, shares, strict=True)))

    def _shares(self) -> Sequence[float]:
        """The weights of the channels in a single number."""
        return {1: (1.0,), 3: LUMINANCE, 6: (1 / 6,) * 6}[self.channels]

    def resolution(self) -> ScalarArray3i:
        z, y, x, _ = self.data.shape
        return ScalarArray3i(x, y, z)

    def channel_count(self) -> int:
        return self.channels

    @property
    def is_grey(self) -> bool:
        return self.channels == 1

    def max(self) -> float:
        return float(numbers_of(self.data).max()) if self._fixed_max is None else self._fixed_max

    def mean(self) -> Float:
        return self.average

    def max_per_channel(self) -> list[float]:
        found: list[float] = numbers_of(self.data).max(axis=(0, 1, 2)).tolist()
        return found

    def cell_maxima(self, counts: Sequence[int]) -> NDArray[np.float32]:
        """The largest numbers in the cells of a coarser grid over the same box, all channels taken together.

        Args:
            counts: the numbers of cells along x, y and z.

        Returns:
            (Z, Y, X): the maximum of what lookups within each cell can read.
        """
        return maxima_of_cells(numbers_of(self.data).max(axis=3), counts, self.wrap_mode)

    def restrict(self, allowed: Allowed, where: str) -> None:
        allowed.require(numbers_of(self.data), where)
        self._allowed = self._allowed.within(allowed)

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("data", self.data, ParamFlags.Differentiable)
        callback.put("to_world", self.to_world)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name == "to_world":
            return as_transform(value)
        voxels = as_voxels(value)
        if voxels.shape[3] != self.channels:
            raise SceneError(f"must keep its {self.channels} channels, found {voxels.shape[3]}")
        if not recording():
            check_voxels(numbers_of(voxels))
            self._allowed.require(numbers_of(voxels))
        return voxels

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self._place()

    # ---- in kernels --------------------------------------------------------------------

    def eval(self, it: Any, active: Bool | bool = True) -> Color3f:
        return self._colour(self._lookup(it, active))

    def eval_1(self, it: Any, active: Bool | bool = True) -> Float:
        """The number; of three channels the luminance, of six the mean, as in Mitsuba."""
        return self._number(self._lookup(it, active))

    def eval_3(self, it: Any, active: Bool | bool = True) -> Vector3f:
        self._require(3)
        return self._lookup(it, active)

    def eval_6(self, it: Any, active: Bool | bool = True) -> list[Float]:
        self._require(6)
        return self.eval_n(it, active)

    def eval_n(self, it: Any, active: Bool | bool = True) -> list[Float]:
        found = self._lookup(it, active)
        return [found] if self.channels == 1 else list(found)

    def eval_gradient(self, it: Any, active: Bool | bool = True) -> tuple[Color3f, Vector3f]:
        """The number at `it.p` as a grey, and the derivative of the interpolation by the point; for one channel."""
        self._require(1)
        (x, y, z), corners = self._corners(it, active)
        low, high = ([lerp(a, b, x) for a, b in zip(half[::2], half[1::2], strict=True)] for half in halves(corners))
        by_x = [b - a for a, b in zip(corners[::2], corners[1::2], strict=True)]
        steps = (
            lerp(lerp(by_x[0], by_x[1], y), lerp(by_x[2], by_x[3], y), z),
            lerp(low[1] - low[0], high[1] - high[0], z),
            lerp(high[0], high[1], y) - lerp(low[0], low[1], y),
        )
        if self.filter_type == "nearest":
            steps = (Float(0),) * 3
        # The chain rule: rows are derivatives of grid coordinates by the point.
        rows = (self.grid_x, self.grid_y, self.grid_z)
        return Color3f(self._lookup(it, active)), sum((r * s for r, s in zip(rows, steps, strict=True)), Vector3f(0))

    def pick(self, it: Any, u: Float, active: Bool | bool = True) -> Color3f:
        return self._colour(self._one(it, u, active))

    def pick_1(self, it: Any, u: Float, active: Bool | bool = True) -> Float:
        return self._number(self._one(it, u, active))

    def _require(self, channels: int) -> None:
        if self.channels != channels:
            raise self.unknown(f"{self.channels} channels, not {channels}")

    def _colour(self, entry: Any) -> Color3f:
        if self.channels == 6:
            raise self.unknown("six channels, which are no colour; use eval_6 or eval_n")
        return Color3f(entry)

    def _number(self, entry: Any) -> Float:
        if self.channels == 1:
            return entry
        return sum((entry[c] * share for c, share in enumerate(self._shares())), Float(0))

    def _grid_point(self, p: Point3f) -> Vector3f:
        """The coordinates of a point in the world, in which the grid's points have the distance 1."""
        o = self.grid_origin
        rows = ((self.grid_x, o.x), (self.grid_y, o.y), (self.grid_z, o.z))
        return Vector3f(*(dr.fma(r.x, p.x, dr.fma(r.y, p.y, dr.fma(r.z, p.z, start))) for r, start in rows))

    def _lookup(self, it: Any, active: Bool | bool) -> Any:
        """The entry at a point of the world."""
        if self.filter_type == "nearest":
            return self._entry(dr.floor(self._grid_point(it.p)), active)
        share, corners = self._corners(it, active)
        for t in share:
            corners = [lerp(a, b, t) for a, b in zip(corners[::2], corners[1::2], strict=True)]
        return corners[0]

    def _corners(self, it: Any, active: Bool | bool) -> tuple[Vector3f, list[Any]]:
        """The eight entries about a point, x running fastest, and where it lies between them."""
        place = self._grid_point(it.p) - 0.5
        first = dr.floor(place)
        near = [[wrapped(first[k] + step, self.counts[k], self.wrap_mode) for step in range(2)] for k in range(3)]
        corners = [self._at(x, y, z, active) for z, y, x in itertools.product(near[2], near[1], near[0])]
        # Infinite places, too, need a fraction: NaN would spread.
        return Vector3f(*(maximum(place[k] - first[k], Float(0)) for k in range(3))), corners

    def _one(self, it: Any, u: Float, active: Bool | bool) -> Any:
        """One of the eight entries about a point, each with its weight in the interpolation as its probability."""
        place = self._grid_point(it.p)
        if self.filter_type == "trilinear":
            steps = []
            for x in place - 0.5:
                low = dr.floor(x)
                share = x - low
                up = u < share
                # What is left of the number is uniform again.
                u = dr.select(up, u, u - share) * dr.rcp(dr.select(up, share, 1 - share))
                steps.append(dr.select(up, low + 1, low))
            place = Vector3f(*steps)
        else:
            place = dr.floor(place)
        return self._entry(place, active)

    def _entry(self, place: Vector3f, active: Bool | bool) -> Any:
        """The entry of a grid point with whole coordinates, which may lie outside."""
        x, y, z = (wrapped(place[k], self.counts[k], self.wrap_mode) for k in range(3))
        return self._at(x, y, z, active)

    def _at(self, x: UInt32, y: UInt32, z: UInt32, active: Bool | bool) -> Any:
        width, height = UInt32(self.counts.x), UInt32(self.counts.y)
        return entry_at(self.data, dr.fma(dr.fma(z, height, y), width, x), active)


def halves(corners: list[Any]) -> tuple[list[Any], list[Any]]:
    """The entries with small z, and those with large z."""
    return corners[:4], corners[4:]


register_volume("gridvolume", GridVolume)


def maxima_of_cells(numbers: NDArray[np.float32], counts: Sequence[int], wrap_mode: str) -> NDArray[np.float32]:
    """The maxima of a grid over the cells of a coarser one.

    Args:
        numbers: (Z, Y, X).
        counts: the numbers of cells along x, y and z, over the same box.
        wrap_mode: what lies beyond the border: 'clamp', 'repeat' or 'mirror'.

    Returns:
        (counts[2], counts[1], counts[0]): the maximum of all numbers that interpolation within the cell reads.
    """
    for axis, count in enumerate(reversed(counts)):
        size = numbers.shape[axis]
        slabs = [numbers.take(points(k, count, size, wrap_mode), axis).max(axis) for k in range(count)]
        numbers = np.stack(slabs, axis)
    return numbers


def points(k: int, count: int, size: int, wrap_mode: str) -> NDArray[np.int64]:
    """The numbers of the points along an axis that interpolation reads within cell k of `count`."""
    # Kernels compute in single precision: places on a border may belong to either cell.
    margin = 1e-5 * size
    first = int(np.floor(k / count * size - 0.5 - margin))
    last = int(np.floor((k + 1) / count * size - 0.5 + margin)) + 1
    found = np.arange(first, last + 1)
    if wrap_mode == "repeat":
        return found % size
    if wrap_mode == "mirror":
        found = found % (2 * size)
        return np.minimum(found, 2 * size - 1 - found)
    return np.clip(found, 0, size - 1)


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
    with props.naming(key):
        if key == "data":
            voxels = as_voxels(props.raw(key))
        else:
            source = read_grid(props) if key == "filename" else props.raw(key)
            grid = source if isinstance(source, VolumeGrid) else VolumeGrid(source)
            voxels, box = as_voxels(grid.voxels()), grid.bbox()
        check_voxels(numbers_of(voxels))
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

"""Light from a picture of the surroundings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.color import LUMINANCE
from djpt.core.frame import Frame3f
from djpt.core.numeric import non_negative
from djpt.core.records import DirectionSample3f, EmissionSample, EmitterFlags, Observer, Ray3f, SurfaceInteraction3f
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.description.plugin import HIDDEN, ParamFlags, TraversalCallback
from djpt.description.properties import LARGEST, Allowed, Properties
from djpt.description.registry import register_emitter
from djpt.dispatch.tables import entry_at
from djpt.distributions import Hierarchical2D
from djpt.distributions.grids import luminance, side_by_side
from djpt.distributions.hierarchical_2d import place_in_cell
from djpt.emitters.base import InfiniteEmitter, beam
from djpt.emitters.extent import number
from djpt.emitters.oriented import OrientedEmitter
from djpt.errors import ParameterError, SceneError
from djpt.jit.frozen import recording
from djpt.jit.kernels import aligned_floats, lerp, maximum, minimum
from djpt.jit.types import Array4f, Bool, Color3f, Float, Int32, Normal3f, Point2f, TensorXf, UInt32, Vector3f
from djpt.textures.texels import as_texels, check_texels, load_texels, numbers_of

__all__ = ["EnvironmentMap"]

INV_PI = 1 / math.pi
SPHERE = 2 * math.pi**2
"""Area of the (phi, theta) rectangle: solid angle is this times sin(theta) times area of the unit square."""
LEAST_SINE = 2.0**-24


class EnvironmentMap(InfiniteEmitter, OrientedEmitter):
    """Radiance from infinity as a picture in latitude and longitude.

    L(d) = scale data(u, v) with d = (sin(phi) sin(theta), cos(theta), -cos(phi) sin(theta)), phi = 2 pi u and
    theta = pi v in the light's space; +y is up, at the picture's top. Of W x H texels, (i, j) lies at
    u = (i + 0.5) / W, v = j / (H - 1), and between them radiance is interpolated bilinearly. Directions are
    sampled by luminance times sin(theta), likewise interpolated: see `djpt.distributions.Hierarchical2D`.

    Parameters: one of

    * `filename`: an exr, hdr, pfm, npy, png or jpg file (8-bit images are sRGB);
    * `bitmap`: an image in memory (Mitsuba's `Bitmap`, `djpt.Image`, a NumPy array; bytes are sRGB);
    * `data`: radiance (W m^-2 sr^-1), (H, W, 3) or grey, (H, W) or (H, W, 1);

    and `scale` (default 1, not negative), `to_world` (a rotation or reflection, default identity),
    `mis_compensation` (default false; true samples only what is brighter than the average: O. Karlik et al., "MIS
    Compensation: Optimizing Sampling Techniques in Multiple Importance Sampling", SIGGRAPH Asia 2019; not for
    integrators that only sample lights). Negative radiance, which filters leave in some files, is taken as it is,
    and sampled by its magnitude; a black sky is sampled uniformly. Of an image that is smaller than 2 x 3 texels the
    last column and the last row are repeated.

    The parameter `data` is a `TensorXf` (H, W + 2, 3), as in Mitsuba 3.9: the first column repeats the last texels,
    and the last column the first ones. These two are never read, so they have no gradients; `update` renews them
    unless `data` is attached. An edit may change the size.
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {
        **OrientedEmitter.values,
        "scale": ParamFlags.Differentiable,
        **dict.fromkeys(("columns", "rows", "center", "radius"), HIDDEN),
    }
    tables: ClassVar[Mapping[str, ParamFlags]] = {
        "data": ParamFlags.Differentiable | ParamFlags.Discontinuous,
        "texels": HIDDEN,
    }
    motion_flags = ParamFlags.Differentiable
    m_flags = int(EmitterFlags.Infinite | EmitterFlags.SpatiallyVarying)
    shares_lookup = True
    children = ("distribution", "ray_distribution")

    ray_distribution: Hierarchical2D | None = None
    """With `mis_compensation`, the distribution of emitted rays: they must find what compensation leaves out."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.mis_compensation = props.boolean("mis_compensation", False)
        self.scale: Any = Float(props.float("scale", 1.0, low=0.0))
        # In kernels a `djpt.dispatch.tables.Table` stands in its place.
        self.data: Any = with_halo(padded(load_texels(props, raw=False)))
        self.distribution = Hierarchical2D()
        if self.mis_compensation:
            self.ray_distribution = Hierarchical2D()
        try:
            check_radiance(self.data)
        except SceneError as error:
            key = next(key for key in ("filename", "bitmap", "data") if key in props)
            raise props.error(key, str(error)) from None
        self._measure()

    # ---- on the host -------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.share, attribute="share")
        callback.put("scale", self.scale, self.values["scale"])
        callback.put("data", self.data, self.tables["data"])
        callback.put("to_world", self.placing, self.motion_flags)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name == "scale":
            if not recording():
                non_negative(number(value) if dr.is_array_v(value) else value)
            return value
        if name != "data":
            return super().check_parameter(name, value)
        try:
            texels = as_texels(value)
            if texels.shape[2] != 3:
                raise SceneError(f"must have 3 channels, found {texels.shape[2]}")
            if not recording():
                check_texels(numbers_of(texels))
                check_radiance(texels)
        except SceneError as error:
            raise ParameterError(f"{self.id()}.data: {error}") from None
        return texels

    def parameters_changed(self, keys: Sequence[str]) -> None:
        super().parameters_changed(keys)
        if "data" in keys:
            if not recording() and not dr.grad_enabled(self.data):
                self.data = with_halo(texels_of(self.data))
            self._measure()

    def _measure(self) -> None:
        """Compute what kernels read besides the texels: counts, densities and the table of both."""
        rows, columns = self.data.shape[0], self.data.shape[1] - 2
        if recording():
            self._measure_recorded(rows, columns)
            return
        self.rows, self.columns = dr.opaque(UInt32, rows), dr.opaque(UInt32, columns)
        texels = numbers_of(self.data)[:, 1:-1]
        magnitudes = np.abs(texels)
        self._mean = mean_over_sphere(magnitudes)
        weights = luminance(magnitudes)
        everywhere = corner_weights(weights)
        if not everywhere.any():  # a black sky is sampled, too, until a script makes it brighter
            everywhere = corner_weights(np.ones_like(weights))
        self.distribution.set(everywhere)
        if self.ray_distribution is not None:
            self.ray_distribution.set(everywhere)
            bright = corner_weights(without_average(weights))
            if bright.any():
                self.distribution.set(bright)
        # Radiance with the density of `distribution` at the texels: a lookup gives both.
        self.texels = TensorXf(side_by_side(texels, self.distribution.at_corners[:, :-1]))

    def _measure_recorded(self, rows: int, columns: int) -> None:
        """The same by kernels, since `dr.freeze` records them, in single precision; the mean stays what it was."""
        with dr.suspend_grad():
            corner = dr.arange(UInt32, rows * (columns + 1))
            row, column = corner // (columns + 1), corner % (columns + 1) % columns
            texel = dr.gather(Color3f, dr.detach(self.data).array, row * (columns + 2) + column + 1)
            sines = dr.select(row == rows - 1, 0, dr.sin(Float(row) * (math.pi / (rows - 1))))
            red, green, blue = LUMINANCE
            brightness = red * dr.abs(texel.x) + green * dr.abs(texel.y) + blue * dr.abs(texel.z)
            everywhere = brightness * sines
            weights = dr.select(dr.sum(everywhere) > 0, everywhere, sines)
            bright = weights
            if self.ray_distribution is not None:
                self.ray_distribution.set_recorded(weights, rows - 1, columns)
                inner = dr.select(corner % (columns + 1) < columns, brightness, 0)
                average = dr.sum(inner) / (rows * columns)
                rest = maximum(brightness - average, Float(0)) * sines
                uneven = (average - dr.min(brightness) > 0.01 * average) & (dr.sum(rest) > 0)
                bright = dr.select(uneven, rest, weights)
            density = self.distribution.set_recorded(bright, rows - 1, columns)
            inside = dr.arange(UInt32, rows * columns)
            row, column = inside // columns, inside % columns
            texel = dr.gather(Color3f, dr.detach(self.data).array, row * (columns + 2) + column + 1)
            here = dr.gather(Float, density, row * (columns + 1) + column)
            self.texels = TensorXf(dr.ravel(Array4f(texel.x, texel.y, texel.z, here)), (rows, columns, 4))
            dr.eval(self.texels)

    def power(self) -> float:
        return number(self.scale) * self._mean * (2 * math.pi * number(self.radius)) ** 2

    # ---- in kernels --------------------------------------------------------------------

    def eval_or_sample(
        self, si: SurfaceInteraction3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[Color3f, Float, Float, Vector3f]:
        met = ~si.is_valid()
        local = self.world_to_local(-si.wi)
        met_column, met_row, met_place = self._cell(local)
        column, row, rest = self.distribution.sample_cell(sample, active)
        column, row = dr.select(met, met_column, column), dr.select(met, met_row, row)

        # Texels are looked up once, for what the lane does: to meet the map, or to sample it.
        texels = self._four_texels(column, row)
        sampled = place_in_cell(*densities_of(texels), sample=rest)
        place = Point2f(dr.select(met, met_place.x, sampled.x), dr.select(met, met_place.y, sampled.y))
        radiance, density = self._between(texels, column, row, place)
        _, d, sin_theta = self._direction(column, row, place)
        sin_theta = dr.select(met, sine(local), sin_theta)
        pdf = density * dr.rcp(sin_theta) * (1 / SPHERE)
        weight = dr.select(density > 0, sin_theta * dr.rcp(density) * SPHERE, 0)
        return radiance, pdf, weight, self.local_to_world(d)

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        column, row, place = self._cell(self.world_to_local(-si.wi))
        return self._between(self._four_texels(column, row), column, row, place)[0]

    def eval_and_pdf(
        self, si: SurfaceInteraction3f, it: Observer, ds: DirectionSample3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        local = self.world_to_local(-si.wi)
        column, row, place = self._cell(local)
        radiance, density = self._between(self._four_texels(column, row), column, row, place)
        return radiance, density * inverse_sine(local) * (1 / SPHERE)

    def _four_texels(self, column: UInt32, row: UInt32) -> list[Array4f]:
        """The texels at the corners of a cell: upper left, upper right, lower left, lower right."""
        first = dr.fma(row, self.columns, column)
        right = dr.select(column + 1 < self.columns, first + 1, first - column)
        return [entry_at(self.texels, k) for k in (first, right, first + self.columns, right + self.columns)]

    def _between(self, texels: Sequence[Array4f], column: UInt32, row: UInt32, place: Point2f) -> tuple[Color3f, Float]:
        """Radiance, and density of `distribution`, at a place between the texels of a cell."""
        f00, f10, f01, f11 = texels
        here = lerp(lerp(f00, f10, place.x), lerp(f01, f11, place.x), place.y)
        if is_attached(self.data):
            return self._radiance(column, row, place, True), here.w
        return Color3f(here.x, here.y, here.z) * self.scale, here.w

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        local, uv, pdf, weight, radiance = self._sample(self.distribution, sample, active)
        d = self.local_to_world(local)
        if dr.grad_enabled(self.forward):
            # As the map turns, directions stay, and what they show changes.
            d = dr.detach(d)
            radiance = self._radiance(*self._cell(self.world_to_local(d)), active)
        return self.towards(it, d, uv, pdf, weight), radiance * weight

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        return self._pdf(self.distribution, ds.d, active)

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        distribution = self.ray_distribution or self.distribution
        local, uv, pdf, weight, radiance = self._sample(distribution, direction_sample, active)
        # From a disk as wide as the scene, in front of it.
        at = square_to_uniform_disk_concentric(position_sample)
        d = self.local_to_world(-local)
        # Mitsuba 3.9.1 forgets to turn the disk.
        across = self.local_to_world(Frame3f.from_normal(local).to_world(Vector3f(at.x, at.y, 0)))
        ray = Ray3f(dr.fma(across - d, self.radius, self.center), d)
        weight = weight * math.pi * dr.square(self.radius)
        return beam(ray, radiance * weight, dr.rcp(math.pi * dr.square(self.radius)), pdf, uv)

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        direction = self._pdf(self.ray_distribution or self.distribution, -d, active)
        return dr.rcp(math.pi * dr.square(self.radius)), direction

    def _pdf(self, distribution: Hierarchical2D, d: Vector3f, active: Bool | bool) -> Float:
        """The density of `_sample` per solid angle, in the direction `d` (world space) towards the light; detached."""
        local = dr.detach(self.world_to_local(d))
        density = distribution.density(*self._cell(local), active)
        return density * inverse_sine(local) * (1 / SPHERE)

    def _sample(
        self, distribution: Hierarchical2D, sample: Point2f, active: Bool | bool
    ) -> tuple[Vector3f, Point2f, Float, Float, Color3f]:
        """Sample a direction in the light's space, with its uv, density per solid angle, 1 / density, and radiance."""
        if distribution is self.distribution:
            column, row, rest = distribution.sample_cell(sample, active)
            texels = self._four_texels(column, row)
            place = place_in_cell(*densities_of(texels), sample=rest)
            radiance, density = self._between(texels, column, row, place)
        else:
            column, row, place, density = distribution.sample(sample, active)
            radiance = self._radiance(column, row, place, True)
        uv, d, sin_theta = self._direction(column, row, place)
        pdf = density * dr.rcp(sin_theta) * (1 / SPHERE)
        weight = dr.select(density > 0, sin_theta * dr.rcp(density) * SPHERE, 0)
        return d, uv, pdf, weight, radiance

    def _direction(self, column: UInt32, row: UInt32, place: Point2f) -> tuple[Point2f, Vector3f, Float]:
        """uv, local direction and sin(theta) of a place in a cell."""
        u = (Float(column) + place.x + 0.5) * dr.rcp(Float(self.columns))
        v = (Float(row) + place.y) * dr.rcp(Float(self.rows - 1))
        sin_phi, cos_phi = dr.sincos(u * (2 * math.pi))
        sin_theta, cos_theta = dr.sincos(v * math.pi)
        sin_theta = maximum(sin_theta, Float(LEAST_SINE))
        return Point2f(u, v), Vector3f(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta), sin_theta

    def _cell(self, d: Vector3f) -> tuple[UInt32, UInt32, Point2f]:
        """Column and row of the four texels about a local direction, and where it lies between them."""
        columns, last = Float(self.columns), Float(self.rows - 1)
        x = dr.fma(dr.atan2(d.x, -d.z), columns * (0.5 * INV_PI), -0.5)
        y = dr.safe_acos(d.y) * (last * INV_PI)
        x = dr.select(x < 0, x + columns, x)
        first = Point2f(minimum(dr.floor(x), columns - 1), minimum(dr.floor(y), last - 1))
        # The masked-out lanes of a packet may hold anything: no index may lead out of memory.
        return UInt32(Int32(first.x)), UInt32(Int32(first.y)), Point2f(x - first.x, y - first.y)

    def _radiance(self, column: UInt32, row: UInt32, place: Point2f, active: Bool | bool) -> Color3f:
        """The radiance at a place between the texels of a column and row and those to the right and below."""
        stride = self.columns + 2
        left = dr.fma(row, stride, column + 1)
        right = dr.select(column + 1 < self.columns, left + 1, left - column)
        f00, f10, f01, f11 = (self._texel(index, active) for index in (left, right, left + stride, right + stride))
        upper, lower = lerp(f00, f10, place.x), lerp(f01, f11, place.x)
        return lerp(upper, lower, place.y) * self.scale

    def _texel(self, index: UInt32, active: Bool | bool) -> Color3f:
        if dr.is_tensor_v(self.data):  # outside of kernels there is no table
            return dr.gather(Color3f, self.data.array, index, active)
        texel: Color3f = self.data.at(index, active)
        return texel


def densities_of(texels: Sequence[Array4f]) -> tuple[Float, Float, Float, Float]:
    """The densities at the four texels about a cell."""
    f00, f10, f01, f11 = texels
    return f00.w, f10.w, f01.w, f11.w


def inverse_sine(d: Vector3f) -> Float:
    """1 / sin(theta) of a direction in the light's space."""
    return dr.rsqrt(maximum(dr.fma(d.x, d.x, dr.square(d.z)), Float(LEAST_SINE**2)))


def sine(d: Vector3f) -> Float:
    """sin(theta) of a direction in the light's space."""
    return dr.sqrt(maximum(dr.fma(d.x, d.x, dr.square(d.z)), Float(LEAST_SINE**2)))


def is_attached(table: Any) -> bool:
    """True if what is read from a table is attached to AD leaves; outside of kernels it is a tensor."""
    return dr.grad_enabled(table) if dr.is_tensor_v(table) else table.attached


# ---- texels --------------------------------------------------------------------------------


def padded(texels: TensorXf) -> TensorXf:
    """Texels (H, W, C) as at least (3, 2, C): the last row and the last column are repeated."""
    rows, columns, _ = texels.shape
    if rows >= 3 and columns >= 2:
        return texels
    index = np.arange(math.prod(texels.shape), dtype=np.uint32).reshape(texels.shape)
    index = np.pad(index, ((0, max(3 - rows, 0)), (0, max(2 - columns, 0)), (0, 0)), mode="edge")
    return TensorXf(dr.gather(Float, texels.array, UInt32(index.ravel())), index.shape)


def with_halo(texels: TensorXf) -> TensorXf:
    """Texels (H, W, 1 or 3) as (H, W + 2, 3): three channels, and at each end a column that repeats the other end."""
    rows, columns, channels = texels.shape
    if not dr.grad_enabled(texels) and not recording():
        numbers = numbers_of(texels)
        data = aligned_floats((rows, columns + 2, 3))
        data[:, 1:-1], data[:, 0], data[:, -1] = numbers, numbers[:, -1], numbers[:, 0]
        return TensorXf(data)
    index = np.arange(rows * columns * channels, dtype=np.uint32).reshape(texels.shape)
    index = np.broadcast_to(np.concatenate([index[:, -1:], index, index[:, :1]], axis=1), (rows, columns + 2, 3))
    return TensorXf(dr.gather(Float, texels.array, UInt32(index.ravel())), index.shape)


def texels_of(data: TensorXf) -> TensorXf:
    """The texels (H, W, 3) of an image with the columns of `with_halo`."""
    return TensorXf(np.ascontiguousarray(numbers_of(data)[:, 1:-1]))


def check_radiance(data: TensorXf) -> None:
    """Raise `SceneError` unless (H, W + 2, 3) numbers are a picture that light can come from."""
    rows, columns = data.shape[0], data.shape[1] - 2
    if columns < 2 or rows < 3:
        raise SceneError(f"must have at least 2 x 3 texels, found {columns} x {rows}")
    Allowed(low=-LARGEST, high=LARGEST).require(numbers_of(data)[:, 1:-1])


def without_average(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """The weights less their average, at least 0; unchanged if all are much the same."""
    average = weights.mean()
    if average - weights.min() <= 0.01 * average:
        return weights
    return np.maximum(weights - average, 0)


def corner_weights(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """The numbers (H, W + 1) whose interpolation directions are sampled by, from the weights of texels.

    There is one more column, since the first cell begins at the centre of the first texel and the last one ends there.
    """
    weights = weights * np.sin(np.linspace(0, math.pi, len(weights)))[:, None]
    weights[-1] = 0  # pi is rounded
    return np.concatenate([weights, weights[:, :1]], axis=1)


def mean_over_sphere(texels: NDArray[Any]) -> float:
    """The average radiance over all directions and colours, of what is interpolated between texels."""
    rows = texels.shape[0]
    step = math.pi / (rows - 1)
    # Integrals of sin(theta) times the hat of each row.
    shares = np.sin(np.arange(rows) * step) * (2 * (1 - math.cos(step)) / step)
    shares[[0, -1]] = 1 - math.sin(step) / step
    return float(np.average(texels.mean(axis=(1, 2), dtype=np.float64), weights=shares))


register_emitter("envmap", EnvironmentMap)

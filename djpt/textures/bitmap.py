"""Images wrapped around surfaces."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.color import LUMINANCE
from djpt.core.warp import square_to_tent
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.distributions import DiscreteDistribution2D
from djpt.distributions.grids import luminance
from djpt.errors import SceneError
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float, lerp, maximum, minimum
from djpt.jit.types import Bool, Color3f, Float, Int32, Point2f, ScalarArray2i, UInt32, Vector2f
from djpt.textures.texels import WRAP_MODES, as_texels, check_texels, load_texels, mean_texel, numbers_of, wrapped
from djpt.textures.uv import UVTexture

if TYPE_CHECKING:
    from djpt.textures.uv import UVTexture

__all__ = ["Bitmap"]

MAX_CELLS = 2048
"""The largest number of cells along an axis."""
LOOKUPS = 4
"""The number of lookups per cell along an axis."""
LEAST = 0.01
"""The least weight of a cell, relative to the mean: lookups may miss its light."""


def cell_weights(texture: UVTexture, resolution: tuple[int, int]) -> NDArray[np.float64]:
    """The mean luminance in cells that are about as large as the texels that `to_uv` puts there.

    `resolution`: texels in a row and in a column. Every cell has some weight, since lookups may miss its light.
    """
    matrix = texture.to_uv.matrix[np.ix_([0, 1], [0, 1])]
    across = np.linalg.norm(matrix * np.array(resolution)[:, None], axis=0)
    columns, rows = (min(max(math.ceil(n - 1e-6), 1), MAX_CELLS) for n in across)
    y, x = np.indices((rows * LOOKUPS, columns * LOOKUPS)).reshape(2, -1) + 0.5
    at = SimpleNamespace(
        uv=Point2f(
            Float((x / (columns * LOOKUPS)).astype(np.float32)), Float((y / (rows * LOOKUPS)).astype(np.float32))
        )
    )
    found = np.array(dr.detach(texture.eval_1(at)), np.float64).reshape(rows, LOOKUPS, columns, LOOKUPS)
    weights: NDArray[np.float64] = np.maximum(found.mean(axis=(1, 3)), 0)
    return np.maximum(weights, LEAST * weights.mean())


# ---- the texture -----------------------------------------------------------------------------


HIDDEN = ParamFlags.NonDifferentiable


class Bitmap(UVTexture):
    """An image: texel (i, j) of W x H lies at uv = ((i + 0.5) / W, (j + 0.5) / H), the first row at small v.

    Parameters: one of

    * `filename`: a png, jpg, bmp, tga, ppm, tiff, exr, hdr, pfm or npy file;
    * `bitmap`: an image in memory (`djpt.Bitmap` or Mitsuba's, `djpt.Image`, a NumPy array; bytes are sRGB unless
      a bitmap says otherwise);
    * `data`: linear numbers, (H, W), (H, W, 1) or (H, W, 3);

    and `raw` (default false; true keeps sRGB numbers as they are: for normal maps and the like),
    `filter_type` ('bilinear', default, or 'nearest'), `wrap_mode` outside the unit square ('repeat',
    default, 'mirror' or 'clamp'), `to_uv` (see `djpt.textures.uv.UVTexture`), `format` ('auto' and 'variant'
    store single precision, 'float16' or 'fp16' rounds to half precision, 'uint8' to 8 bits) and `accel` (no effect).
    Alpha is dropped, XYZ becomes RGB.

    The parameter `data` is a `TensorXf` (H, W, C) of linear numbers and always differentiable, also
    for 8-bit images (Mitsuba keeps those as bytes unless told otherwise). An edit may change its size.
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {**UVTexture.values, "counts": HIDDEN, "average": HIDDEN}
    tables: ClassVar[Mapping[str, ParamFlags]] = {"data": ParamFlags.Differentiable}
    children = ("distribution",)
    statics = ("channels", "filter_type", "wrap_mode", "tents")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        raw = props.boolean("raw", False)
        self.filter_type = props.string("filter_type", "bilinear", choices=("bilinear", "nearest"))
        self.wrap_mode = props.string("wrap_mode", "repeat", choices=WRAP_MODES)
        precision = props.string("format", "auto", choices=("auto", "variant", "float16", "fp16", "uint8"))
        props.boolean("accel", True)
        self._allowed = Allowed()
        # In kernels, a `djpt.dispatch.tables.Table` stands in place of the tensor.
        self.data: Any = load_texels(props, raw, "float16" if precision == "fp16" else precision)
        self.distribution: DiscreteDistribution2D | None = None
        """Cells of the unit square by their brightness, if the texture is that of a light."""
        self.tents = False
        """True if the cells are texels, and the density is interpolated bilinearly between them."""
        self._sampling_copy: Bitmap | None = None
        self._measure()

    # ---- on the host -------------------------------------------------------------------

    def _measure(self) -> None:
        """Compute what kernels know of the texels as a whole: their resolution and average."""
        height, width, self.channels = self.data.shape
        self.counts = Vector2f(as_float(width), as_float(height))
        if not recording():
            colour = mean_texel(numbers_of(self.data))
            self.average = as_float(float(colour[0] if self.channels == 1 else np.dot(colour, LUMINANCE)))

    def resolution(self) -> ScalarArray2i:
        height, width, _ = self.data.shape
        return ScalarArray2i(width, height)

    def max(self) -> float:
        return float(numbers_of(self.data).max())

    def prepare_sampling(self) -> None:
        """Build the distribution: its cells are texels unless `to_uv` moves them, which Mitsuba 3.9.1 ignores."""
        height, width, _ = self.data.shape
        plain = np.array_equal(self.to_uv.matrix, np.eye(3))
        self.tents = plain and self.filter_type == "bilinear"
        weights = luminance(numbers_of(self.data)) if plain else cell_weights(self, (width, height))
        if self.distribution is None:
            self.distribution = DiscreteDistribution2D(f"{self.id()}.distribution", weights)
        else:
            self.distribution.set(weights)

    def _sampled(self) -> Bitmap | None:
        """This texture with a distribution, for calls by a script; None in kernels, where only lights have one."""
        if not (dr.is_tensor_v(self.data) and not recording()):
            return None
        if self._sampling_copy is None:
            self._sampling_copy = copy.copy(self)
            self._sampling_copy.prepare_sampling()
        return self._sampling_copy

    def parameters_changed(self, keys: Sequence[str]) -> None:
        super().parameters_changed(keys)
        self._sampling_copy = None
        if "data" in keys:
            self._measure()
        # While `dr.freeze` records, the old density stays: less fitting, but a density.
        if self.distribution is not None and {"data", "to_uv"} & set(keys) and not recording():
            self.prepare_sampling()

    def restrict(self, allowed: Allowed, where: str) -> None:
        allowed.require(numbers_of(self.data), where)
        self._allowed = self._allowed.within(allowed)

    def restrict_colors(self, allowed: Allowed, where: str) -> None:
        pixels = numbers_of(self.data)
        above = 0.0 if allowed.high is None else float(np.mean(pixels > np.float32(allowed.high)))
        if above:
            # Resampled photographs overshoot a little; Mitsuba renders them as they are.
            warnings.warn(
                f"{where} exceeds {allowed.high:g} in {100 * above:.2g} % of the image's numbers, up to "
                f"{pixels.max():.4g}: more light leaves than arrives there",
                stacklevel=2,
            )
            allowed = allowed._replace(high=None)
        self.restrict(allowed, where)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name != "data":
            return super().check_parameter(name, value)
        texels = as_texels(value)
        if texels.shape[2] != self.channels:
            raise SceneError(f"must keep its {self.channels} channels, found {texels.shape[2]}")
        if not recording():
            pixels = numbers_of(texels)
            check_texels(pixels)
            self._allowed.require(pixels)
        elif self.distribution is not None and texels.shape != self.data.shape:
            raise SceneError("must keep its size on a light while 'dr.freeze' records")
        return texels

    # ---- in kernels --------------------------------------------------------------------

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        return Color3f(self._lookup(si, active))

    def eval_3(self, si: Any, active: Bool | bool = True) -> Color3f:
        """The colour at `si`. Raises `SceneError` if the texture is grey."""
        if self.channels == 1:
            raise SceneError(
                f"{self.id()}: a grey bitmap has no three channels; use 'eval_1', or 'eval' for any texture"
            )
        return self.eval(si, active)

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        return self._scalar(self._lookup(si, active))

    def eval_1_grad(self, si: Any, active: Bool | bool = True) -> Vector2f:
        if self.filter_type == "nearest":
            return Vector2f(0)
        (s, t), corners = self._corners(si, active)
        f00, f10, f01, f11 = (self._scalar(corner) for corner in corners)
        gradient = Vector2f(lerp(f10 - f00, f11 - f01, t), lerp(f01 - f00, f11 - f10, s))
        return self.chain(gradient * self.counts)

    def has_patches(self) -> bool:
        return self.filter_type == "nearest"

    def patch(self, si: Any) -> UInt32:
        """The number of the texel; beyond the unit square each repetition has numbers of its own."""
        x, y = (UInt32(Int32(dr.floor(place))) for place in self.uv(si) * self.counts)
        return x + y * UInt32(0x9E3779B1)

    def sample_position(self, sample: Point2f, active: Bool | bool = True) -> tuple[Point2f, Float]:
        """Sample (u, v) by brightness: a cell, then a place in it, uniform or by the tent of bilinear filtering."""
        if self.distribution is None:
            like = self._sampled()
            return super().sample_position(sample, active) if like is None else like.sample_position(sample, active)
        column, row, rest = self.distribution.sample(sample, active)
        if self.tents:
            rest = square_to_tent(rest) + 0.5
        place = (Point2f(Float(column), Float(row)) + rest) * dr.rcp(self._cells())
        uv = Point2f(self._inside(place.x), self._inside(place.y))
        return uv, self.pdf_position(uv, active)

    def _inside(self, u: Float) -> Float:
        """Move a coordinate into the unit square, which tents of texels at the border reach out of."""
        if not self.tents:
            return minimum(u, Float(1 - 2.0**-24))
        if self.wrap_mode == "repeat":
            return dr.select(u < 0, u + 1, dr.select(u > 1, u - 1, u))
        return dr.select(u < 0, -u, dr.select(u > 1, 2 - u, u))

    def pdf_position(self, p: Point2f, active: Bool | bool = True) -> Float:
        if self.distribution is None:
            like = self._sampled()
            return super().pdf_position(p, active) if like is None else like.pdf_position(p, active)
        if self.tents:
            (s, t), columns, rows = self._around(p)
            f00, f10, f01, f11 = (self.distribution.density(x, y, active) for y in rows for x in columns)
            return lerp(lerp(f00, f10, s), lerp(f01, f11, s), t)
        cells = self._cells()
        column, row = (UInt32(minimum(maximum(dr.floor(p[k] * cells[k]), 0), cells[k] - 1)) for k in range(2))
        return self.distribution.density(column, row, active)

    def _cells(self) -> Vector2f:
        """The numbers of cells along u and v."""
        assert self.distribution is not None
        return Vector2f(Float(self.distribution.columns), Float(self.distribution.rows))

    def mean(self) -> Float:
        """The luminance of the average texel, as in Mitsuba."""
        return self.average

    def _scalar(self, texel: Any) -> Float:
        if self.channels == 1:
            return texel
        r, g, b = LUMINANCE
        return texel.x * r + texel.y * g + texel.z * b

    def _lookup(self, si: Any, active: Bool | bool) -> Any:
        if self.filter_type == "nearest":
            x, y = self.uv(si) * self.counts
            return self._texel(self._wrap(dr.floor(x), 0), self._wrap(dr.floor(y), 1), active)
        (s, t), (f00, f10, f01, f11) = self._corners(si, active)
        return lerp(lerp(f00, f10, s), lerp(f01, f11, s), t)

    def _corners(self, si: Any, active: Bool | bool) -> tuple[Point2f, list[Any]]:
        """The four texels about a point, and where it lies between them: along u (s) and v (t)."""
        share, columns, rows = self._around(self.uv(si))
        return share, [self._texel(x, y, active) for y in rows for x in columns]

    def _around(self, uv: Point2f) -> tuple[Point2f, list[UInt32], list[UInt32]]:
        """The shares, columns and rows of the texels about `uv`, for `_corners`."""
        place = dr.fma(uv, self.counts, -0.5)
        first = dr.floor(place)
        columns = [self._wrap(first.x + k, 0) for k in range(2)]
        rows = [self._wrap(first.y + k, 1) for k in range(2)]
        # Infinite places, too, need a fraction: NaN would spread.
        share = Point2f(*(maximum(place[k] - first[k], Float(0)) for k in range(2)))
        return share, columns, rows

    def _wrap(self, i: Float, axis: int) -> UInt32:
        """The number of a texel along an axis; `i` is whole, but may lie outside."""
        return wrapped(i, self.counts[axis], self.wrap_mode)

    def _texel(self, x: UInt32, y: UInt32, active: Bool | bool) -> Any:
        index = y * UInt32(self.counts.x) + x
        if dr.is_tensor_v(self.data):  # outside of kernels there is no table
            return dr.gather(Float if self.channels == 1 else Color3f, self.data.array, index, active)
        return self.data.at(index, active)


register_texture("bitmap", Bitmap)

"""The contract of films: which pixels exist, how samples become channels, and the sums of samples of scripts."""

from __future__ import annotations

import copy
import enum
import operator
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr

from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import ParameterError, RenderError, SceneError
from djpt.jit.types import Bool, Color3f, Float, ScalarArray2u, TensorXf, UInt32
from djpt.rfilters import Box, Gaussian, ReconstructionFilter

if TYPE_CHECKING:
    from djpt.films.image_block import ImageBlock

__all__ = ["Film", "FilmFlags"]


class FilmFlags(enum.IntFlag):
    """Properties of a film; the values are Mitsuba's."""

    Empty = 0x0
    Alpha = 0x1
    Spectral = 0x2
    Special = 0x4


class Film(Plugin):
    """A grid of pixels, of which a window is rendered, with a reconstruction filter.

    Parameters of all films: `width` (768), `height` (576), `crop_offset_x`, `crop_offset_y` (0), `crop_width`,
    `crop_height` (the whole), `sample_border` (default false: no samples outside the crop, so border pixels see
    fewer), a nested `rfilter` (default `gaussian`).
    """

    kind: ClassVar[str] = "film"

    m_flags: int = int(FilmFlags.Empty)
    """The result of `flags` unless it is overridden; scripts written for Mitsuba set it."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self._size = (props.integer("width", 768, low=1), props.integer("height", 576, low=1))
        offset = (props.integer("crop_offset_x", 0, low=0), props.integer("crop_offset_y", 0, low=0))
        size = (
            props.integer("crop_width", self._size[0]),
            props.integer("crop_height", self._size[1]),
        )
        self._require_crop(props.node, offset, size)
        self._crop_offset, self._crop_size = offset, size
        self._sample_border = props.boolean("sample_border", False)
        default = Gaussian(Properties("gaussian", f"{props.node}.rfilter", {}))
        self._image: TensorXf | None = None
        self._image_names: tuple[str, ...] = ()
        self._storage: ImageBlock | None = None
        self._names: tuple[str, ...] = ()
        self._rfilter: ReconstructionFilter = props.child("rfilter", default)

    def _require_crop(self, node: str, offset: Sequence[int], size: Sequence[int]) -> None:
        for axis in range(2):
            if size[axis] < 1 or offset[axis] + size[axis] > self._size[axis]:
                name = ("width", "height")[axis]
                place = f"{size[axis]} at offset {offset[axis]}"
                raise SceneError(
                    f"{node}: a crop of {name} {place} doesn't fit in {self._size[axis]} pixels; "
                    f"'crop_{name}' sets how many are rendered, by default all"
                )

    # ---- parameters -------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        for name in ("size", "crop_size", "crop_offset"):
            callback.put(name, getattr(self, f"_{name}"), attribute=f"_{name}")

    def check_parameter(self, name: str, value: Any) -> Any:
        try:
            pair = tuple(operator.index(x) for x in value)
        except TypeError:
            pair = ()
        if len(pair) != 2 or min(pair) < (0 if name == "crop_offset" else 1):
            raise ParameterError(f"{self.id()}.{name}: two whole numbers of pixels are expected, found {value!r}")
        return pair

    def parameters_changed(self, keys: Sequence[str] = ()) -> None:
        if "size" in keys and "crop_size" not in keys:
            # As Mitsuba does: a new size drops the crop.
            self._crop_size, self._crop_offset = self._size, (0, 0)
        self._require_crop(self.id(), self._crop_offset, self._crop_size)

    def resize(self, width: int, height: int) -> None:
        """Take a new size, without a crop."""
        self._size = self._crop_size = (width, height)
        self._crop_offset = (0, 0)

    # ---- pixels -----------------------------------------------------------------

    def size(self) -> ScalarArray2u:
        """Width and height in pixels, the crop disregarded."""
        return ScalarArray2u(*self._size)

    def crop_size(self) -> ScalarArray2u:
        """Width and height of the window that is rendered."""
        return ScalarArray2u(*self._crop_size)

    def crop_offset(self) -> ScalarArray2u:
        """Column and row of the window's first pixel."""
        return ScalarArray2u(*self._crop_offset)

    def sample_border(self) -> bool:
        """True if pixels beside the crop are sampled, as far as the filter reaches."""
        return self._sample_border

    def rfilter(self) -> ReconstructionFilter:
        """The reconstruction filter."""
        return self._rfilter

    def flags(self) -> int:
        """The `FilmFlags`."""
        return int(self.m_flags)

    def sensor_response_function(self) -> None:
        """Nothing: films of colours have no response to single wavelengths."""
        return None

    # ---- samples of scripts ----------------------------------------------------------

    def prepare(self, aovs: Sequence[str] = ()) -> int:
        """Begin an image with further channels `aovs`; returns the number of all channels.

        Raises:
            RenderError: A name appears twice.
        """
        names = (*("RGBAW" if self.m_flags & FilmFlags.Alpha else "RGBW"), *aovs)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise RenderError(f"{self.id()}: the channel '{twice[0]}' appears twice")
        self._names, self._image = names, None
        self._storage = self._block(self._crop_size, self._crop_offset, False, False, False)
        return len(names)

    def create_block(
        self,
        size: Sequence[int] = (0, 0),
        normalize: bool = False,
        borders: bool = False,
        compensate: bool = False,
    ) -> ImageBlock:
        """An empty image block with the film's channels and filter.

        Args:
            size: width and height; 0 x 0 is the crop window, widened by the filter's reach with `sample_border`.
            normalize: see `ImageBlock`.
            borders: whether it has a border for samples that reach beyond.
            compensate: see `ImageBlock`.
        """
        self._prepared()
        width, height = (int(n) for n in size)
        if (width, height) != (0, 0):
            return self._block((width, height), (0, 0), borders, normalize, compensate)
        border = borders or self._sample_border
        return self._block(self._crop_size, self._crop_offset, border, normalize, compensate)

    def base_channels_count(self) -> int:
        """The number of channels of a colour."""
        return len(self.channel_names())

    def prepare_sample(
        self,
        spec: Color3f,
        wavelengths: Any,
        nChannels: int,
        weight: Any = 1.0,
        alpha: Any = 1.0,
        active: Bool | bool = True,
    ) -> list[Float]:
        """The channels that a block stores of a colour: for films with `FilmFlags.Special` alone.

        Raises:
            RenderError: the film stores colours.
        """
        raise RenderError(f"{self.id()}: this film stores red, green and blue: pass them to ImageBlock.put")

    def _block(
        self, size: tuple[int, int], offset: tuple[int, int], border: bool, normalize: bool, compensate: bool
    ) -> ImageBlock:
        from djpt.films.image_block import ImageBlock

        options = {"border": border, "normalize": normalize, "compensate": compensate}
        return ImageBlock(size, offset, len(self._names), self._rfilter, **options)

    def _prepared(self) -> ImageBlock:
        if self._storage is None:
            raise RenderError(f"{self.id()}: the film holds no image yet: render, or call film.prepare() first")
        return self._storage

    def put_block(self, block: ImageBlock) -> None:
        """Add the sums of a block to those of the film."""
        self._prepared().put_block(block)

    def clear(self) -> None:
        """Set all sums to zero."""
        if self._storage is not None:
            self._storage.clear()

    def schedule_storage(self) -> None:
        """Let the next `dr.eval` compute the sums."""
        dr.schedule(self._prepared().tensor())

    def develop(self, raw: bool = False) -> TensorXf:
        """The image (H, W, C): sums over weights, in the channels of the pixel format and then the `aovs`.

        With `raw` the sums themselves, in the channels of `prepare`.
        """
        if self._image is not None:
            return self._raw_image() if raw else self._image
        sums = self._prepared().tensor()
        if raw:
            return sums
        height, width, count = sums.shape
        pixel = dr.arange(UInt32, width * height) * count
        values = [dr.gather(Float, sums.array, pixel + c) for c in range(count)]
        base = self._names.index("W") + 1  # red, green, blue, perhaps alpha, weight
        weight = values[base - 1]
        inverse: Any = dr.select(weight == 0, 1, dr.rcp(dr.select(weight == 0, 1, weight)))
        colors = self.channels(Color3f(*values[:3]), values[3])
        channels = [value * inverse for value in [*colors, *values[base:]]]
        image = dr.zeros(Float, width * height * len(channels))
        first = dr.arange(UInt32, width * height) * len(channels)
        for c, channel in enumerate(channels):
            dr.scatter(image, channel, first + c)
        return TensorXf(image, shape=(height, width, len(channels)))

    def _raw_image(self) -> TensorXf:
        """The kept image as sums of samples: each pixel with the weight 1."""
        assert self._image is not None
        height, width, count = self._image.shape
        colors = self.base_channels_count()
        if self.channel_names()[:3] != ("R", "G", "B") or self._image_names[:colors] != self.channel_names():
            raise RenderError(f"{self.id()}: sums of samples aren't kept: render to the pixel format rgb or rgba")
        parts = [self._image[:, :, :colors], dr.full(TensorXf, 1, (height, width, 1))]
        return dr.concat([*parts, self._image[:, :, colors:]] if count > colors else parts, axis=2)

    def developed_names(self) -> tuple[str, ...]:
        """The names of the channels of `develop`."""
        if self._image is not None:
            return self._image_names
        return (*self.channel_names(), *self._names[self._names.index("W") + 1 :])

    def bitmap(self, raw: bool = False) -> Any:
        """The result of `develop` as a `djpt.Bitmap`."""
        from djpt.images.bitmap import Bitmap  # rendering needs none

        image, names = self.develop(raw), self.developed_names()
        if raw:
            colors = self.base_channels_count()
            names = self._names or (*names[:colors], "W", *names[colors:])
        formats = Bitmap.PixelFormat
        if raw or len(names) > self.base_channels_count():
            return Bitmap(image, formats.MultiChannel, list(names))
        return Bitmap(image, getattr(formats, "".join(names)))

    def write(self, path: str | Path) -> None:
        """Write the developed image to a file."""
        raise NotImplementedError

    # ---- finished images --------------------------------------------------------------

    def keep(self, image: TensorXf, names: Sequence[str]) -> None:
        """Keep a finished image (H, W, C), for scripts that ask the film for it; `names` are those of its channels."""
        self._image, self._image_names = TensorXf(dr.detach(image)), tuple(names)

    def reserve(self, names: Sequence[str]) -> None:
        """Keep a black image if there is none: a frozen function can replace one, but not add what wasn't there."""
        if self._image is None and self._storage is None:
            width, height = self.crop_size()
            shape = (height, width, len(names))
            self.keep(TensorXf(dr.opaque(Float, 0, width * height * len(names)), shape=shape), names)

    # ---- what is rendered ---------------------------------------------------------

    @property
    def filters(self) -> bool:
        """True if samples reach neighbouring pixels."""
        return not isinstance(self._rfilter, Box)

    def unfiltered(self) -> Film:
        """A copy in which each sample belongs to the pixel that it lies on alone."""
        found = copy.copy(self)
        found._rfilter, found._sample_border = Box(Properties("box", self._rfilter.id(), {})), False
        return found

    @property
    def border(self) -> int:
        """The width, in pixels, of the border about the crop that is sampled as well (`sample_border`)."""
        # Pixels whose centres lie within the filter's radius of the crop's edge.
        return self.taps // 2 if self._sample_border else 0

    @property
    def taps(self) -> int:
        """The number of pixels per axis that one sample can reach."""
        return 2 * self._rfilter.border_size() + 1 if self.filters else 1

    def channel_names(self) -> tuple[str, ...]:
        """The names of the channels of a colour."""
        raise NotImplementedError

    def channels(self, color: Color3f, valid: Bool | Float) -> list[Float]:
        """The values that one sample stores for a colour, by channel; `valid`: whether, or how far, it is covered."""
        raise NotImplementedError

    def tangent_channels(self, color: Color3f) -> list[Float]:
        """The derivative of `channels` in the direction of a change of the colour."""
        return self.channels(color, Bool(False))

    def color_adjoint(self, channels: Sequence[Float]) -> Color3f:
        """The adjoint of `channels`: from derivatives with respect to channels to those with respect to colour."""
        raise NotImplementedError

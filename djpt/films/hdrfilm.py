"""The film: which channels it stores, and how samples become pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.color import LUMINANCE, RGB_TO_XYZ
from djpt.description.properties import Properties
from djpt.description.registry import register_film
from djpt.errors import RenderError
from djpt.films.base import Film, FilmFlags
from djpt.jit.types import Bool, Color3f, Float, TensorXf, UInt32

if TYPE_CHECKING:
    from djpt.films.image_block import ImageBlock

__all__ = ["HDRFilm"]

CHANNELS = {
    "rgb": ("R", "G", "B"),
    "rgba": ("R", "G", "B", "A"),
    "luminance": ("Y",),
    "luminance_alpha": ("Y", "A"),
    "xyz": ("X", "Y", "Z"),
    "xyza": ("X", "Y", "Z", "A"),
}
"""The names of the channels of a pixel format; A is the fraction of samples that are covered."""

ROWS = {"luminance": (LUMINANCE,), "luminance_alpha": (LUMINANCE,), "xyz": RGB_TO_XYZ, "xyza": RGB_TO_XYZ}
"""The weights of red, green and blue in each channel, for formats that don't store these three."""


# ---- the film --------------------------------------------------------------------------------


EXTENSIONS = {"openexr": ".exr", "exr": ".exr", "rgbe": ".hdr", "pfm": ".pfm"}


class HDRFilm(Film):
    """A film of linear float32 pixels.

    Every sample adds w L and w to the pixels within the filter's radius, w = the kernel at the
    distance of the pixel's centre; `develop` divides the two sums.

    Parameters: `width` (768), `height` (576), `crop_offset_x`, `crop_offset_y` (0), `crop_width`,
    `crop_height` (the whole), `pixel_format` (`rgb`, `rgba`, `luminance`, `luminance_alpha`, `xyz` or `xyza`; default
    `rgb`), `component_format` (checked, then without effect: pixels are float32), `file_format` (for `write`; all three
    in any case),
    `banner` (without effect, for scenes of older versions of Mitsuba), `sample_border`
    (default false: no samples outside the crop, so border pixels see fewer), a nested `rfilter` (default `gaussian`).

    Scripts that trace rays themselves collect samples here: `prepare`, `create_block`, `put_block`, `develop`.
    """

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.pixel_format = word(props, "pixel_format", "rgb", CHANNELS)
        word(props, "component_format", "float16", ("float16", "float32", "uint32"))
        self._extension = EXTENSIONS[word(props, "file_format", "openexr", EXTENSIONS)]
        props.boolean("banner", False)
        self.m_flags = int(FilmFlags.Alpha if CHANNELS[self.pixel_format][-1] == "A" else FilmFlags.Empty)
        self._storage: ImageBlock | None = None
        self._names: tuple[str, ...] = ()

    # ---- what is rendered ----------------------------------------------------------

    def channel_names(self) -> tuple[str, ...]:
        return CHANNELS[self.pixel_format]

    def channels(self, color: Color3f, valid: Bool | Float) -> list[Float]:
        rows = ROWS.get(self.pixel_format)
        if rows is None:
            result = [color.x, color.y, color.z]
        else:
            result = [color.x * r + color.y * g + color.z * b for r, g, b in rows]
        if self.m_flags & FilmFlags.Alpha:
            result.append(Float(valid))
        return result

    def color_adjoint(self, channels: Sequence[Float]) -> Color3f:
        rows = ROWS.get(self.pixel_format)
        if rows is None:
            return Color3f(channels[0], channels[1], channels[2])
        parts = [[weight * channel for weight in row] for row, channel in zip(rows, channels, strict=False)]
        return Color3f(*(sum(column[1:], column[0]) for column in zip(*parts, strict=True)))

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
        self._storage = self._block(self._crop_size, self._crop_offset, False, False)
        return len(names)

    def create_block(self, size: Sequence[int] = (0, 0), normalize: bool = False, borders: bool = False) -> ImageBlock:
        """An empty image block with the film's channels and filter.

        Args:
            size: width and height; 0 x 0 is the crop window, widened by the filter's reach with `sample_border`.
            normalize: see `ImageBlock`.
            borders: whether it has a border for samples that reach beyond.
        """
        self._prepared()
        width, height = (int(n) for n in size)
        if (width, height) != (0, 0):
            return self._block((width, height), (0, 0), borders, normalize)
        return self._block(self._crop_size, self._crop_offset, borders or self._sample_border, normalize)

    def _block(self, size: tuple[int, int], offset: tuple[int, int], border: bool, normalize: bool) -> ImageBlock:
        from djpt.films.image_block import ImageBlock

        return ImageBlock(size, offset, len(self._names), self._rfilter, border=border, normalize=normalize)

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

    def reserve(self, names: Sequence[str]) -> None:
        if self._storage is None:
            super().reserve(names)

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
        if self.pixel_format not in ("rgb", "rgba") or self._image_names[:colors] != self.channel_names():
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
        """Write the developed image to a file of the film's `file_format`, whose extension replaces that of `path`."""
        from djpt.images.image import write

        write(Path(str(path)).with_suffix(self._extension), self.develop(), channels=self.developed_names())


def word(props: Properties, key: str, default: str, possible: Iterable[str]) -> str:
    """The entry in lower case, which must be one of the possible words."""
    found = props.string(key, default).lower()
    return found if found in possible else props.string(key, choices=possible)


register_film("hdrfilm", HDRFilm)

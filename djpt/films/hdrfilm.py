"""The film: which channels it stores, and how samples become pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from djpt.core.color import LUMINANCE, RGB_TO_XYZ
from djpt.description.properties import Properties
from djpt.description.registry import register_film
from djpt.films.base import Film, FilmFlags
from djpt.jit.types import Bool, Color3f, Float

if TYPE_CHECKING:
    pass

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

    def write(self, path: str | Path) -> None:
        """Write the developed image to a file of the film's `file_format`, whose extension replaces that of `path`."""
        from djpt.images.image import write

        write(Path(str(path)).with_suffix(self._extension), self.develop(), channels=self.developed_names())


def word(props: Properties, key: str, default: str, possible: Iterable[str]) -> str:
    """The entry in lower case, which must be one of the possible words."""
    found = props.string(key, default).lower()
    return found if found in possible else props.string(key, choices=possible)


register_film("hdrfilm", HDRFilm)

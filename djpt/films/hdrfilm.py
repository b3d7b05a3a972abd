"""The film: which pixels exist, which channels they store, how samples become pixels."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any, ClassVar

from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_film
from djpt.errors import ParameterError, SceneError
from djpt.images.color import LUMINANCE
from djpt.rfilters import Box, Gaussian, ReconstructionFilter
from djpt.types import Bool, Color3f, Float

__all__ = ["HDRFilm"]

CHANNELS = {"rgb": ("R", "G", "B"), "rgba": ("R", "G", "B", "A"), "luminance": ("Y",)}


class HDRFilm(Plugin):
    """A film of linear float32 pixels.

    Every sample adds w L and w to the pixels within the filter's radius, w = the kernel at the
    distance of the pixel's centre; `develop` divides the two sums.

    Parameters: `width` (768), `height` (576), `crop_offset_x`, `crop_offset_y` (0), `crop_width`,
    `crop_height` (the rest), `pixel_format` (`rgb`, `rgba` or `luminance`; default `rgb`),
    `component_format` and `file_format` (checked, then without effect: `djpt.write` chooses the format
    and stores float32), `banner` (without effect, for scenes of older versions of Mitsuba), `sample_border`
    (default false: no samples outside the crop, so border pixels see fewer), a nested `rfilter` (default `gaussian`).
    """

    kind: ClassVar[str] = "film"

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.size = (props.integer("width", 768, low=1), props.integer("height", 576, low=1))
        offset = (props.integer("crop_offset_x", 0, low=0), props.integer("crop_offset_y", 0, low=0))
        size = (
            props.integer("crop_width", self.size[0] - offset[0]),
            props.integer("crop_height", self.size[1] - offset[1]),
        )
        self._require_crop(props.node, offset, size)
        self.crop_offset, self.crop_size = offset, size
        self.pixel_format = props.string("pixel_format", "rgb", choices=tuple(CHANNELS))
        props.string("component_format", "float16", choices=("float16", "float32", "uint32"))
        props.string("file_format", "openexr", choices=("openexr", "exr", "rgbe", "pfm"))
        props.boolean("banner", False)
        self.sample_border = props.boolean("sample_border", False)
        default = Gaussian(Properties("gaussian", f"{props.node}.rfilter", {}))
        self.rfilter: ReconstructionFilter = props.child("rfilter", default)

    def _require_crop(self, node: str, offset: Sequence[int], size: Sequence[int]) -> None:
        for axis in range(2):
            if size[axis] < 1 or offset[axis] + size[axis] > self.size[axis]:
                name = ("width", "height")[axis]
                place = f"{size[axis]} at offset {offset[axis]}"
                raise SceneError(f"{node}: a crop of {name} {place} doesn't fit in {self.size[axis]} pixels")

    # ---- parameters -------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        for name in ("size", "crop_size", "crop_offset"):
            callback.put(name, getattr(self, name))

    def check_parameter(self, name: str, value: Any) -> Any:
        try:
            pair = tuple(operator.index(x) for x in value)
        except TypeError:
            pair = ()
        if len(pair) != 2 or min(pair) < (0 if name == "crop_offset" else 1):
            raise ParameterError(f"{self.id}.{name}: two whole numbers of pixels are expected, found {value!r}")
        return pair

    def parameters_changed(self, keys: Sequence[str]) -> None:
        if "size" in keys and "crop_size" not in keys:
            # As Mitsuba does: a new size drops the crop.
            self.crop_size, self.crop_offset = self.size, (0, 0)
        self._require_crop(self.id, self.crop_offset, self.crop_size)

    # ---- what is rendered ----------------------------------------------------------

    @property
    def filters(self) -> bool:
        """Whether samples reach neighbouring pixels."""
        return not isinstance(self.rfilter, Box)

    @property
    def border(self) -> int:
        """The width, in pixels, of the border about the crop that is sampled as well (`sample_border`)."""
        # Pixels whose centres lie within the filter's radius of the crop's edge.
        return self.taps // 2 if self.sample_border else 0

    @property
    def taps(self) -> int:
        """The number of pixels per axis that one sample can reach."""
        if not self.filters:
            return 1
        reach = self.rfilter.reach - 0.5
        return 2 * max(0, -int(-reach // 1)) + 1

    def channel_names(self) -> tuple[str, ...]:
        """The names of the channels of a colour."""
        return CHANNELS[self.pixel_format]

    def channels(self, color: Color3f, valid: Bool) -> list[Float]:
        """The values that one sample stores for a colour, by channel."""
        if self.pixel_format == "luminance":
            result = [color.x * LUMINANCE[0] + color.y * LUMINANCE[1] + color.z * LUMINANCE[2]]
        else:
            result = [color.x, color.y, color.z]
        if self.pixel_format == "rgba":
            result.append(Float(valid))
        return result

    def tangent_channels(self, color: Color3f) -> list[Float]:
        """The derivative of `channels` in the direction of a change of the colour."""
        return self.channels(color, Bool(False))

    def color_adjoint(self, channels: Sequence[Float]) -> Color3f:
        """The adjoint of `channels`: from derivatives by the channels to those by the colour."""
        if self.pixel_format == "luminance":
            return Color3f(*(weight * channels[0] for weight in LUMINANCE))
        return Color3f(channels[0], channels[1], channels[2])


register_film("hdrfilm", HDRFilm)

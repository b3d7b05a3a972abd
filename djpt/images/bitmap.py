"""Images of any type and number of channels, as Mitsuba's `Bitmap`.

    bitmap = djpt.Bitmap("photo.jpg")
    linear = bitmap.convert(djpt.Bitmap.PixelFormat.RGB, djpt.Struct.Type.Float32, srgb_gamma=False)
    djpt.TensorXf(linear.resample((64, 64)))

Files are read and written by `djpt.images.stored`, numbers converted by `djpt.images.structs`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, overload

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.files import as_path
from djpt.core.numeric import describe
from djpt.errors import DjptError, SceneError
from djpt.images.bitmap_formats import (
    CHANNELS,
    AlphaTransform,
    BitmapKinds,
    FileFormat,
    Metadata,
    PixelFormat,
    channel_names_of,
    described,
    file_format,
    layers_of,
    obtainable,
    pixel_format_of,
)
from djpt.images.image import Image, png_address
from djpt.images.resampler import FilterBoundaryCondition, values_of
from djpt.images.resampling import lanczos, resampled, taps_between
from djpt.images.stored import Stored, format_of, load_stored, save_stored, stored_from_stream, stored_to_stream
from djpt.images.structs import Flags, Struct, Type, convert_fields
from djpt.rfilters.base import ReconstructionFilter
from djpt.version import __version__

__all__ = ["Bitmap"]

Clamp = FilterBoundaryCondition.Clamp
EVERYTHING = (-math.inf, math.inf)


class Bitmap(BitmapKinds):
    """An image: (H, W, C) numbers of one type, what they mean, and metadata.

    * ``Bitmap(pixel_format, component_format, size, channel_count=0, channel_names=())``: black, of `size` (width,
      height); only `MultiChannel` needs a count.
    * ``Bitmap(array, pixel_format=None, channel_names=())``: a copy of an array or tensor (H, W) or (H, W, C). One to
      four channels are Y, YA, RGB, RGBA unless the format says otherwise.
    * ``Bitmap(path, format=Auto)`` and ``Bitmap(stream, format=Auto)``: from a file, or a binary stream such as
      `io.BytesIO`. The type is that of the file: bytes of png and jpg, half, float or whole numbers of exr.
    * ``Bitmap(bitmap)``: a copy.

    Bytes are sRGB and other numbers linear until `set_srgb_gamma` says otherwise; colours are multiplied by alpha
    until `set_premultiplied_alpha` says otherwise. Files know better.

    NumPy and Dr.Jit read a bitmap as an array: ``numpy.array(bitmap, copy=False)`` shares its memory,
    ``TensorXf(bitmap)`` takes one of Float32.

    Raises:
        SceneError: an array of another shape or type, or names that don't fit the number of channels.
        FileError: a file that can't be read.
    """

    __hash__ = None  # type: ignore[assignment]

    _pixels: npt.NDArray[Any]
    _format: PixelFormat
    _srgb: bool
    _premultiplied: bool
    _struct: Struct
    _metadata: Metadata

    @overload
    def __init__(
        self,
        pixel_format: PixelFormat,
        component_format: Type,
        size: Any,
        channel_count: int = 0,
        channel_names: Sequence[str] = (),
    ) -> None: ...

    @overload
    def __init__(self, bitmap: Bitmap, /) -> None: ...

    @overload
    def __init__(self, path: str | os.PathLike[str], format: FileFormat = FileFormat.Auto) -> None: ...

    @overload
    def __init__(self, stream: IO[bytes], format: FileFormat = FileFormat.Auto) -> None: ...

    @overload
    def __init__(
        self, array: Any, pixel_format: PixelFormat | None = None, channel_names: Sequence[str] = ()
    ) -> None: ...

    def __init__(self, *args: Any, **keywords: Any) -> None:
        first = args[0] if args else None
        if isinstance(first, PixelFormat) or "component_format" in keywords:
            self._blank(*args, **keywords)
        elif isinstance(first, Bitmap):
            self._copy(*args, **keywords)
        elif isinstance(first, (str, os.PathLike)) or hasattr(first, "read") or {"path", "stream"} & keywords.keys():
            self._load(*args, **keywords)
        else:
            self._take(*args, **keywords)

    def _blank(
        self,
        pixel_format: PixelFormat,
        component_format: Type,
        size: Any,
        channel_count: int = 0,
        channel_names: Sequence[str] = (),
    ) -> None:
        """Make a black image."""
        width, height = (int(count) for count in size)
        names = channel_names_of(pixel_format, channel_count, channel_names)
        pixels = np.zeros((height, width, len(names)), component_format.dtype)
        self._fill(pixels, pixel_format, names, srgb=component_format is Type.UInt8)

    def _copy(self, bitmap: Bitmap) -> None:
        """Copy a bitmap."""
        self._fill(bitmap._pixels.copy(), bitmap._format, (), bitmap._srgb, bitmap._premultiplied)
        self._struct = Struct(bitmap._struct)
        self._metadata = Metadata(bitmap._metadata)

    def _load(self, path: Any = None, format: FileFormat = FileFormat.Auto, stream: IO[bytes] | None = None) -> None:
        """Read a file or a stream."""
        place = path if stream is None else stream
        if isinstance(place, (str, os.PathLike)):
            image = load_stored(as_path(place), format.suffix)
        else:
            image = stored_from_stream(place, format.suffix)
        names = image.names or CHANNELS[pixel_format_of(image.pixels.shape[2])]
        kind = next((kind for kind, usual in CHANNELS.items() if usual == names), PixelFormat.MultiChannel)
        self._fill(np.ascontiguousarray(image.pixels), kind, names, image.srgb, image.premultiplied)
        if image.names is not None:  # whole numbers of an exr are numbers, and any layer may have alpha
            for field in self._struct:
                alpha = field.name.rpartition(".")[2] in ("A", "a")
                field.flags = Flags.Alpha if alpha else Flags.PremultipliedAlpha
        self._metadata = Metadata(image.metadata)

    def _take(self, array: Any, pixel_format: PixelFormat | None = None, channel_names: Sequence[str] = ()) -> None:
        """Copy an array."""
        try:
            pixels = np.array(dr.detach(array) if dr.is_array_v(array) else array, order="C")
        except (TypeError, ValueError):
            pixels = np.empty(0)
        if pixels.ndim == 2:
            pixels = pixels[..., None]
        kind = Type.of(pixels.dtype)
        if pixels.ndim != 3 or kind is Type.Invalid or isinstance(array, (list, tuple)):
            raise SceneError(
                "a bitmap is made of an array or tensor of numbers, (height, width) or (height, width, channels); "
                f"found {describe(array)} of shape {pixels.shape}"
            )
        form = pixel_format or pixel_format_of(pixels.shape[2])
        names = channel_names_of(form, pixels.shape[2], channel_names)
        self._fill(pixels.astype(kind.dtype, copy=False), form, names, srgb=kind is Type.UInt8)

    def _fill(
        self,
        pixels: npt.NDArray[Any],
        form: PixelFormat,
        names: Sequence[str],
        srgb: bool = False,
        premultiplied: bool = True,
    ) -> None:
        """Set all that a bitmap has."""
        self._pixels = pixels
        self._format = form
        self._srgb, self._premultiplied = srgb, premultiplied
        self._struct = described(names, Type.of(pixels.dtype), form, srgb, premultiplied)
        self._metadata = Metadata()

    # ---- what they are ------------------------------------------------------------------

    def pixel_format(self) -> PixelFormat:
        """What the channels mean."""
        return self._format

    def component_format(self) -> Type:
        """The type of the numbers."""
        return Type.of(self._pixels.dtype)

    def size(self) -> Any:
        """(width, height), a `drjit.scalar.Array2u`."""
        return dr.scalar.Array2u(self.width(), self.height())

    def width(self) -> int:
        """The number of columns."""
        return self._pixels.shape[1]

    def height(self) -> int:
        """The number of rows."""
        return self._pixels.shape[0]

    def pixel_count(self) -> int:
        """The number of pixels."""
        return self.width() * self.height()

    def channel_count(self) -> int:
        """The number of channels."""
        return self._pixels.shape[2]

    def has_alpha(self) -> bool:
        """Whether the format has alpha; that of `MultiChannel` is unknown."""
        return "A" in CHANNELS.get(self._format, ())

    def bytes_per_pixel(self) -> int:
        """The bytes that a pixel takes."""
        return self.channel_count() * self._pixels.itemsize

    def buffer_size(self) -> int:
        """The bytes that all pixels take."""
        return self._pixels.nbytes

    def srgb_gamma(self) -> bool:
        """Whether colours are encoded by the curve of sRGB."""
        return self._srgb

    def set_srgb_gamma(self, value: bool) -> None:
        """Say whether colours are encoded by the curve of sRGB; changes no numbers."""
        self._srgb = value
        self._mark(Flags.Gamma, value)

    def premultiplied_alpha(self) -> bool:
        """Whether colours are multiplied by alpha."""
        return self._premultiplied

    def set_premultiplied_alpha(self, value: bool) -> None:
        """Say whether colours are multiplied by alpha; changes no numbers."""
        self._premultiplied = value
        self._mark(Flags.PremultipliedAlpha, value)

    def _mark(self, flag: Flags, value: bool) -> None:
        """Set or clear a flag of the colours."""
        for field in self._struct:
            if field.name.rpartition(".")[2] not in ("A", "W"):
                field.flags = field.flags | flag if value else field.flags & ~flag

    def metadata(self) -> Metadata:
        """Names with values, which png and exr files carry; may be changed."""
        return self._metadata

    def struct_(self) -> Struct:
        """The record of a pixel; names of fields may be changed."""
        return self._struct

    def __eq__(self, other: object) -> bool:
        """Whether all is equal: formats, pixels bit for bit, names, metadata."""
        if not isinstance(other, Bitmap):
            return NotImplemented
        return (
            self._struct == other._struct
            and (self._format, self._srgb, self._premultiplied) == (other._format, other._srgb, other._premultiplied)
            and self._pixels.shape == other._pixels.shape
            and self._pixels.tobytes() == other._pixels.tobytes()
            and self._metadata == other._metadata
        )

    def __repr__(self) -> str:
        lines = [
            f"pixel_format = {self._format.name.lower()}",
            f"component_format = {self._pixels.dtype}",
            f"size = [{self.width()}, {self.height()}]",
            f"srgb_gamma = {int(self._srgb)}",
            f"struct = {self._struct}",
        ]
        if self._metadata:
            lines.append(f"metadata = {dict(self._metadata)}")
        lines.append(f"data = [ {self.buffer_size()} bytes ]")
        text = ",\n".join(lines).replace("\n", "\n  ")
        return f"Bitmap[\n  {text}\n]"

    # ---- as an array -------------------------------------------------------------------

    @property
    def __array_interface__(self) -> dict[str, Any]:
        """The memory, for NumPy: (H, W, C), or (H, W) of one channel."""
        pixels = self._pixels[..., 0] if self.channel_count() == 1 else self._pixels
        return pixels.__array_interface__

    def __dlpack__(self, stream: Any = None, **options: Any) -> Any:
        """The memory, for Dr.Jit, PyTorch and others: (H, W, C)."""
        return self._pixels.__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        """The device of the memory: the processor."""
        return self._pixels.__dlpack_device__()

    # ---- changes in place --------------------------------------------------------------

    def clear(self) -> None:
        """Set all numbers to 0."""
        self._pixels[:] = 0

    def vflip(self) -> None:
        """Turn the image upside down."""
        self._pixels[:] = self._pixels[::-1].copy()

    def accumulate(
        self, bitmap: Bitmap, source_offset: Any = None, target_offset: Any = None, size: Any = None
    ) -> None:
        """Add a part of another bitmap of the same format and type; what lies outside is left out.

        ``accumulate(bitmap)``, ``accumulate(bitmap, target_offset)``, or with all arguments: columns and rows where
        the part begins there and here, and its width and height.
        """
        if size is None and target_offset is None:
            source_offset, target_offset = None, source_offset
        if self._kind() != bitmap._kind():
            raise SceneError(f"can't add {bitmap._kind()} to {self._kind()}: convert it first")
        here, there = self._pixels, bitmap._pixels
        slices = []
        for axis in (1, 0):  # rows, then columns
            start = int(source_offset[axis]) if source_offset is not None else 0
            place = int(target_offset[axis]) if target_offset is not None else 0
            count = int(size[axis]) if size is not None else there.shape[1 - axis]
            cut = max(0, -start, -place)
            start, place = start + cut, place + cut
            count = max(0, min(count - cut, there.shape[1 - axis] - start, here.shape[1 - axis] - place))
            slices.append((slice(place, place + count), slice(start, start + count)))
        (to_rows, from_rows), (to_columns, from_columns) = slices
        here[to_rows, to_columns] += there[from_rows, from_columns]

    def _kind(self) -> str:
        """The format, type and number of channels, for comparisons and messages."""
        return f"a bitmap of {self.channel_count()} channels {self._format.name}, {self._pixels.dtype}"

    # ---- new ones ----------------------------------------------------------------------

    def convert(
        self,
        pixel_format: PixelFormat | Bitmap | None = None,
        component_format: Type | None = None,
        srgb_gamma: bool | None = None,
        alpha_transform: AlphaTransform = AlphaTransform.Empty,
        target: Bitmap | None = None,
    ) -> Any:
        """A bitmap of another format, or of another type; what isn't given stays.

        Colours become linear numbers, are combined, encoded if asked, rounded to nearest and clipped (Mitsuba adds
        a pattern of noise before it rounds, so its whole numbers may differ by one). Whole numbers stand for shares of
        the type's largest. A weight divides. ``convert(target)`` converts into another bitmap and returns None.

        Raises:
            SceneError: a channel can't be had.
        """
        target = pixel_format if isinstance(pixel_format, Bitmap) else target
        if target is not None:
            if target._pixels.shape[:2] != self._pixels.shape[:2]:
                raise SceneError(f"can't convert {self.size()} pixels into {target.size()}")
            self._convert_into(target)
            return None
        form = self._format if not isinstance(pixel_format, PixelFormat) else pixel_format
        names = tuple(field.name for field in self._struct) if form is PixelFormat.MultiChannel else CHANNELS[form]
        kind = component_format or self.component_format()
        result = Bitmap(form, kind, (self.width(), self.height()), len(names), names)
        result.set_srgb_gamma(self._srgb if srgb_gamma is None else bool(srgb_gamma))
        transforms = {AlphaTransform.Premultiply: True, AlphaTransform.Unpremultiply: False}
        result.set_premultiplied_alpha(transforms.get(alpha_transform, self._premultiplied))
        result._metadata = Metadata(self._metadata)
        self._convert_into(result)
        return result

    def _convert_into(self, target: Bitmap, wanted: Struct | None = None) -> None:
        """Convert the pixels into those of a bitmap of the same size, whose record may say where fields come from."""
        wanted = obtainable(self._struct, target._struct, self._format) if wanted is None else wanted
        columns = {field.name: self._pixels[..., i] for i, field in enumerate(self._struct)}
        for i, column in enumerate(convert_fields(self._struct, wanted, columns).values()):
            target._pixels[..., i] = column

    def resample(
        self,
        target: Any = None,
        rfilter: ReconstructionFilter | None = None,
        bc: tuple[FilterBoundaryCondition, FilterBoundaryCondition] = (Clamp, Clamp),
        clamp: tuple[float, float] = EVERYTHING,
        temp: Bitmap | None = None,
        res: Any = None,
    ) -> Any:
        """The image in another resolution.

        Args:
            target: The width and height, or a bitmap of the same format and type, which then receives the result.
            rfilter: From ``load_dict({'type': ...})``. Default: Lanczos with two lobes.
            bc: What stands beyond the ends of rows, and of columns.
            clamp: The range that the results are clipped to.
            temp: Accepted for compatibility.
            res: Another name of `target` for a width and height.

        Returns:
            The bitmap; None if it is given as `target`.

        Raises:
            SceneError: the numbers aren't floating point, or formats differ.
        """
        place = target if isinstance(target, Bitmap) else None
        wanted = place.size() if place is not None else (target if target is not None else res)
        if self._pixels.dtype.kind != "f":
            raise SceneError(f"only floating point numbers are resampled, found {self._pixels.dtype}: convert first")
        if place is not None and place._kind() != self._kind():
            raise SceneError(f"can't resample {self._kind()} into {place._kind()}")
        sizes = [int(count) for count in wanted]
        pixels = self._pixels
        for axis, count, beyond in zip((1, 0), sizes, bc, strict=True):
            if pixels.shape[axis] != count:
                radius, box = (2.0, False) if rfilter is None else (rfilter.radius(), rfilter.is_box_filter())
                kernel = lanczos if rfilter is None else values_of(rfilter)
                try:
                    taps = taps_between(pixels.shape[axis], count, kernel, radius, box)
                except ValueError as error:
                    raise SceneError(f"resample: {error}") from None
                moved = resampled(pixels.swapaxes(0, axis), taps, beyond.name.lower(), clamp)
                pixels = moved.swapaxes(0, axis)
        if place is not None:
            place._pixels[:] = pixels
            return None
        result = Bitmap(self)
        result._pixels = np.array(pixels, order="C")
        return result

    def split(self) -> list[tuple[str, Bitmap]]:
        """The layers of a `MultiChannel` bitmap by name, sorted: channels share what stands before the last dot.

        Those without a layer are ``<root>``. A layer of colours has their format. Others are not split.
        """
        if self._format is not PixelFormat.MultiChannel:
            return [("<root>", self)]
        result = []
        for layer, (form, names) in layers_of(self._struct).items():
            part = Bitmap(form, self.component_format(), (self.width(), self.height()), len(names), tuple(names))
            part.set_srgb_gamma(self._srgb)
            part.set_premultiplied_alpha(self._premultiplied)
            wanted = Struct(part._struct)
            for field in wanted:
                field.name = names[field.name]
            self._convert_into(part, wanted)
            result.append((layer, part))
        return result

    # ---- files -------------------------------------------------------------------------

    def write(
        self,
        path: str | os.PathLike[str] | IO[bytes] | None = None,
        format: FileFormat = FileFormat.Auto,
        quality: int = -1,
        stream: IO[bytes] | None = None,
    ) -> None:
        """Write to a file or a binary stream; numbers aren't converted, so the format must hold their type.

        exr and png also get the metadata, and in `generatedBy` the version of djpt.

        Args:
            path: Of the file, which appears whole or not at all; or a stream.
            format: Default: that of the extension. Streams need one.
            quality: png: compression, 1 to 9 (default 5); jpg: 0 to 100 (default); exr: above 0, the loss of the
                compression DWAB.
            stream: Another name of `path` for streams.

        Raises:
            FileError: the format can't hold the image, or the path can't be written.
        """
        place = path if stream is None else stream
        names = tuple(field.name for field in self._struct)
        metadata = {"generatedBy": f"djpt {__version__}", **self._metadata.numbers()}
        image = Stored(self._pixels, names, metadata, self._srgb, self._premultiplied)
        if isinstance(place, (str, os.PathLike)):
            save_stored(Path(place), image, format.suffix, quality)
        elif place is None:
            raise SceneError("'write' needs a path or a stream")
        elif format.suffix is None:
            raise SceneError("a stream has no extension: give the 'format', such as Bitmap.FileFormat.PNG")
        else:
            stored_to_stream(place, image, format.suffix, quality)

    def write_async(
        self, path: str | os.PathLike[str], format: FileFormat = FileFormat.Auto, quality: int = -1
    ) -> None:
        """`write`: the file is complete on return, as no script can tell."""
        self.write(path, format, quality)

    @staticmethod
    def detect_file_format(stream: IO[bytes]) -> FileFormat:
        """The format of a binary stream by its content; `Unknown` if it has none. Moves nothing."""
        return file_format(format_of(stream))

    # ---- notebooks -----------------------------------------------------------------------

    def _repr_png_(self) -> bytes | None:
        """The image as notebooks show it; None for `MultiChannel`."""
        if self._format is PixelFormat.MultiChannel:
            return None
        try:
            shown = self.convert(PixelFormat.RGB, Type.UInt8, True)
        except DjptError:  # a notebook then shows the text
            return None
        return Image(shown._pixels)._repr_png_()

    def _repr_html_(self) -> str | None:
        """`_repr_png_` as HTML."""
        png = self._repr_png_()
        return None if png is None else f'<img src="{png_address(png)}">'

"""The pixels of a bitmap, and what is known of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import IO, Any, overload

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.files import as_path
from djpt.core.numeric import describe
from djpt.errors import SceneError
from djpt.images.bitmap_formats import CHANNELS, BitmapKinds, FileFormat, PixelFormat, pixel_format_of
from djpt.images.bitmap_layers import described
from djpt.images.metadata import Metadata
from djpt.images.stored import Stored, load_stored, stored_from_stream
from djpt.images.structs import Flags, Struct, Type

__all__ = ["BitmapData"]


class BitmapData(BitmapKinds):
    """(H, W, C) numbers of one type, with their meaning: the part of `Bitmap` that makes and describes them.

    The arguments are those of `Bitmap`.
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
    def __init__(self, bitmap: BitmapData, /) -> None: ...

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
        elif isinstance(first, BitmapData):
            self._copy(*args, **keywords)
        elif isinstance(first, (str, os.PathLike)) or "path" in keywords:
            self._read(*args, **keywords)
        elif hasattr(first, "read") or "stream" in keywords:
            self._receive(*args, **keywords)
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

    def _copy(self, bitmap: BitmapData) -> None:
        """Copy a bitmap."""
        self._fill(bitmap._pixels.copy(), bitmap._format, (), bitmap._srgb, bitmap._premultiplied)
        self._struct = Struct(bitmap._struct)
        self._metadata = Metadata(bitmap._metadata)

    def _read(self, path: str | os.PathLike[str], format: FileFormat = FileFormat.Auto) -> None:
        """Read a file."""
        self._from_file(load_stored(as_path(path), format.suffix))

    def _receive(self, stream: IO[bytes], format: FileFormat = FileFormat.Auto) -> None:
        """Read a stream."""
        self._from_file(stored_from_stream(stream, format.suffix))

    def _from_file(self, image: Stored) -> None:
        """Take what a file holds."""
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
        if not isinstance(other, BitmapData):
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


def channel_names_of(form: PixelFormat, count: int, names: Sequence[str]) -> tuple[str, ...]:
    """The names of a bitmap's channels; ch0, ch1, ... if a `MultiChannel` one has none.

    Raises:
        SceneError: the number doesn't fit the format, or names are missing or not unique.
    """
    if form is not PixelFormat.MultiChannel:
        usual = CHANNELS[form]
        if count not in (0, len(usual)):
            raise SceneError(f"the pixel format {form.name} has {len(usual)} channels, found {count}")
        return usual
    if not names:
        digits = len(str(max(1, count - 1)))
        return tuple(f"ch{i:0{digits}d}" for i in range(count))
    if len(names) != count or len(set(names)) != count:
        raise SceneError(f"{count} different channel names needed, found {list(names)}")
    return tuple(names)

"""Images: read, write, show.

`render()` returns a plain `TensorXf`, which keeps working in Dr.Jit expressions. Files are
written and read as such tensors; `Image` is only a view for notebooks and for NumPy.

    djpt.write("out.exr", image)     # exr hdr pfm npy: linear radiance, float32
    djpt.write("out.png", image)     # png jpg: 8-bit sRGB
    djpt.Image(image)                # shows itself in a notebook
"""

from __future__ import annotations

import base64
import contextlib
import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from djpt.core.files import as_path, check_target, reason, require_regular, shortened, writing
from djpt.core.limits import MAX_NUMBERS, NUMBERS_PER_BYTE
from djpt.errors import FileError, near_miss
from djpt.images.exr import RESERVED
from djpt.images.formats import (
    DISPLAY_FORMATS,
    FORMATS,
    METADATA,
    Format,
    Labels,
    encode_png,
    picture_numbers,
)
from djpt.images.srgb import from_srgb, shares, to_srgb8

if TYPE_CHECKING:
    from djpt.jit.types import TensorXf

__all__ = [
    "Image",
    "check_writable",
    "checked_labels",
    "png_address",
    "read",
    "read_metadata",
    "read_pixels",
    "reading",
    "require_modest",
    "write",
]

MOVIE_FORMATS = frozenset({".gif", ".mp4"})
"""The formats of movies, which `djpt.apps.animation` writes."""

METADATA_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.:-]{0,30}")

FULL_SIZE = frozenset({".hdr", ".pfm", ".npy"})
"""Formats whose readers compare the size in the header with that of the file: a byte stands for few numbers."""

SHOWN = 256
"""Pixels: images that notebooks show are enlarged up to this size."""


class Image:
    """A view of an image that notebooks display: `Image(djpt.render(scene))` as the last line of a cell.

    `tensor`: a `TensorXf`, a NumPy array or an `Image`, of shape (H, W) or (H, W, C). Floating
    point values are linear; `uint8` values are already sRGB. Nothing is clipped until it is shown.
    Channels mean what they mean in the file formats: 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and
    alpha; of more channels the first three are shown.
    Raises `FileError` if the shape or the type isn't an image's.
    """

    def __init__(self, tensor: Any) -> None:
        self._pixels = _pixels(tensor, "the image")

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, as `film.size`."""
        return self._pixels.shape[1], self._pixels.shape[0]

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W, C)."""
        return self._pixels.shape

    def numpy(self) -> npt.NDArray[Any]:
        """The pixels: (H, W, C), float32 (linear) or uint8 (sRGB)."""
        return self._pixels

    def srgb(self) -> npt.NDArray[np.uint8]:
        """The pixels as they are displayed: (H, W, C) bytes of sRGB; see `djpt.images.srgb.to_srgb8`."""
        shown = self._pixels if self._pixels.shape[2] <= 4 else self._pixels[..., :3]
        return shown if shown.dtype == np.uint8 else to_srgb8(shown)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """The pixels, for `numpy.asarray(image)` and `matplotlib.pyplot.imshow(image)`."""
        pixels = self._pixels if dtype is None else self._pixels.astype(dtype, copy=False)
        return pixels.copy() if copy else pixels

    def __repr__(self) -> str:
        height, width, channels = self._pixels.shape
        return f"Image({width} x {height}, {channels} channels, {self._pixels.dtype})"

    def _repr_png_(self) -> bytes:
        """The image as notebooks show it. Small ones are enlarged by a whole factor: each pixel becomes a square."""
        shown = self.srgb()
        factor = max(1, SHOWN // max(shown.shape[:2]))
        stream = io.BytesIO()
        encode_png(stream, shown.repeat(factor, axis=0).repeat(factor, axis=1))
        return stream.getvalue()


def png_address(png: bytes) -> str:
    """A PNG as an address that holds all of it, for pages that need no other file."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def write(
    path: str | os.PathLike[str],
    image: Any,
    channels: Sequence[str] | None = None,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write an image; the extension of `path` chooses the format.

    * `image`: `TensorXf`, NumPy array or `Image`; (H, W) or (H, W, C), linear values. `uint8`
      values are taken for sRGB and only accepted by the formats that hold it.
    * `exr`, `hdr` (3 channels), `pfm` (1 or 3), `npy`: linear, float32 (`hdr`: shared 8-bit exponent).
    * `png`, `tga`, `tiff`, `jpg`, `jpeg` (1 to 4 channels), `bmp` (1 or 3), `ppm` (3): 8-bit sRGB: clipped to [0, 1]
      and rounded, never dithered, so equal images give equal bytes. `jpg` drops alpha.
    * `channels`: names for the channels of an `exr`, such as those of an `aov` integrator.
      Default: Y; Y A; R G B; R G B A; otherwise C0, C1, ... Other programs take the part before the last dot
      for a layer: `albedo.R`, `albedo.G` and `albedo.B` are the layer `albedo`.
    * `metadata`: names and values that the header of an `exr` or `png` carries, as text, for `read_metadata` and for
      other programs. Names have up to 31 letters, digits and ``_ . : -``; values are strings, numbers or booleans.

    The file appears whole or not at all: a failed write leaves an old file as it was.
    Raises `FileError` for an unknown extension, a wrong shape, a path that can't be written.
    """
    target = as_path(path)
    form = check_writable(target)
    pixels = _pixels(image, f"'{target}'")
    if pixels.dtype == np.uint8 and target.suffix.lower() not in DISPLAY_FORMATS:
        suffix = target.suffix.lower()[1:]
        raise FileError(f"can't write '{target}': 8-bit pixels are sRGB, but {suffix} holds linear values")
    labels = checked_labels(target, pixels.shape[2], channels, metadata or {})
    with writing(target) as temporary:
        form.encode(temporary, pixels, labels)


def checked_labels(target: Path, count: int, channels: Sequence[str] | None, metadata: Mapping[str, Any]) -> Labels:
    """The labels that a file of `count` channels stores beside its pixels; raises `FileError` if its format can't."""
    suffix = target.suffix.lower()
    possible = FORMATS[suffix].channels
    if possible and count not in possible:
        raise FileError(
            f"can't write '{target}': {suffix[1:]} holds {_either(possible)} channels, found {count}; "
            "exr and npy hold any number"
        )
    if channels is not None:
        if suffix != ".exr":
            raise FileError(f"can't write '{target}': only exr stores the names of channels")
        if len(set(channels)) != count or len(channels) != count or any(not c or "," in c for c in channels):
            raise FileError(f"can't write '{target}': {count} different channel names needed, found {list(channels)}")
    return Labels(channels, _texts(target, metadata))


def read(path: str | os.PathLike[str]) -> TensorXf:
    """Read an image as a tensor of shape (H, W, C) with linear values.

    exr, hdr, pfm and npy are read as they are, but colours in other primaries than sRGB's are converted; png (8 and 16
    bits), jpg, bmp, tga, ppm and tiff are decoded from sRGB (alpha is linear).
    Images that `write` wrote are read back bit for bit from exr, pfm and npy, and to the nearest representable value
    from the others. Raises `FileError` if the file is missing, damaged or of an unknown format.
    """
    from djpt.jit.types import TensorXf

    return TensorXf(read_pixels(path))


def read_pixels(path: str | os.PathLike[str], raw: bool = False) -> npt.NDArray[np.float32]:
    """Read an image as a NumPy array, float32 (H, W, C), as `read` does. Needs no Dr.Jit backend.

    `raw`: leave the numbers of png and jpg encoded, in [0, 1].
    """
    source = as_path(path)
    form = _format(source, "read")
    with reading(source):
        pixels: npt.NDArray[Any] = form.decode(source)
        if pixels.dtype.kind == "u":
            return shares(pixels) if raw else from_srgb(pixels)
        return np.ascontiguousarray(pixels, np.float32)


def read_metadata(path: str | os.PathLike[str]) -> dict[str, str]:
    """Read the metadata of an `exr` or `png`: names and texts, as given to `write`.

    From files of other programs, the attributes of type string or the text chunks are read. Raises `FileError`
    as `read` does, and for formats without metadata.
    """
    source = as_path(path)
    _format(source, "read")
    decode = METADATA.get(source.suffix.lower())
    if decode is None:
        raise FileError(f"'{source}' has no metadata: only exr and png carry any")
    with reading(source):
        return decode(source)


@contextlib.contextmanager
def reading(source: Path) -> Iterator[None]:
    """Turn any exception that is raised while a file is read into a `FileError`."""
    require_regular(source)
    try:
        yield
    except Exception as error:  # decoders of damaged files raise nearly anything
        raise FileError(f"can't read '{source}': {reason(error)}") from error


def require_modest(path: Path) -> None:
    """Raise `FileError` if an image has many more numbers than its file has bytes.

    Up to `MAX_NUMBERS` are fine, and `NUMBERS_PER_BYTE` for each byte. Only the header is read.
    """
    suffix = path.suffix.lower()
    if suffix in FULL_SIZE:
        return
    with reading(path):
        count = exr_numbers(path) if suffix == ".exr" else picture_numbers(path)
        size = path.stat().st_size
    if count > max(MAX_NUMBERS, NUMBERS_PER_BYTE * size):
        raise FileError(
            f"can't read '{shortened(path)}': by its header its {size} bytes hold {count} numbers, more than an "
            "untrusted scene may ask for"
        )


def exr_numbers(path: Path) -> int:
    """The numbers of all parts of an OpenEXR file, by its headers."""
    import OpenEXR

    total = 0
    with OpenEXR.File(str(path), header_only=True) as file:
        for part in file.parts:
            (left, top), (right, bottom) = part.header["dataWindow"]
            total += (int(right) - int(left) + 1) * (int(bottom) - int(top) + 1) * len(part.header["channels"])
    return total


def check_writable(path: str | os.PathLike[str]) -> Format:
    """Raise `FileError` if `path` can't be written, before a long render rather than after it."""
    target = as_path(path)
    form = _format(target, "write")
    check_target(target)
    return form


def _format(path: Path, verb: str) -> Format:
    try:
        return FORMATS[path.suffix.lower()]
    except KeyError:
        known = [suffix[1:] for suffix in FORMATS]
        if not path.suffix:
            hint = f"the name has no extension{near_miss('', known)}"
        elif path.suffix.lower() in MOVIE_FORMATS and verb == "write":
            movies = "which 'djpt turntable' and 'djpt animate' write with --movie"
            hint = f"{path.suffix[1:]} is for movies, {movies}; images: {', '.join(known)}"
        else:
            hint = f"unknown extension '{path.suffix[1:]}'{near_miss(path.suffix[1:], known)}"
        raise FileError(f"can't {verb} '{path}': {hint}") from None


def _pixels(image: Any, name: str) -> npt.NDArray[Any]:
    """Convert an image of any accepted kind to a NumPy array (H, W, C) of float32 or uint8."""
    try:
        pixels = image.numpy() if hasattr(image, "numpy") else np.asarray(image)
    except (TypeError, ValueError):  # for example a ragged list
        pixels = np.asarray(None)
    if pixels.dtype.kind not in "fiub":
        raise FileError(f"{name}: an image must be a TensorXf or a NumPy array, found {type(image).__name__}")
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or 0 in pixels.shape:
        raise FileError(f"{name}: an image has shape (height, width, channels), found {pixels.shape}")
    return pixels if pixels.dtype == np.uint8 else np.asarray(pixels, np.float32)


def _texts(target: Path, metadata: Mapping[str, Any]) -> dict[str, str]:
    """Check metadata and convert their values to text."""
    if metadata and target.suffix.lower() not in METADATA:
        raise FileError(f"can't write '{target}': only exr and png carry metadata")
    texts = {}
    for name, value in metadata.items():
        if not isinstance(name, str) or not METADATA_NAME.fullmatch(name) or name in RESERVED:
            problem = "is used by the format itself" if name in RESERVED else "up to 31 letters, digits and _ . : -"
            raise FileError(f"can't write '{target}': the name {name!r} of metadata: {problem}")
        if not isinstance(value, (str, bool, int, float, np.integer, np.floating)) or "\0" in str(value):
            raise FileError(f"can't write '{target}': metadata '{name}' must be a string or a number, found {value!r}")
        texts[name] = str(value)
    return texts


def _either(numbers: Sequence[int]) -> str:
    return " or ".join(str(n) for n in numbers) if len(numbers) < 3 else f"{numbers[0]} to {numbers[-1]}"

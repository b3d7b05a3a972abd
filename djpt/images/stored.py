"""Images as files store them: numbers of their own type, the names of channels, and metadata.

`djpt.images.image` makes linear float32 of all of them; here nothing is converted.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from djpt.core.files import writing
from djpt.errors import FileError, near_miss
from djpt.images.exr import ORDER, RESERVED, read_layers, write_layers
from djpt.images.formats import FORMATS, Labels, encode_jpg, encode_png, png_metadata, write_npy
from djpt.images.image import check_writable, reading
from djpt.images.png16 import encode_png16

__all__ = ["Stored", "format_of", "load_stored", "save_stored", "stored_from_stream", "stored_to_stream"]


class Stored(NamedTuple):
    """An image in the form of a file."""

    pixels: npt.NDArray[Any]
    """(H, W, C)."""
    names: tuple[str, ...] | None
    """The names of the channels; None: the usual ones."""
    metadata: dict[str, Any]
    """Text, numbers, and arrays of 3 or 4 x 4 numbers."""
    srgb: bool
    """True if colours are encoded by the curve of sRGB."""
    premultiplied: bool
    """True if colours are multiplied by alpha."""


# ---- formats -------------------------------------------------------------------------------

MAGIC = {
    b"BM": ".bmp",
    b"#?": ".hdr",
    b"PF": ".pfm",
    b"Pf": ".pfm",
    b"P6": ".ppm",
    b"\xff\xd8": ".jpg",
    b"\x89PNG\r\n\x1a\n": ".png",
    b"\x76\x2f\x31\x01": ".exr",
    b"\x93NUMPY": ".npy",
    b"II*\0": ".tif",
    b"MM\0*": ".tif",
}
"""The first bytes of files, and the extensions of their formats."""


def format_of(file: IO[bytes]) -> str | None:
    """The format of a stream by its first or last bytes, as an extension; None if it is unknown. Moves nothing."""
    place = file.tell()
    head = file.read(8)
    for magic, suffix in MAGIC.items():
        if head.startswith(magic):
            file.seek(place)
            return suffix
    end = file.seek(0, 2)
    file.seek(max(end - 18, 0))
    tail = file.read(18)
    file.seek(place)
    return ".tga" if tail == b"TRUEVISION-XFILE.\0" else None


# ---- reading -------------------------------------------------------------------------------


def load_stored(path: Path, suffix: str | None = None) -> Stored:
    """Read a file.

    Args:
        path: Of the file.
        suffix: The format, as an extension. Default: by the content, else by the extension of `path`.

    Raises:
        FileError: missing, damaged or of an unknown format.
    """
    with reading(path):
        if suffix is None:
            with path.open("rb") as file:
                suffix = format_of(file) or path.suffix.lower()
        if suffix not in FORMATS:
            raise ValueError(f"neither its content nor the extension '{path.suffix}' is that of a known format")
        if suffix == ".exr":
            names, pixels, attributes = read_layers(path)
            return Stored(pixels, names, exr_metadata(attributes), srgb=False, premultiplied=True)
        pixels = FORMATS[suffix].decode(path)
        metadata = dict(png_metadata(path)) if suffix == ".png" else {}
        return Stored(pixels, None, metadata, srgb=pixels.dtype.kind == "u", premultiplied=suffix == ".bmp")


def exr_metadata(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """The attributes that are texts, numbers, vectors of three or matrices, as these."""
    result: dict[str, Any] = {}
    for name, value in attributes.items():
        if name == ORDER:
            continue
        if isinstance(value, (str, int, float)) and not isinstance(value, bool):
            result[name] = value
        elif isinstance(value, np.ndarray) and value.shape == (1,):  # a number of double precision
            result[name] = float(value[0])
        elif isinstance(value, np.ndarray) and value.shape in ((3,), (3, 3), (4, 4)):
            result[name] = value
    return result


def stored_from_stream(file: IO[bytes], suffix: str | None = None) -> Stored:
    """Read an image from a binary stream, from its place to its end; see `load_stored`."""
    suffix = suffix or format_of(file)
    if suffix is None:
        raise FileError("can't read the stream: its content isn't that of a known format")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"stream{suffix}"
        with path.open("wb") as copy:
            shutil.copyfileobj(file, copy)
        return load_stored(path, suffix)


# ---- writing -------------------------------------------------------------------------------

TYPES = {
    ".exr": ("float16", "float32", "uint32"),
    ".png": ("uint8", "uint16"),
    ".jpg": ("uint8",),
    ".ppm": ("uint8",),
    ".bmp": ("uint8",),
    ".tga": ("uint8",),
    ".tif": ("uint8",),
    ".hdr": ("float32",),
    ".pfm": ("float32",),
    ".npy": ("float16", "float32", "float64", "uint8", "uint16", "uint32"),
}
"""The types of numbers that formats hold."""

ALIASES = {".jpeg": ".jpg", ".rgbe": ".hdr", ".tiff": ".tif"}


def save_stored(path: Path, image: Stored, suffix: str | None = None, quality: int = -1) -> None:
    """Write a file, which appears whole or not at all.

    Args:
        path: Of the file.
        image: Its numbers must have a type that the format holds: nothing is converted.
        suffix: The format, as an extension. Default: that of `path`.
        quality: png: compression, 1 to 9 (default 5); jpg: 0 to 100 (default), below 100 with less colour; exr: above
            0, the loss of the compression DWAB (45 is usual).

    Raises:
        FileError: the format can't hold the image, or the path can't be written.
    """
    suffix = (suffix or path.suffix).lower()
    suffix = ALIASES.get(suffix, suffix)
    if suffix not in TYPES:
        hint = near_miss(suffix[1:], (name[1:] for name in TYPES))
        raise FileError(f"can't write '{path}': unknown format '{suffix[1:]}'{hint}")
    check_writable(path.with_suffix(suffix))
    pixels, types, counts = image.pixels, TYPES[suffix], FORMATS[suffix].channels
    if suffix in (".hdr", ".pfm") and pixels.shape[2] == 4:  # without alpha
        pixels = pixels[..., :3]
    if suffix != ".exr" and image.names is not None and image.names[:1] == ("X",):
        raise FileError(
            f"can't write '{path}': {suffix[1:]} holds no XYZ colours; convert the image to RGB, or write exr"
        )
    if str(pixels.dtype) not in types:
        raise FileError(
            f"can't write '{path}': {suffix[1:]} holds numbers of type {' or '.join(types)}, found {pixels.dtype}; "
            "convert the image first"
        )
    if counts and pixels.shape[2] not in counts:
        raise FileError(
            f"can't write '{path}': {suffix[1:]} holds {' or '.join(map(str, counts))} channels, found "
            f"{pixels.shape[2]}; convert the image first, or write exr"
        )
    with writing(path) as temporary:
        encode(temporary, image._replace(pixels=pixels), suffix, quality)


def encode(path: Path, image: Stored, suffix: str, quality: int) -> None:
    """Write a file of a format that holds the image."""
    pixels = image.pixels
    texts = {name: str(value) for name, value in image.metadata.items()}
    if suffix == ".exr":
        attributes = {name: exr_attribute(value) for name, value in image.metadata.items() if name not in RESERVED}
        assert image.names is not None
        write_layers(path, pixels, image.names, attributes, quality)
    elif suffix == ".png" and pixels.dtype == np.uint16:
        path.write_bytes(encode_png16(pixels, texts, 5 if quality < 0 else quality, image.srgb))
    elif suffix == ".png":
        encode_png(path, pixels, texts, 5 if quality < 0 else quality, image.srgb)
    elif suffix == ".jpg":
        quality = 100 if quality < 0 else quality
        encode_jpg(path, pixels, quality, full_chroma=quality == 100)
    elif suffix == ".npy":
        write_npy(path, pixels)
    else:
        named = path.with_suffix(suffix)
        try:
            FORMATS[suffix].encode(named, pixels, Labels(None, {}))
            named.replace(path)
        except BaseException:
            named.unlink(missing_ok=True)
            raise


def exr_attribute(value: Any) -> Any:
    """A value of metadata as the library takes it: numbers with a fraction in double precision, arrays in single."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return np.array([value])
    return np.asarray(value, np.float32) if isinstance(value, np.ndarray) else value


def stored_to_stream(file: IO[bytes], image: Stored, suffix: str, quality: int = -1) -> None:
    """Write an image to a binary stream; see `save_stored`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"stream{suffix}"
        save_stored(path, image, suffix, quality)
        file.write(path.read_bytes())

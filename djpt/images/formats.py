"""The file formats of images: one encoder and one decoder each.

Encoders take an array of shape (H, W, C) and a path that they may overwrite; decoders
return such an array. They don't use djpt's types and errors: `djpt.images.image` checks the input,
makes writes atomic and turns all exceptions raised here into a `FileError`.

The linear formats (`exr`, `hdr`, `pfm`, `npy`) carry float32 radiance. The display formats
(`png`, `jpg`, `bmp`, `tga`, `ppm`, `tiff`) carry 8-bit sRGB, without dithering, so that equal images give equal bytes.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from djpt.images.colorimetry import XYZ_TO_RGB
from djpt.images.exr import FILLER, ORDER, read_attributes, read_layers, usual_names, write_layers
from djpt.images.png16 import decode_png16, is_png16
from djpt.images.srgb import Codes, strips, to_srgb8

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

__all__ = [
    "DISPLAY_FORMATS",
    "FORMATS",
    "METADATA",
    "Format",
    "Hdr",
    "Labels",
    "Npy",
    "Opened",
    "Pfm",
    "Shape",
    "encode_jpg",
    "encode_png",
    "picture_numbers",
    "png_metadata",
    "write_npy",
]

Pixels = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]
Shape = tuple[int, int, int]
"""Height, width, channels."""


class Labels(NamedTuple):
    """Names and metadata that a file stores beside its pixels."""

    channels: Sequence[str] | None
    """The names of the channels; None: the usual ones."""
    metadata: Mapping[str, str]


class Format(NamedTuple):
    """A file format: the numbers of channels that it can hold (empty = any), its encoder and its decoder."""

    channels: tuple[int, ...]
    encode: Callable[[Path, Pixels, Labels], None]
    decode: Callable[[Path], Pixels | Codes]
    """Gives linear values; those of display formats are whole numbers, encoded as sRGB."""


# ---------------------------------------------------------------- formats that are written row by row


class Opened:
    """A file with a header, and rows after it."""

    def __init__(self, path: Path, header: bytes) -> None:
        self._file = path.open("wb")
        self._file.write(header)

    def add(self, rows: Pixels) -> None:
        """Write the next rows, (rows, width, channels) of linear values."""
        raise NotImplementedError

    def close(self, labels: Labels) -> None:
        self.release()

    def release(self) -> None:
        self._file.close()


def by_rows(kind: Callable[[Path, Shape, Labels], Opened]) -> Callable[[Path, Pixels, Labels], None]:
    """The encoder of a format that is written row by row."""

    def encode(path: Path, image: Pixels, labels: Labels) -> None:
        file = kind(path, image.shape, labels)
        try:
            for strip in strips(image):
                file.add(image[strip])
        finally:
            file.release()

    return encode


# ---------------------------------------------------------------- OpenEXR


def _write_exr(path: Path, image: Pixels, labels: Labels) -> None:
    names = tuple(labels.channels) if labels.channels is not None else usual_names(image.shape[2])
    write_layers(path, image, names, {**labels.metadata, ORDER: ",".join(names)})


def _exr_metadata(path: Path) -> dict[str, str]:
    attributes = read_attributes(path)
    return {name: value for name, value in attributes.items() if isinstance(value, str) and name not in (ORDER, FILLER)}


def _read_exr(path: Path) -> Pixels:
    names, stored, attributes = read_layers(path)
    pixels = np.asarray(stored, np.float32)
    if names in (("X", "Y", "Z"), ("X", "Y", "Z", "A")):
        return np.concatenate([pixels[..., :3] @ XYZ_TO_RGB.T.astype(np.float32), pixels[..., 3:]], axis=2)
    order = str(attributes.get(ORDER, "")).split(",")
    if sorted(order) != sorted(names):
        # A file of another program: colour first, in the usual order, then the rest by name.
        usual = ("R", "G", "B", "Y", "A")
        order = [name for name in usual if name in names] + sorted(set(names) - set(usual))
    return pixels if tuple(order) == names else pixels[..., [names.index(name) for name in order]]


# ---------------------------------------------------------------- Radiance RGBE


class Hdr(Opened):
    """Radiance RGBE (Ward, *Real Pixels*, Graphics Gems II), flat scanlines.

    Three 8-bit mantissas share one exponent: relative error 2^-8 of the largest channel.
    Mantissas are rounded (not truncated) for readers that compute `m * 2^(e - 136)`, which
    most do. Negative values and NaN become 0.
    """

    def __init__(self, path: Path, shape: Shape, labels: Labels) -> None:
        header = f"#?RADIANCE\nSOFTWARE=djpt\nFORMAT=32-bit_rle_rgbe\n\n-Y {shape[0]} +X {shape[1]}\n"
        super().__init__(path, header.encode("ascii"))

    def add(self, rows: Pixels) -> None:
        for strip in strips(rows):
            self._file.write(to_rgbe(rows[strip]).data)


def to_rgbe(image: Pixels) -> Bytes:
    """Convert linear values (H, W, 3) to mantissas and exponents (H, W, 4)."""
    rgb = np.clip(np.nan_to_num(image, nan=0.0), 0.0, 2.0**126).astype(np.float64)
    largest = rgb.max(axis=2)
    _, exponent = np.frexp(largest)
    # Rounding may lift the largest mantissa to 256: such a pixel needs the next exponent.
    exponent = np.where(np.floor(np.ldexp(largest, 8 - exponent) + 0.5) > 255, exponent + 1, exponent)
    mantissa = np.floor(np.ldexp(rgb, (8 - exponent)[..., None]) + 0.5)
    black = (largest <= 0) | (exponent < -127)
    rgbe = np.concatenate([mantissa, (exponent + 128)[..., None]], axis=2)
    rgbe[black] = 0
    # Flat scanlines can't be mistaken for run lengths (which begin with 2 2 or 1 1 1): the
    # largest mantissa of a pixel that isn't black is at least 128, and black is 0 0 0 0.
    return rgbe.astype(np.uint8)


def _read_hdr(path: Path) -> Pixels:
    data = path.read_bytes()
    header, separator, rest = data.partition(b"\n\n")
    size, newline, body = rest.partition(b"\n")
    if not (header.startswith(b"#?") and separator and newline):
        raise ValueError("no Radiance header")
    words = size.split()
    if len(words) != 4 or words[0] != b"-Y" or words[2] != b"+X":
        raise ValueError("unsupported orientation of its rows: possible is '-Y HEIGHT +X WIDTH'")
    height, width = int(words[1]), int(words[3])
    if height <= 0 or width <= 0:
        raise ValueError(f"size {width} x {height}")
    if len(body) == 4 * height * width:
        rgbe = np.frombuffer(body, np.uint8).reshape(height, width, 4)
    else:
        # A run of at most 127 bytes takes 2: bounds the memory that a forged header can ask for.
        if height * width * 4 > len(body) * 64:
            raise ValueError("the file is too short for its size")
        rgbe = _rgbe_run_lengths(body, height, width)
    # By exponent; exact in single precision, as are the products. Exponent 0 is black.
    scale = np.ldexp(np.float32(1), np.arange(256, dtype=np.int32) - 136)
    scale[0] = 0
    colors = np.multiply(rgbe[..., :3], scale[rgbe[..., 3]][..., None], dtype=np.float32)
    return colors @ XYZ_TO_RGB.T.astype(np.float32) if b"\nFORMAT=32-bit_rle_xyze" in header else colors


def _rgbe_run_lengths(body: bytes, height: int, width: int) -> Bytes:
    """Decode scanlines that hold the four components one after the other, as runs and literals."""
    rgbe = np.empty((height, 4, width), np.uint8)
    at = 0
    for y in range(height):
        if body[at : at + 2] != b"\x02\x02" or body[at + 2] * 256 + body[at + 3] != width:
            raise ValueError(f"scanline {y} is not run-length encoded")
        at += 4
        for component in range(4):
            x = 0
            while x < width:
                count = body[at]
                if count > 128:
                    count -= 128
                    run: Bytes | int = body[at + 1]
                    at += 2
                else:
                    run = np.frombuffer(body, np.uint8, count, at + 1)
                    at += 1 + count
                if count == 0 or x + count > width:
                    raise ValueError(f"a bad run in scanline {y}")
                rgbe[y, component, x : x + count] = run
                x += count
    return rgbe.transpose(0, 2, 1)


# ---------------------------------------------------------------- PFM, NPY


class Pfm(Opened):
    """A portable float map, whose last row comes first; a negative scale means little endian."""

    def __init__(self, path: Path, shape: Shape, labels: Labels) -> None:
        height, width, channels = shape
        header = f"{'PF' if channels == 3 else 'Pf'}\n{width} {height}\n-1.0\n".encode("ascii")
        super().__init__(path, header)
        self._end = len(header) + 4 * width * height * channels

    def add(self, rows: Pixels) -> None:
        self._end -= rows.nbytes
        self._file.seek(self._end)
        self._file.write(np.ascontiguousarray(rows[::-1], "<f4").data)


class Npy(Opened):
    """NumPy's format."""

    def __init__(self, path: Path, shape: Shape, labels: Labels) -> None:
        super().__init__(path, b"")
        layout = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._file, layout)

    def add(self, rows: Pixels) -> None:
        self._file.write(np.ascontiguousarray(rows, "<f4").data)


def _read_pfm(path: Path) -> Pixels:
    words = path.read_bytes().split(maxsplit=3)
    magic, width, height = words[0], int(words[1]), int(words[2])
    # Exactly one white space follows the scale; the pixels may begin with bytes that look like more.
    scale, _, body = words[3].partition(b"\n")
    if magic not in (b"PF", b"Pf") or width <= 0 or height <= 0:
        raise ValueError("not a PFM header")
    count = 3 if magic == b"PF" else 1
    if len(body) != 4 * width * height * count:
        raise ValueError(f"{len(body)} bytes of pixels for {width} x {height} x {count}")
    pixels = np.frombuffer(body, "<f4" if float(scale) < 0 else ">f4").reshape(height, width, count)
    return pixels[::-1].astype(np.float32)


def write_npy(path: Path, array: npt.NDArray[Any]) -> None:
    """Write an array in NumPy's format. NumPy's own writing to files doesn't say why it failed."""
    array = np.ascontiguousarray(array)
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(array))
        file.write(array.data)


def _read_npy(path: Path) -> Pixels:
    # Mapped, so that a forged header can't ask for more memory than the file has bytes.
    pixels = np.load(path, mmap_mode="r", allow_pickle=False)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.dtype.kind not in "fiu":
        raise ValueError(f"an array of shape {pixels.shape} and type {pixels.dtype} is not an image")
    return np.array(pixels, np.float32)


# ---------------------------------------------------------------- PNG, JPEG, BMP, TGA, PPM, TIFF

_MODES = {1: "L", 2: "LA", 3: "RGB", 4: "RGBA"}
_PICTURES = ("PNG", "JPEG", "BMP", "TGA", "PPM", "TIFF")


def encode_png(
    file: Path | IO[bytes],
    pixels: Bytes,
    metadata: Mapping[str, str] | None = None,
    level: int = 6,
    srgb: bool = True,
) -> None:
    """Write 8-bit pixels of 1 to 4 channels as PNG to a path or a binary stream.

    With `srgb`, the file says that it is that, in the chunk of that name and, for readers that don't know it, by a
    gamma of 1 / 2.2. Metadata become text chunks: tEXt, or iTXt for what isn't Latin-1. `level`: of compression, 1
    to 9.
    """
    from PIL.PngImagePlugin import PngInfo

    chunks = PngInfo()
    if srgb:
        chunks.add(b"sRGB", b"\0")  # rendering intent: perceptual
        chunks.add(b"gAMA", (45455).to_bytes(4, "big"))
    for name, text in (metadata or {}).items():
        chunks.add_text(name, text)
    _picture(pixels).save(file, format="PNG", pnginfo=chunks, compress_level=level)


def png_metadata(path: Path) -> dict[str, str]:
    """The text chunks of a PNG file."""
    from PIL import Image

    with Image.open(path, formats=("PNG",)) as file:
        file.load()  # text may follow the pixels
        return {name: str(text) for name, text in getattr(file, "text", {}).items()}


def _picture(pixels: Bytes) -> Picture:
    from PIL import Image

    height, width, count = pixels.shape
    return Image.frombuffer(_MODES[count], (width, height), np.ascontiguousarray(pixels), "raw", _MODES[count], 0, 1)


def _write_jpg(path: Path, image: Pixels, labels: Labels) -> None:
    """Write a JPEG, which has no alpha; images are premultiplied, so without it the background is black."""
    pixels = _as_bytes(image)
    encode_jpg(path, pixels[..., : 1 if pixels.shape[2] < 3 else 3], 95, full_chroma=True)


def encode_jpg(file: Path | IO[bytes], pixels: Bytes, quality: int, full_chroma: bool) -> None:
    """Write 8-bit pixels of 1 or 3 channels as JPEG. `quality`: 0 to 100; `full_chroma`: colour of all pixels."""
    _save(file, pixels, format="JPEG", quality=quality, subsampling=0 if full_chroma else 2)


def _write_plain(path: Path, image: Pixels, labels: Labels) -> None:
    """Write the format that the extension names, without compression."""
    name = path.suffix[1:].upper()
    _save(path, _as_bytes(image), format="TIFF" if name == "TIF" else name)


def _save(file: Path | IO[bytes], pixels: Bytes, **options: Any) -> None:
    """Encode a picture in memory, then write it: Pillow's own writing to files misses that a disk is full."""
    encoded = io.BytesIO()
    _picture(pixels).save(encoded, **options)
    # Not its buffer, which an error of writing would keep: Python 3.13 prints another one then.
    if isinstance(file, Path):
        file.write_bytes(encoded.getvalue())
    else:
        file.write(encoded.getvalue())


def _as_bytes(image: npt.NDArray[Any]) -> Bytes:
    return image if image.dtype == np.uint8 else to_srgb8(image)


def picture_numbers(path: Path) -> int:
    """The numbers of a picture once it is decoded, by its header: colours of palettes count as four channels."""
    from PIL import Image

    with Image.open(path, formats=_PICTURES) as file:
        width, height = file.size
        return width * height * (4 if file.mode == "P" else len(file.getbands()))


def _read_picture(path: Path) -> Codes | Pixels:
    from PIL import Image

    if is_png16(path):
        return decode_png16(path)
    with Image.open(path, formats=_PICTURES) as file:
        picture: Picture = file
        if picture.mode == "F":  # a TIFF of linear numbers
            return np.asarray(picture, np.float32)[..., None]
        if picture.mode.startswith("I"):  # 16 bit grey
            return np.asarray(picture).astype(np.uint16)[..., None]
        if picture.mode == "1":
            picture = picture.convert("L")
        elif picture.mode not in _MODES.values():
            picture = picture.convert("RGBA" if "transparency" in picture.info else "RGB")
        pixels = np.asarray(picture, np.uint8)
    return pixels[..., None] if pixels.ndim == 2 else pixels


# ---------------------------------------------------------------- the table

FORMATS = {
    ".exr": Format((), _write_exr, _read_exr),
    ".hdr": Format((3,), by_rows(Hdr), _read_hdr),
    ".pfm": Format((1, 3), by_rows(Pfm), _read_pfm),
    ".npy": Format((), lambda path, image, labels: write_npy(path, image), _read_npy),
    ".png": Format(
        (1, 2, 3, 4), lambda path, image, labels: encode_png(path, _as_bytes(image), labels.metadata), _read_picture
    ),
    ".jpg": Format((1, 2, 3, 4), _write_jpg, _read_picture),
    ".jpeg": Format((1, 2, 3, 4), _write_jpg, _read_picture),
    ".bmp": Format((1, 3), _write_plain, _read_picture),
    ".tga": Format((1, 2, 3, 4), _write_plain, _read_picture),
    ".ppm": Format((3,), _write_plain, _read_picture),
    ".tif": Format((1, 2, 3, 4), _write_plain, _read_picture),
    ".tiff": Format((1, 2, 3, 4), _write_plain, _read_picture),
}

DISPLAY_FORMATS = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tga", ".ppm", ".tif", ".tiff"})

METADATA = {".exr": _exr_metadata, ".png": png_metadata}
"""The formats that carry metadata, and the function that reads them."""

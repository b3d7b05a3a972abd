"""Files as they store images: types, names, primaries, and 16 bits of PNG."""

from __future__ import annotations

import io
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as Picture

from djpt.errors import FileError
from djpt.images import png16
from djpt.images.image import read_pixels, write
from djpt.images.png16 import chunk, decode_png16, encode_png16, is_png16
from djpt.images.stored import Stored, format_of, load_stored, save_stored


def codes(channels: int) -> np.ndarray:
    """Pixels (5, 7, C) of 16 bits: steps and noise."""
    noise = np.random.default_rng(channels).integers(0, 1 << 16, (5, 7, channels))
    noise[:2] = np.arange(7)[:, None] * 300
    return noise.astype(np.uint16)


# ---- PNG -----------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_sixteen_bits_go_there_and_back(tmp_path: Path, channels: int) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(encode_png16(codes(channels), {"Title": "one", "Name": "žluť"}, 6, srgb=True))
    assert is_png16(path)
    np.testing.assert_array_equal(decode_png16(path), codes(channels))
    stored = load_stored(path)
    assert stored.metadata == {"Title": "one", "Name": "žluť"}
    assert stored.pixels.dtype == np.uint16
    assert (stored.srgb, stored.premultiplied) == (True, False)
    with Picture.open(path) as picture:  # which knows the format, if not all of its bits
        picture.load()
        assert picture.size == (7, 5)
        assert "srgb" in picture.info


@pytest.mark.parametrize("kind", range(5))
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_all_predictors_are_undone(tmp_path: Path, channels: int, kind: int) -> None:
    """Rows that are predicted pixel by pixel, as the format's document says."""
    rows = codes(channels).astype(">u2").view(np.uint8).reshape(5, 7, 2 * channels).astype(int)
    coded = bytearray()
    for y in range(5):
        coded.append(kind)
        for x in range(7):
            for i in range(2 * channels):
                a = rows[y, x - 1, i] if x else 0
                b = rows[y - 1, x, i] if y else 0
                c = rows[y - 1, x - 1, i] if x and y else 0
                nearest = min((a, b, c), key=lambda v, p=a + b - c: abs(p - v))
                coded.append((rows[y, x, i] - (0, a, b, (a + b) // 2, nearest)[kind]) % 256)
    parts = encode_png16(codes(channels), {}, 6, srgb=False).split(b"IDAT")
    path = tmp_path / "a.png"
    path.write_bytes(parts[0][:-4] + chunk(b"IDAT", zlib.compress(coded)) + chunk(b"IEND", b""))
    np.testing.assert_array_equal(decode_png16(path), codes(channels))


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    good = encode_png16(codes(3), {}, 6, srgb=True)
    path = tmp_path / "a.png"
    for bad, message in (
        (good[:60] + b"?" + good[61:], "is damaged"),
        (good[:-60], "chunk IDAT is damaged"),
        (good[:16] + b"\x7f\xff\xff\xff" + good[20:], "is damaged"),
    ):
        path.write_bytes(bad)
        with pytest.raises(FileError, match=message):
            load_stored(path)
    head = good[16:29].replace(b"\0\0\0\7", b"\0\7\0\0", 1)
    path.write_bytes(good[:8] + chunk(b"IHDR", head) + good[33:])
    with pytest.raises(FileError, match="size 458752 x 5 for"):
        load_stored(path)
    with pytest.raises(ValueError, match="unknown filter 9"):
        png16.unfiltered(np.zeros((1, 1, 2), np.uint8), np.array([9], np.uint8))


def test_read_keeps_sixteen_bits(tmp_path: Path) -> None:
    """Linear values of codes that 8 bits can't tell apart."""
    pixels = np.array([[[30000, 30001, 30002]]], np.uint16)
    (tmp_path / "a.png").write_bytes(encode_png16(pixels, {}, 6, srgb=True))
    linear = read_pixels(tmp_path / "a.png")
    assert len(np.unique(linear)) == 3
    raw = read_pixels(tmp_path / "a.png", raw=True)
    np.testing.assert_allclose(raw, pixels / np.float32(65535), rtol=1e-6)


# ---- OpenEXR ---------------------------------------------------------------------------------


def exr(path: Path, planes: dict[str, np.ndarray], **header: Any) -> None:
    import OpenEXR

    kind = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File({**kind, **header}, planes).write(str(path))


def test_layers_stand_in_the_order_of_colours(tmp_path: Path) -> None:
    names = ["A", "B", "G", "R", "depth", "n.X", "n.Y", "n.Z", "a.R", "a.G", "a.B", "a.A"]
    exr(tmp_path / "a.exr", {name: np.full((2, 3), i, np.float16) for i, name in enumerate(names)})
    stored = load_stored(tmp_path / "a.exr")
    order = ["R", "G", "B", "A", "a.R", "a.G", "a.B", "a.A", "depth", "n.X", "n.Y", "n.Z"]
    assert stored.names == tuple(order)
    assert stored.pixels.dtype == np.float16
    assert stored.pixels[0, 0].tolist() == [names.index(name) for name in order]


WIDE = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)  # ITU-R BT.2020


@pytest.mark.usefixtures("second_thread")
@pytest.mark.parametrize("primaries", [WIDE, (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)])
def test_other_primaries_become_srgb(tmp_path: Path, primaries: tuple[float, ...]) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    pixels = np.random.default_rng(2).random((3, 4, 3)).astype(np.float32)
    planes = {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate("RGB")}
    exr(tmp_path / "a.exr", planes, chromaticities=primaries)
    theirs = mi.Bitmap(str(tmp_path / "a.exr"))
    stored = load_stored(tmp_path / "a.exr")
    assert stored.names == tuple(field.name for field in theirs.struct_())
    np.testing.assert_allclose(stored.pixels, np.array(theirs), atol=2e-6)
    rgb = theirs.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    np.testing.assert_allclose(read_pixels(tmp_path / "a.exr"), np.array(rgb), atol=2e-6)


@pytest.mark.parametrize("alpha", [False, True])
def test_luminance_and_chroma_become_colours(tmp_path: Path, alpha: bool) -> None:
    """R = (RY + 1) Y, B = (BY + 1) Y, and G is what luminance leaves."""
    y, ry, by = (np.full((4, 6), value, np.float32) for value in (0.5, 0.2, -0.4))
    planes = {"Y": y, "RY": ry, "BY": by} | ({"A": np.full((4, 6), 0.25, np.float32)} if alpha else {})
    exr(tmp_path / "a.exr", planes)
    stored = load_stored(tmp_path / "a.exr")
    assert stored.names == (("R", "G", "B", "A") if alpha else ("R", "G", "B"))
    r, b = 0.6, 0.3
    expected = [r, (0.5 - 0.212639 * r - 0.072192 * b) / 0.715169, b] + [0.25] * alpha
    np.testing.assert_allclose(stored.pixels[1, 2], expected, rtol=1e-5)


@pytest.mark.parametrize("kind", ["float16", "float32", "uint32"])
@pytest.mark.parametrize("quality", [-1, 45])
def test_types_survive(tmp_path: Path, kind: str, quality: int) -> None:
    pixels = (np.random.default_rng(1).random((16, 16, 3)) * 8).astype(kind)
    image = Stored(pixels, ("R", "G", "B"), {"a": "text", "n": 2.5}, srgb=False, premultiplied=True)
    save_stored(tmp_path / "a.exr", image, quality=quality)
    back = load_stored(tmp_path / "a.exr")
    assert back.pixels.dtype == pixels.dtype
    assert (back.metadata["a"], back.metadata["n"]) == ("text", 2.5)
    # Half precision can be lost: the others aren't changed by this compression, or within it.
    np.testing.assert_allclose(back.pixels, pixels, atol=0 if quality < 0 else 0.2)


# ---- other formats -----------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["exr", "hdr", "pfm", "npy", "png", "jpg", "bmp", "ppm", "tif", "tiff", "tga"])
def test_formats_are_known_by_their_content(tmp_path: Path, suffix: str) -> None:
    write(tmp_path / f"a.{suffix}", np.ones((4, 5, 3), np.float32))
    found = format_of(io.BytesIO((tmp_path / f"a.{suffix}").read_bytes()))
    assert found == {"tiff": ".tif"}.get(suffix, f".{suffix}")
    assert load_stored(tmp_path / f"a.{suffix}").pixels.shape == (4, 5, 3)


def test_tiff_of_linear_numbers(tmp_path: Path) -> None:
    pixels = np.random.default_rng(4).random((3, 4)).astype(np.float32) * 9
    Picture.fromarray(pixels).save(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.tif")[..., 0], pixels)


def test_a_file_of_no_format(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_bytes(b"nothing of the kind, but long enough")
    with pytest.raises(FileError, match=r"neither its content nor the extension '\.dat'"):
        load_stored(tmp_path / "a.dat")

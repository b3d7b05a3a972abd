"""Images: every format comes back as it should, bytes are sRGB, and a failed write harms nothing."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image as Picture

from djpt.errors import DjptError, FileError
from djpt.images import srgb
from djpt.images.formats import FORMATS
from djpt.images.image import Image, read, read_metadata, read_pixels, write
from djpt.images.srgb import from_srgb, to_srgb8
from djpt.mitsuba.util import convert_to_bitmap, write_bitmap


def radiance(height: int = 5, width: int = 7, channels: int = 3, seed: int = 0) -> np.ndarray:
    """Values over many magnitudes, as in a rendered image; odd sizes catch swapped axes."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(0, 3, (height, width, channels))).astype(np.float32)


# ---------------------------------------------------------------- round trips


@pytest.mark.parametrize(
    ("suffix", "channels"),
    [("exr", n) for n in (1, 2, 3, 4, 5, 12)] + [("npy", n) for n in (1, 3, 9)] + [("pfm", 1), ("pfm", 3)],
)
def test_linear_formats_return_the_same_bits(tmp_path: Path, suffix: str, channels: int) -> None:
    image = radiance(channels=channels)
    write(tmp_path / f"a.{suffix}", image)
    back = read_pixels(tmp_path / f"a.{suffix}")
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, image)


def test_linear_formats_keep_what_is_not_a_colour(tmp_path: Path) -> None:
    image = np.float32([[[-1.0, np.inf, np.nan], [1e-38, 3e38, 0.0]]])
    for suffix in ("exr", "npy", "pfm"):
        write(tmp_path / f"a.{suffix}", image)
        np.testing.assert_array_equal(read_pixels(tmp_path / f"a.{suffix}"), image)


@settings(max_examples=50, deadline=None)
@given(arrays(np.float32, (2, 3, 3), elements=st.floats(0, 2.0**100, width=32)))
def test_hdr_is_exact_to_its_shared_exponent(tmp_path_factory: pytest.TempPathFactory, image: np.ndarray) -> None:
    path = tmp_path_factory.getbasetemp() / "a.hdr"
    write(path, image)
    largest = image.max(axis=2, keepdims=True)
    # Half a step of the mantissa that the largest channel leaves to all three; below 2^-127 all is black.
    assert np.all(np.abs(read_pixels(path) - image) <= largest * 2.0**-8 + 2.0**-126)


def test_hdr_clips_what_it_cannot_hold(tmp_path: Path) -> None:
    write(tmp_path / "a.hdr", np.float32([[[-1.0, np.nan, 0.5]]]))
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.hdr"), np.float32([[[0, 0, 0.5]]]))


def test_hdr_with_run_lengths(tmp_path: Path) -> None:
    """As other programs write it: a 9 x 1 image of literals and runs."""
    line = b"\x02\x02\x00\x09"
    line += b"\x89\x80"  # red: nine times 128
    line += b"\x03\x01\x02\x03\x86\x40"  # green: 1 2 3, then six times 64
    line += b"\x89\x00" + b"\x89\x81"  # blue 0, exponent 129
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 9\n" + line)
    expected = np.zeros((1, 9, 3), np.float32)
    expected[..., 0] = 1.0
    expected[0, :, 1] = np.float32([1, 2, 3] + 6 * [64]) / 128
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.hdr"), expected)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_holds_every_srgb_byte(tmp_path: Path, channels: int) -> None:
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(channels, axis=2)
    write(tmp_path / "a.png", from_srgb(codes))
    np.testing.assert_array_equal(np.asarray(Picture.open(tmp_path / "a.png")).reshape(codes.shape), codes)
    np.testing.assert_array_equal(to_srgb8(read_pixels(tmp_path / "a.png")), codes)


@pytest.mark.parametrize(
    ("suffix", "channels"), [("bmp", 1), ("bmp", 3), ("tga", 1), ("tga", 3), ("tga", 4), ("ppm", 3)]
)
def test_plain_formats_hold_every_srgb_byte(tmp_path: Path, suffix: str, channels: int) -> None:
    codes = np.random.default_rng(0).permutation(256).astype(np.uint8).reshape(16, 16, 1).repeat(channels, axis=2)
    codes[..., 0] = codes[::-1, :, 0]  # which rows and channels are where
    write(tmp_path / f"a.{suffix}", from_srgb(codes))
    np.testing.assert_array_equal(np.asarray(Picture.open(tmp_path / f"a.{suffix}")).reshape(codes.shape), codes)
    np.testing.assert_array_equal(to_srgb8(read_pixels(tmp_path / f"a.{suffix}")), codes)


def test_jpg_is_close_and_drops_alpha(tmp_path: Path) -> None:
    smooth = np.linspace(0, 1, 16 * 16, dtype=np.float32).reshape(16, 16, 1).repeat(4, axis=2)
    for name in ("a.jpg", "b.jpeg"):
        write(tmp_path / name, smooth)
        back = read_pixels(tmp_path / name)
        assert back.shape == (16, 16, 3)
        assert np.abs(back - smooth[..., :3]).max() < 0.03


def test_sixteen_bit_and_palette_pictures_are_read(tmp_path: Path) -> None:
    Picture.fromarray(np.full((2, 3), 65535, np.uint16)).save(tmp_path / "grey.png")
    np.testing.assert_allclose(read_pixels(tmp_path / "grey.png"), np.ones((2, 3, 1)))
    Picture.new("RGB", (3, 2), (255, 0, 0)).quantize(4).save(tmp_path / "palette.png")
    np.testing.assert_array_equal(read_pixels(tmp_path / "palette.png")[..., 0], np.ones((2, 3)))


# ---------------------------------------------------------------- what the formats are


@pytest.mark.parametrize(
    ("suffix", "magic"),
    [
        ("exr", b"\x76\x2f\x31\x01"),
        ("hdr", b"#?RADIANCE\n"),
        ("pfm", b"PF\n"),
        ("npy", b"\x93NUMPY"),
        ("png", b"\x89PNG\r\n\x1a\n"),
        ("jpg", b"\xff\xd8\xff"),
        ("bmp", b"BM"),
        ("tga", b"\0\0\x02"),
        ("ppm", b"P6"),
    ],
)
def test_a_file_is_what_its_extension_says(tmp_path: Path, suffix: str, magic: bytes) -> None:
    write(tmp_path / f"a.{suffix.upper()}", radiance())
    assert (tmp_path / f"a.{suffix.upper()}").read_bytes().startswith(magic)


def test_exr_names_its_channels(tmp_path: Path) -> None:
    import OpenEXR

    write(tmp_path / "a.exr", radiance(channels=4))
    write(tmp_path / "b.exr", radiance(channels=3), channels=["z.T", "a.X", "m.Y"])
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        assert set(file.channels()) == {"R", "G", "B", "A"}
    with OpenEXR.File(str(tmp_path / "b.exr"), separate_channels=True) as file:
        assert set(file.channels()) == {"z.T", "a.X", "m.Y"}
    np.testing.assert_array_equal(read_pixels(tmp_path / "b.exr"), radiance(channels=3))


def test_somebody_elses_exr_comes_back_as_rgba(tmp_path: Path) -> None:
    import OpenEXR

    image = radiance(channels=5)
    planes = {name: np.ascontiguousarray(image[..., i]) for i, name in enumerate(["R", "G", "B", "A", "Z"])}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, planes).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.exr"), image)


def test_srgb_bytes() -> None:
    """Round to nearest of the standard's curve; half grey is 188 (187.5 rounded), never dithered."""
    linear = np.float32([0, 0.0031308, 0.18, 0.5, 1, 2, -1, np.nan, np.inf]).reshape(1, -1, 1)
    assert to_srgb8(linear).ravel().tolist() == [0, 10, 118, 188, 255, 255, 0, 0, 255]
    constant = np.full((64, 64, 3), 0.5, np.float32)
    assert np.unique(to_srgb8(constant)).tolist() == [188]
    alpha = to_srgb8(np.full((1, 1, 4), 0.5, np.float32))
    assert alpha.ravel().tolist() == [188, 188, 188, 128]


def test_equal_images_give_equal_files(tmp_path: Path) -> None:
    for suffix in FORMATS:
        write(tmp_path / f"a{suffix}", radiance())
        write(tmp_path / f"b{suffix}", radiance())
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("name", "image", "message"),
    [
        ("a", radiance(), "the name has no extension; possible: bmp, exr"),
        (
            "a.gif",
            radiance(),
            "gif is for movies, which 'djpt turntable' and 'djpt animate' write with --movie; images: ",
        ),
        ("a.exe", radiance(), "unknown extension 'exe'; did you mean 'exr'"),
        ("nowhere/a.exr", radiance(), "there is no folder"),
        ("a.png", radiance(channels=5), "png holds 1 to 4 channels, found 5"),
        ("a.hdr", radiance(channels=4), "hdr holds 3 channels, found 4"),
        ("a.pfm", radiance(channels=2), "pfm holds 1 or 3 channels, found 2"),
        ("a.exr", np.zeros(3), r"has shape \(height, width, channels\), found \(3,\)"),
        ("a.exr", np.zeros((0, 4, 3)), r"found \(0, 4, 3\)"),
        ("a.exr", "image", "must be a TensorXf or a NumPy array, found str"),
        ("a.exr", None, "found NoneType"),
        ("a.exr", np.zeros((2, 2, 3), np.uint8), "8-bit pixels are sRGB"),
    ],
)
def test_bad_writes_say_why(tmp_path: Path, name: str, image: object, message: str) -> None:
    with pytest.raises(FileError, match=message):
        write(tmp_path / name, image)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("channels", [["R"], ["R", "R", "B"], ["R", "", "B"], ["a,b", "c", "d"]])
def test_bad_channel_names(tmp_path: Path, channels: list[str]) -> None:
    with pytest.raises(FileError, match="3 different channel names"):
        write(tmp_path / "a.exr", radiance(), channels=channels)


@pytest.mark.parametrize("suffix", sorted(FORMATS))
def test_damaged_files_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    with pytest.raises(FileError, match="there is no such file"):
        read_pixels(path)
    write(path, radiance(40, 40))
    whole = path.read_bytes()
    for damaged in (b"", b"\n", b"\n\n\n", whole[:4], whole[: len(whole) // 2]):
        path.write_bytes(damaged)
        with pytest.raises(FileError, match=f"can't read '.*a{suffix}'"):
            read_pixels(path)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.hdr", b"#?RADIANCE\n\n-Y 100000 +X 100000\nxxxx"),
        ("a.hdr", b"#?RADIANCE\n\n-Y -1 +X -4\nxxxx"),
        ("a.hdr", b"#?RADIANCE\n\n+X 4 -Y 4\nxxxx"),
        ("a.pfm", b"PF\n1000000 1000000\n-1.0\nxxxx"),
        (
            "a.npy",
            b"\x93NUMPY\x01\x00v\x00{'descr': '<f4', 'fortran_order': False, 'shape': (99999, 9999, 9)}\nxxxx",
        ),
    ],
)
def test_forged_sizes_ask_for_no_memory(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileError):
        read_pixels(tmp_path / name)


def test_errors_are_both_ours_and_the_usual_ones() -> None:
    assert issubclass(FileError, DjptError)
    assert issubclass(FileError, OSError)


# ---------------------------------------------------------------- views and verbs


def test_the_view_shows_itself() -> None:
    view = Image(radiance(channels=3))
    shown = Picture.open(io.BytesIO(view._repr_png_()))
    assert view.size == (7, 5)
    assert shown.size == (7 * 36, 5 * 36), "small images are enlarged"
    assert shown.mode == "RGB"
    assert repr(view) == "Image(7 x 5, 3 channels, float32)"
    assert Picture.open(io.BytesIO(Image(radiance(channels=9))._repr_png_())).mode == "RGB"
    assert Image(np.zeros((5, 7))).shape == (5, 7, 1)
    np.testing.assert_array_equal(np.asarray(view), view.numpy())


def test_mitsubas_verbs(tmp_path: Path) -> None:
    bitmap = convert_to_bitmap(radiance())
    assert np.asarray(bitmap).dtype == np.uint8
    assert np.asarray(convert_to_bitmap(radiance(), uint8_srgb=False)).dtype == np.float32
    write_bitmap(str(tmp_path / "a.png"), radiance(), write_async=False)
    write_bitmap(str(tmp_path / "b.png"), bitmap)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_tensors_go_in_and_come_out(tmp_path: Path) -> None:
    from djpt.jit.types import TensorXf

    tensor = TensorXf(radiance())
    write(tmp_path / "a.exr", tensor)
    back = read(tmp_path / "a.exr")
    assert isinstance(back, TensorXf)
    np.testing.assert_array_equal(back.numpy(), radiance())
    assert Image(back).size == (7, 5)


# ---------------------------------------------------------------- metadata

FACTS = {
    "Software": "djpt 0.1",
    "scene": "boîte à Cornell",
    "spp": 64,
    "seed": 2**32 - 1,
    "seconds": 1.5,
    "final": True,
}
TEXTS = {name: str(value) for name, value in FACTS.items()}


@pytest.mark.parametrize("suffix", ["exr", "png"])
def test_metadata_come_back_as_text(tmp_path: Path, suffix: str) -> None:
    paths = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for path in paths:
        write(path, radiance(), metadata=FACTS)
    assert {name: read_metadata(paths[0])[name] for name in FACTS} == TEXTS
    assert paths[0].read_bytes() == paths[1].read_bytes()
    write(paths[1], radiance())
    assert not set(FACTS) & set(read_metadata(paths[1]))
    np.testing.assert_array_equal(read_pixels(paths[0]), read_pixels(paths[1]))


@pytest.mark.usefixtures("second_thread")
def test_other_programs_see_the_metadata_and_the_layers(tmp_path: Path) -> None:
    import OpenEXR

    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    names = ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "d.T"]
    write(tmp_path / "a.exr", radiance(channels=7), channels=names, metadata=FACTS)
    write(tmp_path / "a.png", radiance(), metadata=FACTS)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        header = file.header()
        assert {name: header[name] for name in FACTS} == TEXTS
        # With its channels gathered, OpenEXR makes one array of each layer that has RGB.
        np.testing.assert_array_equal(file.channels()["RGB"].pixels, radiance(channels=7)[..., :3])
        np.testing.assert_array_equal(file.channels()["albedo"].pixels, radiance(channels=7)[..., 3:6])
    bitmap = mi.Bitmap(str(tmp_path / "a.exr"))
    assert bitmap.metadata()["scene"] == FACTS["scene"]
    layers = dict(bitmap.split())
    assert set(layers) == {"<root>", "albedo", "d"}
    np.testing.assert_array_equal(np.array(layers["albedo"]), radiance(channels=7)[..., 3:6])
    with Picture.open(tmp_path / "a.png") as picture:
        picture.load()
        assert picture.text == TEXTS
        assert picture.info["srgb"] == 0 and picture.info["gamma"] == pytest.approx(1 / 2.2, abs=1e-4)
    assert mi.Bitmap(str(tmp_path / "a.png")).srgb_gamma()


@pytest.mark.parametrize(
    ("name", "metadata", "message"),
    [
        ("a.jpg", {"x": 1}, "only exr and png carry metadata"),
        ("a.exr", {"a name": 1}, "'a name' of metadata: up to 31 letters"),
        ("a.png", {"": 1}, "up to 31 letters"),
        ("a.png", {"x" * 32: 1}, "up to 31 letters"),
        ("a.exr", {"compression": "none"}, "'compression' of metadata: is used by the format itself"),
        ("a.png", {"x": [1]}, r"'x' must be a string or a number, found \[1\]"),
        ("a.png", {"x": "a\0b"}, "must be a string or a number"),
    ],
)
def test_bad_metadata(tmp_path: Path, name: str, metadata: dict[str, object], message: str) -> None:
    with pytest.raises(FileError, match=message):
        write(tmp_path / name, radiance(), metadata=metadata)
    assert os.listdir(tmp_path) == []


def test_metadata_that_cannot_be_read(tmp_path: Path) -> None:
    write(tmp_path / "a.npy", radiance())
    with pytest.raises(FileError, match="only exr and png carry any"):
        read_metadata(tmp_path / "a.npy")
    for suffix in ("exr", "png"):
        path = tmp_path / f"b.{suffix}"
        with pytest.raises(FileError, match="there is no such file"):
            read_metadata(path)
        path.write_bytes(b"nothing")
        with pytest.raises(FileError, match="can't read"):
            read_metadata(path)


def test_exr_of_half_precision(tmp_path: Path) -> None:
    """Colours are stored together or one by one, in either precision: the numbers are the same."""
    import OpenEXR

    image = radiance(channels=4).astype(np.float16)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    whole = {"RGBA": image}
    single = {name: np.ascontiguousarray(image[..., i]) for i, name in enumerate("RGBA")}
    mixed = {**single, "G": single["G"].astype(np.float32)}
    for index, channels in enumerate((whole, single, mixed)):
        path = tmp_path / f"{index}.exr"
        OpenEXR.File(header, channels).write(str(path))
        np.testing.assert_array_equal(read_pixels(path), image.astype(np.float32))


@pytest.mark.parametrize("suffix", ["hdr", "pfm", "png", "jpg"])
def test_images_are_converted_in_strips(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.random.default_rng(0).uniform(0, 1.2, (19, 7, 3)).astype(np.float32)
    write(tmp_path / f"whole.{suffix}", image)
    monkeypatch.setattr(srgb, "STRIP", 3 * 7 * 4)
    assert len(srgb.strips(image)) == 5
    write(tmp_path / f"parts.{suffix}", image)
    assert (tmp_path / f"whole.{suffix}").read_bytes() == (tmp_path / f"parts.{suffix}").read_bytes()

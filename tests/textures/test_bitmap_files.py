"""Where texels come from: files of all formats, images in memory, and what is said of those that can't be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest
from PIL import Image as Pictures

import djpt
from djpt.errors import SceneError
from djpt.images.srgb import from_srgb
from djpt.jit.types import TensorXf
from djpt.textures import texels


def numbers(*shape: int) -> np.ndarray:
    return np.random.default_rng(4).uniform(0.05, 0.95, shape).astype(np.float32)


def octets(*shape: int) -> np.ndarray:
    return np.random.default_rng(5).integers(0, 256, shape, dtype=np.uint8)


def data(texture: Any) -> np.ndarray:
    return np.array(texture.data)


def load(**keys: Any) -> Any:
    return djpt.load_dict({"type": "bitmap", **keys})


def linear(bytes_: np.ndarray) -> np.ndarray:
    return from_srgb(bytes_)


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(
    ("suffix", "tolerance"), [("exr", 0), ("pfm", 0), ("npy", 0), ("hdr", 0.005), ("png", 0.005), ("jpg", 0.2)]
)
def test_files_of_all_formats(suffix: str, tolerance: float, channels: int, tmp_path: Path) -> None:
    if suffix == "hdr" and channels == 1:
        pytest.skip("hdr has three channels")
    # Smooth, for jpg.
    ramp = np.linspace(0.2, 0.8, 12 * channels, dtype=np.float32).reshape(3, 4, channels)
    path = tmp_path / f"image.{suffix}"
    djpt.write(path, ramp)
    texture = load(filename=str(path))
    assert texture.data.shape == ramp.shape
    np.testing.assert_allclose(data(texture), ramp, atol=tolerance)
    np.testing.assert_array_equal(data(texture), np.array(djpt.read(path)))


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_pictures_are_read_as_in_mitsuba(channels: int, raw: bool, mi: Any, tmp_path: Path) -> None:
    picture, path = octets(5, 4, channels), tmp_path / "picture.png"
    Pictures.fromarray(picture[..., 0] if channels == 1 else picture).save(path)
    kept = picture[..., : 1 if channels < 3 else 3]
    found = data(load(filename=str(path), raw=raw))
    np.testing.assert_allclose(found, kept / 255 if raw else linear(kept), atol=1e-6)
    reference = mi.load_dict({"type": "bitmap", "filename": str(path), "raw": raw, "format": "variant"})
    np.testing.assert_allclose(found, np.array(mi.traverse(reference)["data"]), atol=1e-6)


@pytest.mark.parametrize("suffix", ["bmp", "tga", "ppm"])
def test_plain_pictures_are_read_as_in_mitsuba(suffix: str, mi: Any, tmp_path: Path) -> None:
    path = tmp_path / f"picture.{suffix}"
    Pictures.fromarray(octets(5, 4, 3)).save(path)
    for raw in (False, True):
        reference = mi.load_dict({"type": "bitmap", "filename": str(path), "raw": raw, "format": "variant"})
        expected = np.array(mi.traverse(reference)["data"])
        np.testing.assert_allclose(data(load(filename=str(path), raw=raw)), expected, atol=1e-6)


def test_sixteen_bits_are_read_as_in_mitsuba(mi: Any, tmp_path: Path) -> None:
    path = tmp_path / "deep.png"
    wide = np.random.default_rng(6).integers(0, 65536, (4, 5), dtype=np.uint16)
    Pictures.fromarray(wide).save(path)
    for raw in (False, True):
        reference = mi.load_dict({"type": "bitmap", "filename": str(path), "raw": raw, "format": "variant"})
        expected = np.array(mi.traverse(reference)["data"])
        np.testing.assert_allclose(data(load(filename=str(path), raw=raw)), expected, atol=1e-6)


@pytest.mark.parametrize("raw", [False, True])
def test_linear_files_stay_linear(raw: bool, tmp_path: Path) -> None:
    bright = 7 * numbers(3, 4, 4)
    djpt.write(tmp_path / "image.exr", bright)
    np.testing.assert_array_equal(data(load(filename=str(tmp_path / "image.exr"), raw=raw)), bright[..., :3])


def test_names_are_relative_to_the_scene_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = numbers(2, 3, 3)
    (tmp_path / "maps").mkdir()
    djpt.write(tmp_path / "maps" / "wood.exr", image)
    (tmp_path / "scene.xml").write_text(
        """<scene version="3.0.0"><bsdf type="diffuse" id="floor"><texture type="bitmap" name="reflectance">
        <string name="filename" value="maps/wood.exr"/><string name="filter_type" value="nearest"/>
        <transform name="to_uv"><scale x="2" y="3"/></transform></texture></bsdf></scene>"""
    )
    scene = djpt.load_file(str(tmp_path / "scene.xml"))
    params = djpt.traverse(scene)
    np.testing.assert_array_equal(np.array(params["floor.reflectance.data"]), image)
    np.testing.assert_array_equal(params["floor.reflectance.to_uv"].matrix[:2, :2], np.diag([2.0, 3.0]))
    monkeypatch.chdir(tmp_path / "maps")
    np.testing.assert_array_equal(data(load(filename="wood.exr")), image)


# ---------------------------------------------------------------- memory


@pytest.mark.parametrize("raw", [False, True])
def test_images_in_memory(raw: bool) -> None:
    floats, bytes_ = numbers(4, 5, 3), octets(4, 5, 3)
    decoded = bytes_ / np.float32(255) if raw else linear(bytes_)
    for image, expected in (
        (floats, floats),
        (djpt.Image(floats), floats),
        (TensorXf(floats), floats),
        (floats[..., 0], floats[..., :1]),
        (bytes_, decoded),
        (djpt.Image(bytes_), decoded),
        (Pictures.fromarray(bytes_), decoded),
        ((bytes_.astype(np.uint16) * 257), bytes_ / 255),
    ):
        np.testing.assert_allclose(data(load(bitmap=image, raw=raw)), expected, atol=1e-6)


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float16, np.float32])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_bitmaps_of_mitsuba(channels: int, kind: Any, raw: bool, mi: Any) -> None:
    pixels = numbers(4, 5, channels)
    if np.issubdtype(kind, np.integer):
        pixels = pixels * np.iinfo(kind).max
    reference = mi.load_dict(
        {"type": "bitmap", "bitmap": mi.Bitmap(pixels.astype(kind)), "raw": raw, "format": "variant"}
    )
    texture = load(bitmap=mi.Bitmap(pixels.astype(kind)), raw=raw)
    np.testing.assert_allclose(data(texture), np.array(mi.traverse(reference)["data"]), atol=1e-6)


def test_an_encoded_bitmap_of_floats_is_decoded(mi: Any) -> None:
    bitmap = mi.Bitmap(numbers(3, 3, 3))
    bitmap.set_srgb_gamma(True)
    reference = mi.load_dict({"type": "bitmap", "bitmap": mi.Bitmap(bitmap), "format": "variant"})
    np.testing.assert_allclose(data(load(bitmap=bitmap)), np.array(mi.traverse(reference)["data"]), atol=1e-6)


def test_data_are_linear_and_may_have_one_channel() -> None:
    image = 3 * numbers(4, 5, 3)
    for value, expected in ((image, image), (TensorXf(image), image), (image[..., 0].tolist(), image[..., :1])):
        texture = load(data=value)
        np.testing.assert_allclose(data(texture), expected, rtol=1e-6)
        assert isinstance(texture.data, TensorXf)


def test_arrays_are_copied() -> None:
    image = numbers(2, 2, 3)
    texture = load(data=image)
    before = data(texture).copy()
    image[...] = 0
    np.testing.assert_array_equal(data(texture), before)


def test_gradients_of_given_tensors_stay_attached() -> None:
    import drjit as dr

    given = TensorXf(numbers(2, 2, 1))
    dr.enable_grad(given)
    scene = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": given}}
    params = djpt.traverse(djpt.load_dict(scene))
    dr.backward(dr.sum(params["reflectance.data"], axis=None))
    np.testing.assert_array_equal(np.array(dr.grad(given)), 1)


# ---------------------------------------------------------------- errors


def problem(**keys: Any) -> str:
    with pytest.raises(SceneError) as error:
        djpt.load_dict({"type": "diffuse", "reflectance": {"type": "bitmap", **keys}})
    message = str(error.value)
    assert message.startswith("diffuse")
    return message


def test_one_source_is_needed() -> None:
    assert "'bitmap' needs one of filename, bitmap, data; found none" in problem()
    assert "found 'filename' and 'data'" in problem(filename="a.png", data=numbers(2, 2, 3))
    assert "found 'bitmap' and 'data'" in problem(bitmap=numbers(2, 2, 3), data=numbers(2, 2, 3))


def test_files_that_cant_be_used(tmp_path: Path) -> None:
    assert "'filename': 'nowhere.png' doesn't exist" in problem(filename="nowhere.png")
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    assert f"'filename': can't read '{broken}'" in problem(filename=str(broken))
    (tmp_path / "image.webp").write_bytes(b"")
    assert "unknown extension 'webp'; possible: " in problem(filename=str(tmp_path / "image.webp"))
    (tmp_path / "folder.png").mkdir()
    assert "it is a folder" in problem(filename=str(tmp_path / "folder.png"))
    assert "'filename' must be a string" in problem(filename=3)
    for name, image, message in (
        ("nan", np.full((2, 2, 3), np.nan), "'filename' must be finite, found nan in row 0, column 0"),
        ("many", numbers(2, 2, 5), "'filename' must have 1 to 4 channels"),
        ("dark", -np.ones((2, 2, 3)), "'reflectance' must lie in [0, 1], found -1"),
    ):
        djpt.write(tmp_path / f"{name}.exr", image)
        assert message in problem(filename=str(tmp_path / f"{name}.exr"))


def test_images_brighter_than_white_warn_and_are_rendered_as_they_are() -> None:
    image = np.full((2, 2, 3), 0.5, np.float32)
    image[0, 0] = 1.25
    bright = {"type": "bitmap", "data": image, "filter_type": "nearest"}
    for texture in (bright, {"type": "checkerboard", "color0": bright, "color1": bright}):
        with pytest.warns(UserWarning, match=r"diffuse: 'reflectance' exceeds 1 in 25 % .* up to 1\.25"):
            loaded = djpt.load_dict({"type": "diffuse", "reflectance": texture})
        si = dr.zeros(djpt.SurfaceInteraction3f)
        si.uv = djpt.Point2f(0.25, 0.25)
        np.testing.assert_allclose(np.array(loaded.eval_diffuse_reflectance(si)).ravel(), 1.25)
    params = djpt.traverse(djpt.load_dict(bright))
    params["data"] = djpt.TensorXf(2 * image)
    params.update()
    # Numbers that aren't colours have no meaning there.
    with pytest.raises(djpt.SceneError, match=r"'roughness' must lie in \[0, 1\], found 1\.25"):
        djpt.load_dict({"type": "principled", "roughness": bright})


def test_images_that_cant_be_used(mi: Any) -> None:
    assert "'bitmap' must be an image, found str 'a.png'; a file's name is given as 'filename'" in problem(
        bitmap="a.png"
    )
    assert "'bitmap' must be an array of numbers, found list ['a']" in problem(bitmap=["a"])
    assert "'bitmap' must have the shape (height, width, channels), found (3,)" in problem(bitmap=np.ones(3))
    assert "'bitmap' must have the shape (height, width, channels), found (0, 2, 3)" in problem(
        bitmap=np.ones((0, 2, 3))
    )
    assert "'bitmap' must have 1 to 4 channels (grey or RGB, with or without alpha), found 5" in problem(
        bitmap=np.ones((2, 2, 5))
    )


def test_a_file_of_several_textures_is_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded = []
    read = texels.read_pixels
    monkeypatch.setattr(texels, "read_pixels", lambda *arguments: decoded.append(arguments) or read(*arguments))
    file = tmp_path / "dots.png"
    djpt.write(file, np.random.default_rng(0).random((4, 5, 3)).astype(np.float32))
    node = {"type": "bitmap", "filename": str(file)}
    scene = djpt.load_dict(
        {"type": "scene"}
        | {
            f"ball{i}": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": node | {"raw": i == 2}}}
            for i in range(3)
        }
    )
    assert len(decoded) == 2
    params = djpt.traverse(scene)
    first, second, raw = (params[f"ball{i}.bsdf.reflectance.data"] for i in range(3))
    assert np.array_equal(first.numpy(), second.numpy()) and not np.array_equal(first.numpy(), raw.numpy())
    # Each has memory of its own.
    np.asarray(first)[:] = 0
    assert second.numpy().any()

"""COLMAP's reconstructions: every camera model, texts and binary, and what is said of damage."""

from __future__ import annotations

import numpy as np
import pytest

import djpt
from tests.kit.photographs import HEIGHT, MODELS, PLACES, WIDTH, colmap_binary, colmap_text, rotation, write
from tests.photographs.projected import require_as_in_opencv, shown


@pytest.mark.parametrize("model", [model for model in MODELS if model != "EQUIRECTANGULAR"])
def test_every_model_projects_as_opencv_does(model, tmp_path):
    write(tmp_path, colmap_text(model))
    photographs = djpt.load_cameras(tmp_path)
    values = MODELS[model][1]
    focal = values[:1] * 2 if len(values) in (3, 5) or model.startswith("SIMPLE") else values[:2]
    rest = values[1 if focal[0] == focal[1] else 2 :]
    matrix = [[focal[0], 0, rest[0]], [0, focal[1], rest[1]], [0, 0, 1]]
    fisheye = "FISHEYE" in model
    coefficients = rest[2:] + [0.0] * (max(0, 4 - len(rest[2:])))
    require_as_in_opencv(photographs, matrix, coefficients, fisheye)
    assert photographs[0].sensor()["type"] == ("fisheye" if fisheye else "perspective")


@pytest.mark.parametrize("files", [colmap_text, colmap_binary])
def test_a_panorama_shows_azimuths_and_elevations(files, tmp_path):
    """COLMAP's projection: atan2(x, z) over the width, and atan2(-y, hypot(x, z)) over the height."""
    write(tmp_path, files("EQUIRECTANGULAR"))
    photographs = djpt.load_cameras(tmp_path)
    assert photographs[0].sensor()["type"] == "panorama"
    assert (photographs.resized(32)[0].lens.width, photographs.resized(32)[0].lens.height) == (32, 24)
    points = np.random.default_rng(0).uniform(-9, 9, (200, 3))
    for view, (turn, move) in zip(photographs, PLACES, strict=True):
        x, y, z = (points @ rotation(turn).T + move).T
        column = (np.arctan2(x, z) / (2 * np.pi) + 0.5) * WIDTH
        row = (0.5 - np.arctan2(-y, np.hypot(x, z)) / np.pi) * HEIGHT
        np.testing.assert_allclose(shown(view, points), np.stack([column, row], axis=1), atol=1e-4)
        assert (z < 0).any() and (z > 0).any()


def test_binary_files_say_the_same_as_texts(tmp_path):
    write(tmp_path / "text", colmap_text())
    write(tmp_path / "binary" / "sparse" / "0", colmap_binary())
    text = djpt.load_cameras(tmp_path / "text" / "images.txt", points=True)
    binary = djpt.load_cameras(tmp_path / "binary", points=True)
    assert [view.name for view in text] == [view.name for view in binary] == ["view 0.png", "view 1.png"]
    assert all(a.lens == b.lens for a, b in zip(text, binary, strict=True))
    for a, b in zip(text, binary, strict=True):
        np.testing.assert_allclose(a.to_world, b.to_world, atol=1e-15)
    assert np.array_equal(text.points, binary.points) and text.points.shape == (2, 3)
    assert np.array_equal(text.colors, binary.colors)
    np.testing.assert_allclose(text.colors[0], [1, 0.21586, 0], atol=1e-5)
    assert len(djpt.load_cameras(tmp_path / "text").points) == 0


def test_a_pinhole_is_described_as_mitsuba_does_it(tmp_path):
    write(tmp_path, colmap_text("SIMPLE_PINHOLE"))
    sensor = djpt.load_cameras(tmp_path)[0].sensor(near_clip=0.5)
    offset = sensor["principal_point_offset_x"], sensor["principal_point_offset_y"]
    np.testing.assert_allclose(offset, [0.5 - 31 / WIDTH, 0.5 - 25 / HEIGHT])
    assert "fx" not in sensor and sensor["near_clip"] == 0.5


def test_pictures_are_found_above_the_model(tmp_path):
    write(tmp_path / "sparse" / "0", colmap_binary())
    write(tmp_path / "images", {"view 0.png": b""})
    photographs = djpt.load_cameras(tmp_path)
    assert [view.path is not None for view in photographs] == [True, False]
    assert repr(photographs) == "Photographs('images.bin': 2 cameras, 1 pictures, 0 points)"
    with pytest.raises(djpt.FileError, match=r"the photograph 'view 1\.png' isn't in '.*images'"):
        photographs[1].target()


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("cameras.txt", b"OPENCV", b"FOV", r"line 2: 'FOV' is a camera model that no sensor has; possible: .*PINHOLE"),
        ("cameras.txt", b"OPENCV", b"OPENVC", r"'OPENVC' is not a camera model; did you mean 'OPENCV'"),
        ("cameras.txt", b"OPENCV", b"EQUIRECTANGULAR", r"EQUIRECTANGULAR has 2 parameters \(w, h\), found 8"),
        ("cameras.txt", b"0.004", b"", r"OPENCV has 8 parameters \(fx, fy, .*\), found 7"),
        ("cameras.txt", b" 60 ", b" -60 ", "focal lengths must be greater than 0"),
        ("cameras.txt", b" 60 ", b" nan ", "fx must be a finite number, found 'nan'"),
        ("cameras.txt", b" 64 ", b" 64000000 ", "the size must be a whole number from 1 to 65536"),
        ("cameras.txt", b" 64 ", b" 6.5 ", "the size must be a whole number"),
        ("images.txt", b" 7 view 0", b" 8 view 0", r"line 2: there is no camera 8 in cameras\.txt"),
        ("images.txt", b"1.5 2.5 -1", b"1.5 2.5", r"line 3: expected the points found on 'view 0\.png'"),
        ("images.txt", b" 0.4 3.0 7", b" 0.4 x 7", r"line 2: the place must be a finite number, found 'x'"),
        ("images.txt", b"2 0.93", b"2 junk", "the place must be a finite number"),
        ("points3D.txt", b" 255 ", b" 256 ", "the colour must be a whole number from 0 to 255"),
    ],
)
def test_damage_is_named(tmp_path, name, old, new, message):
    files = colmap_text()
    assert old in files[name]
    write(tmp_path, {**files, name: files[name].replace(old, new)})
    with pytest.raises(djpt.SceneError, match=f"^{name}, .*{message}"):
        djpt.load_cameras(tmp_path, points=True)


def test_damage_of_binary_files_is_named(tmp_path):
    files = colmap_binary()
    for name, at, new, message in (
        ("cameras.bin", 12, b"\x07", "camera 7: 'FOV' is a camera model that no sensor has"),
        ("cameras.bin", 12, b"\x63", "'model 99' is not a camera model"),
        ("cameras.bin", 6, b"\x01", "too few for 281474976710657 records"),
        ("images.bin", 68, b"\x09", "image 2: there is no camera 9 in cameras.bin"),
        ("points3D.bin", 0, b"\xff", "too few for 255 records"),
    ):
        damaged = bytearray(files[name])
        damaged[at : at + 1] = new
        write(tmp_path, {**files, name: bytes(damaged)})
        with pytest.raises(djpt.SceneError, match=f"^{name}.*{message}"):
            djpt.load_cameras(tmp_path, points=True)


def test_a_panorama_of_another_size_is_refused(tmp_path):
    files = colmap_text("EQUIRECTANGULAR")
    write(tmp_path, {**files, "cameras.txt": files["cameras.txt"].replace(b" 64 48 64 ", b" 64 48 128 ")})
    with pytest.raises(djpt.SceneError, match=r"must have the size of the picture, 64 x 48, found 128 x 48"):
        djpt.load_cameras(tmp_path)


def test_a_rotation_of_length_0_is_refused(tmp_path):
    files = colmap_text()
    lines = files["images.txt"].decode().splitlines()
    words = lines[1].split()
    lines[1] = " ".join([words[0], "0", "0", "0", "0", *words[5:]])
    write(tmp_path, {**files, "images.txt": "\n".join(lines)})
    with pytest.raises(djpt.SceneError, match="must be a quaternion of length 1"):
        djpt.load_cameras(tmp_path)


def test_a_folder_without_cameras_says_what_was_looked_for(tmp_path):
    with pytest.raises(djpt.FileError, match=r"holds no cameras; looked for cameras\.bin .* transforms\.json"):
        djpt.load_cameras(tmp_path)
    write(tmp_path, {"cameras.txt": colmap_text()["cameras.txt"]})
    with pytest.raises(djpt.FileError, match=r"'images\.txt' doesn't exist"):
        djpt.load_cameras(tmp_path)
    assert len(PLACES) == 2

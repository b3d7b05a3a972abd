"""Photographs as sensors and targets, and files of strangers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from tests.kit.photographs import (
    HEIGHT,
    WIDTH,
    bundle,
    calibration,
    colmap_binary,
    colmap_text,
    transforms,
    write,
)
from tests.photographs.projected import points_before, shown


def scene(**sensors: Any) -> Any:
    """A ball on a floor, under a sky."""
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sky": {"type": "constant"},
            "ball": {"type": "sphere", "radius": 0.4},
            "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "checkerboard"}}},
            **sensors,
        }
    )


def test_photographs_match_what_the_cameras_render(tmp_path):
    """Rendered, written with a `transforms.json`, and read: a batch shows the same."""
    write(tmp_path, {"transforms.json": transforms(k1=-0.1, p1=0.01)})
    first = djpt.load_cameras(tmp_path)
    world = scene(**first.sensors())
    images = [np.array(djpt.render(world, sensor=n, spp=64)) for n in range(2)]
    for n, image in enumerate(images):
        djpt.write(tmp_path / f"view {n}.exr", image)
    photographs = djpt.load_cameras(tmp_path / "transforms.json")
    assert np.array_equal(photographs.targets(), images)
    strip = photographs.strip()
    rendered = np.array(djpt.render(scene(sensor=photographs.batch()), spp=64, seed=1))
    assert rendered.shape == strip.shape == (HEIGHT, 2 * WIDTH, 3)
    assert np.abs(rendered - strip).mean() < 0.02 < np.abs(rendered - strip[:, ::-1]).mean()


def test_sizes_change_together(tmp_path):
    write(tmp_path, {"transforms.json": transforms(k1=-0.1)})
    photographs = djpt.load_cameras(tmp_path)
    points = points_before(0)
    before = shown(photographs[0], points)
    for smaller, factors in (
        (photographs.resized(32), (0.5, 0.5)),
        (photographs.resized(32, 96), (0.5, 2.0)),
    ):
        lens = smaller[0].lens
        assert (lens.width, lens.height) == (32, HEIGHT * factors[1])
        np.testing.assert_allclose(shown(smaller[0], points), before * factors, atol=1e-4)


def test_targets_are_means_of_pixels(tmp_path):
    write(tmp_path, {"transforms.json": transforms()})
    picture = np.random.default_rng(1).random((HEIGHT, WIDTH, 3), np.float32)
    djpt.write(tmp_path / "view 0.exr", picture)
    view = djpt.load_cameras(tmp_path)[:1].resized(16)
    assert len(view) == 1
    expected = picture.reshape(12, 4, 16, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(view[0].target(), expected, rtol=1e-5)
    # Parts that end within a pixel.
    expected = picture.repeat(3, axis=0).repeat(3, axis=1).reshape(18, 8, 24, 8, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(view.resized(24)[0].target(), expected, rtol=1e-5)


def test_transparent_pictures_are_laid_over_a_background(tmp_path):
    write(tmp_path, {"transforms.json": transforms()})
    picture = np.ones((HEIGHT, WIDTH, 4), np.float32)
    picture[: HEIGHT // 2, :, 3] = 0
    djpt.write(tmp_path / "view 0.png", picture)
    view = djpt.load_cameras(tmp_path)[0]
    for background in (0.0, 0.25):
        target = view.target(background)
        assert np.all(target[: HEIGHT // 2] == background) and np.all(target[HEIGHT // 2 :] == 1)
    (tmp_path / "view 0.png").unlink()
    djpt.write(tmp_path / "view 0.exr", np.full((HEIGHT, WIDTH, 4), 0.5, np.float32))  # multiplied already
    np.testing.assert_allclose(djpt.load_cameras(tmp_path)[0].target(0.25), 0.625)


def test_pictures_of_another_shape_are_refused(tmp_path):
    write(tmp_path, {"transforms.json": transforms(), "view 1.png": b"no picture"})
    djpt.write(tmp_path / "view 0.png", np.zeros((10, 20, 3), np.float32))
    photographs = djpt.load_cameras(tmp_path)
    with pytest.raises(djpt.FileError, match=r"view 0\.png' has 20 x 10 pixels, its camera 64 x 48, which is another"):
        photographs[0].target()
    with pytest.raises(djpt.FileError, match=r"can't read '.*view 1\.png'"):
        photographs[1].target()


def test_parts_and_sizes_of_batches(tmp_path):
    file = transforms()
    file["frames"][1] |= {"w": 32, "h": 24}
    write(tmp_path, {"transforms.json": file})
    photographs = djpt.load_cameras(tmp_path)
    assert [len(photographs[x]) for x in (slice(1), [1, 0], slice(5, 9))] == [1, 2, 0]
    assert photographs[[1, 0]][0].name == photographs[1].name
    with pytest.raises(djpt.SceneError, match=r"transforms\.json: .* must have one size, found 32 x 24 and 64 x 48"):
        photographs.batch()
    with pytest.raises(djpt.SceneError, match="there are no photographs"):
        photographs[:0].strip()
    batch = djpt.load_dict(photographs.resized(20, 10).batch(near_clip=0.1))
    assert [list(sensor.film().size()) for sensor in batch.sensors] == [[20, 10]] * 2


def test_scenes_keep_the_order_of_many_cameras(tmp_path):
    file = transforms()
    file["frames"] = [{**file["frames"][0], "fl_x": 50.0 + n} for n in range(12)]
    write(tmp_path, {"transforms.json": file})
    sensors = scene(**djpt.load_cameras(tmp_path).resized(8).sensors()).sensors()
    fovs = [sensor.x_fov[0] for sensor in sensors]
    assert len(fovs) == 12 and fovs == sorted(fovs, reverse=True)


@pytest.mark.parametrize("name", ["../secret.png", "/etc/hostname", "link.png"])
def test_no_picture_outside_of_the_folder_is_read(tmp_path, name):
    djpt.write(tmp_path / "secret.png", np.zeros((HEIGHT, WIDTH, 3), np.float32))
    file = transforms()
    file["frames"][0]["file_path"] = name
    folder = write(tmp_path / "set", {"transforms.json": file})
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    assert djpt.load_cameras(folder)[0].path is None


def test_what_holds_no_cameras_is_refused(tmp_path):
    write(tmp_path, {"a.txt": b"", "a.json": b"{}", "b.json": b"[]", "frames.json": {"frames": []}})
    with pytest.raises(djpt.FileError, match=r"a\.txt' holds no cameras; possible: cameras\.bin"):
        djpt.load_cameras(tmp_path / "a.txt")
    with pytest.raises(djpt.SceneError, match=r"a\.json: has no camera matrix"):
        djpt.load_cameras(tmp_path / "a.json")
    with pytest.raises(djpt.SceneError, match=r"b\.json: must hold an object, found list"):
        djpt.load_cameras(tmp_path / "b.json")
    with pytest.raises(djpt.FileError, match="there is no such file"):
        djpt.load_cameras(tmp_path / "c.json")
    assert len(djpt.load_cameras(tmp_path / "frames.json")) == 0
    with pytest.raises(djpt.FileError, match=r"there is no folder '.*nowhere' of photographs"):
        djpt.load_cameras(tmp_path / "frames.json", tmp_path / "nowhere")
    for size, message in (((8,), "must have 2 numbers, found 1"), ((8, 0), "must be a whole number from 1")):
        with pytest.raises(djpt.SceneError, match=f"'size' {message}"):
            djpt.load_cameras(tmp_path / "frames.json", size=size)


KINDS: dict[str, tuple[dict[str, Any], str]] = {
    "text": (colmap_text(), "images.txt"),
    "cameras": (colmap_text(), "cameras.txt"),
    "points": (colmap_text(), "points3D.txt"),
    "binary": (colmap_binary(), "images.bin"),
    "binary cameras": (colmap_binary("RADIAL"), "cameras.bin"),
    "binary points": (colmap_binary(), "points3D.bin"),
    "nerf": ({"transforms.json": transforms(k1=0.1)}, "transforms.json"),
    "bundler": ({"bundle.out": bundle()}, "bundle.out"),
    "opencv": ({"camera.yml": calibration()}, "camera.yml"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sparse(4)
def test_damaged_files_are_read_or_refused(tmp_path, kind):
    """Cut, or with some bytes changed: an error names the file, and nothing else is raised."""
    if kind == "opencv":
        pytest.importorskip("yaml")
    files, name = KINDS[kind]
    path = write(tmp_path, files) / name
    data, rng, refused = path.read_bytes(), np.random.default_rng(3), 0
    for n in range(60):
        damaged = bytearray(data)
        if n % 3 == 0:
            damaged = damaged[: rng.integers(len(data))]
        for at in rng.integers(0, len(damaged), n % 5) if damaged else ():
            damaged[at] = rng.choice([0, 9, 32, 45, 48, 57, 101, 127, 255]) if n % 2 else rng.integers(256)
        path.write_bytes(bytes(damaged))
        try:
            photographs = djpt.load_cameras(path, size=(WIDTH, HEIGHT) if kind == "bundler" else None, points=True)
            photographs.sensors()
        except djpt.DjptError as error:
            assert name in str(error), error
            refused += 1
    assert refused > 10

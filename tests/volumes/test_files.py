"""Volumes: grids on the host, Mitsuba's files of them, and wrong descriptions."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import ArgumentError, FileError, SceneError
from djpt.jit.types import Point3f, TensorXf

NUMBERS = np.random.default_rng(3).random((2, 3, 4, 3), dtype=np.float32)


@pytest.mark.parametrize("channels", [0, 1, 3, 6])
def test_files_are_mitsubas_byte_for_byte(mi: Any, tmp_path: Path, channels: int) -> None:
    numbers = np.random.default_rng(3).random((2, 3, 4, channels) if channels else (2, 3, 4), dtype=np.float32)
    mine, his = str(tmp_path / "mine.vol"), str(tmp_path / "his.vol")
    djpt.VolumeGrid(numbers).write(mine)
    mi.VolumeGrid(numbers).write(his)
    assert Path(mine).read_bytes() == Path(his).read_bytes()
    grid, other = djpt.VolumeGrid(his), mi.VolumeGrid(his)
    np.testing.assert_array_equal(np.array(grid), np.array(other))
    for method in ("size", "channel_count", "max", "max_per_channel", "bytes_per_voxel", "buffer_size"):
        np.testing.assert_allclose(getattr(grid, method)(), getattr(other, method)())


def test_sources_of_grids(tmp_path: Path) -> None:
    stream = io.BytesIO()
    djpt.VolumeGrid(NUMBERS).write(stream)
    path = tmp_path / "grid.vol"
    path.write_bytes(stream.getvalue())
    stream.seek(0)
    for source in (path, str(path), stream, NUMBERS, TensorXf(NUMBERS), NUMBERS.astype(np.float64)):
        grid = djpt.VolumeGrid(source)
        np.testing.assert_array_equal(np.array(grid), NUMBERS)
        assert list(grid.size()) == [4, 3, 2] and abs(grid.max() - NUMBERS.max()) < 1e-7
    assert (djpt.VolumeGrid(NUMBERS, False).max(), djpt.VolumeGrid(array=NUMBERS, compute_max=False).max()) == (0, 0)
    assert "size = [4, 3, 2]" in repr(djpt.VolumeGrid(NUMBERS))


def test_largest_numbers_can_be_stated() -> None:
    grid = djpt.VolumeGrid(NUMBERS)
    grid.set_max(9)
    grid.set_max_per_channel([1, 2, 3])
    assert (grid.max(), grid.max_per_channel()) == (9, [1, 2, 3])
    with pytest.raises(ArgumentError, match="expected 3 numbers, found 1"):
        grid.set_max_per_channel([1])


def test_broken_files_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "grid.vol"
    with pytest.raises(FileError, match="there is no such file"):
        djpt.VolumeGrid(path)
    djpt.VolumeGrid(NUMBERS).write(path)
    whole = path.read_bytes()
    for content, message in [
        (b"LOV" + whole[3:], "isn't a volume file"),
        (whole[:20], "isn't a volume file"),
        (whole[:3] + b"\2" + whole[4:], "has version 2 and numbers of type 1"),
        (whole[:-1], "ends too early for 4 x 3 x 2 points with 3 numbers each"),
    ]:
        path.write_bytes(content)
        with pytest.raises(FileError, match=message):
            djpt.VolumeGrid(path)
    with pytest.raises(FileError, match="there is no folder"):
        djpt.VolumeGrid(NUMBERS).write(tmp_path / "nowhere" / "grid.vol")
    for array in (np.ones(3), np.ones((1, 1, 1, 1, 1)), np.array([["a"]])):
        with pytest.raises(ArgumentError, match="a grid must be numbers of the shape"):
            djpt.VolumeGrid(array)


def test_three_sources_of_a_volume(tmp_path: Path) -> None:
    path = tmp_path / "grid.vol"
    grid = djpt.VolumeGrid(NUMBERS)
    grid.write(path)
    xml = f'<volume version="3.0.0" type="gridvolume"><string name="filename" value="{path}"/></volume>'
    sources = ({"filename": str(path)}, {"grid": grid}, {"data": NUMBERS}, {"data": TensorXf(NUMBERS)})
    volumes = [djpt.load_dict({"type": "gridvolume", **source}) for source in sources]
    for volume in [*volumes, djpt.load_string(xml)]:
        np.testing.assert_array_equal(np.array(volume.data), NUMBERS)


def test_a_grid_may_fill_the_box_of_its_file(tmp_path: Path, mi: Any) -> None:
    path = tmp_path / "grid.vol"
    djpt.VolumeGrid(NUMBERS).write(path)
    content = bytearray(path.read_bytes())
    content[24:48] = np.array([-1, 0, 1, 3, 2, 4], "<f4").tobytes()
    path.write_bytes(content)
    point = [0.3, 1.4, 2.5]
    for to_world in ([], [1, 2, 3]):
        found = []
        for module in (djpt, mi):
            described: dict[str, Any] = {"type": "gridvolume", "filename": str(path), "use_grid_bbox": True}
            if to_world:
                described["to_world"] = module.ScalarTransform4f().translate(to_world).scale(0.5)
            volume = module.load_dict(described)
            it = dr.zeros(module.Interaction3f)
            it.p = module.Point3f(point)
            box = volume.bbox()
            found.append([*np.array(volume.eval(it)).ravel(), *np.array(box.min), *np.array(box.max)])
        np.testing.assert_allclose(*found, rtol=1e-5)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "'gridvolume' needs one of filename, grid, data; found none"),
        ({"data": NUMBERS, "filename": "x"}, "found 'filename' and 'data'"),
        ({"filename": "nowhere.vol"}, "'filename' 'nowhere.vol' doesn't exist"),
        ({"data": NUMBERS[0, 0]}, "'data' a grid must be numbers of the shape"),
        ({"data": np.ones((2, 2, 2, 4))}, "with 1, 3 or 6 channels, found"),
        ({"data": np.full((1, 1, 1), np.inf)}, "'data' must be finite, found inf at x = 0, y = 0, z = 0"),
        ({"data": NUMBERS, "filter_type": "linear"}, "'filter_type' can't be 'linear'"),
        ({"data": NUMBERS, "wrap_mode": "none"}, "'wrap_mode' can't be 'none'"),
        ({"data": NUMBERS, "use_grid_bbox": True}, "'use_grid_bbox' needs a 'filename' or a 'grid'"),
        ({"data": NUMBERS, "colour": 1}, "unknown key 'colour' of volume 'gridvolume'"),
    ],
)
def test_messages_name_what_is_wrong(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict({"type": "gridvolume", **keys})


def test_constants_do_not_vary() -> None:
    with pytest.raises(SceneError, match="'value' must be the same everywhere; a 'gridvolume' varies in space"):
        djpt.load_dict({"type": "constvolume", "value": {"type": "checkerboard"}})
    volume = djpt.load_dict({"type": "constvolume", "value": 2})
    it = dr.zeros(djpt.Interaction3f)
    it.p = Point3f(5)
    assert volume.eval_1(it) == 2 and volume.is_grey and volume.is_constant
    assert not djpt.load_dict({"type": "constvolume", "value": {"type": "rgb", "value": [1, 2, 3]}}).is_grey

"""Files of OpenVDB: what is read of them, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import FileError, SceneError
from djpt.volumes.volume_grid import read_openvdb
from tests.kit.openvdb import vdb_bytes

NUMBERS = np.random.default_rng(0).random((10, 5, 12), dtype=np.float32) + 0.1


@pytest.fixture
def path(tmp_path: Path) -> Path:
    pytest.importorskip("tinyvdb")
    file = tmp_path / "smoke.vdb"
    file.write_bytes(vdb_bytes({"density": NUMBERS, "heat": 2 * NUMBERS}, (6, 3, 9), 0.25))
    return file


def test_voxels_and_their_box(path: Path) -> None:
    grid = read_openvdb(path)
    np.testing.assert_array_equal(np.array(grid), NUMBERS.transpose(2, 1, 0))
    np.testing.assert_allclose(np.array(grid.bbox().min), (np.array([6, 3, 9]) - 0.5) / 4)
    np.testing.assert_allclose(np.array(grid.bbox().max), (np.array([15, 7, 20]) + 0.5) / 4)
    np.testing.assert_array_equal(np.array(read_openvdb(path, "heat")), 2 * NUMBERS.transpose(2, 1, 0))


def test_a_volume_stands_where_the_file_says(path: Path) -> None:
    """At the centres of voxels interpolation gives their numbers."""
    named = {"filename": str(path), "grid_name": "heat", "use_grid_bbox": True}
    volume = djpt.load_dict({"type": "gridvolume", **named})
    place = np.random.default_rng(1).integers(NUMBERS.shape, size=(50, 3))
    it = dr.zeros(djpt.Interaction3f, 50)
    it.p = djpt.Point3f(((place + np.array([6, 3, 9])) / 4).T.astype(np.float32))
    np.testing.assert_allclose(np.array(volume.eval_1(it)), 2 * NUMBERS[tuple(place.T)], rtol=1e-4)


def test_voxels_that_are_not_active_are_background(tmp_path: Path) -> None:
    pytest.importorskip("tinyvdb")
    file = tmp_path / "corners.vdb"
    numbers = np.full((9, 30, 9), np.nan, np.float32)
    numbers[0, 0, 0] = numbers[8, 29, 8] = 2
    file.write_bytes(vdb_bytes({"only": numbers}, (0, 0, 0), background=0.5))
    found = np.array(read_openvdb(file))
    np.testing.assert_array_equal(found, np.nan_to_num(numbers, nan=0.5).transpose(2, 1, 0))


def test_messages_name_what_is_wrong(path: Path) -> None:
    with pytest.raises(FileError, match="has no grid of numbers called 'density2'; did you mean 'density'"):
        read_openvdb(path, "density2")
    with pytest.raises(SceneError, match=r"'filename' .*has no grid of numbers called 'soot'; possible: density"):
        djpt.load_dict({"type": "gridvolume", "filename": str(path), "grid_name": "soot"})
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(FileError, match="can't be read as an OpenVDB file"):
        read_openvdb(path)


def test_files_with_tiles_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("tinyvdb")
    file = tmp_path / "tiles.vdb"
    file.write_bytes(vdb_bytes({"density": NUMBERS}, stated=NUMBERS.size + 512))
    with pytest.raises(FileError, match="has 1112 active voxels, of which 600 are stored one by one"):
        read_openvdb(file)
    file.write_bytes(vdb_bytes({"density": NUMBERS}, stated=NUMBERS.size))
    assert read_openvdb(file).buffer_size() == 4 * NUMBERS.size


def test_without_the_package_a_message_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tinyvdb", None)
    with pytest.raises(FileError, match=r"need the package tinyvdb: pip install tinyvdb"):
        read_openvdb(tmp_path / "smoke.vdb")

"""Tensor files: named arrays, written by djpt and read by Mitsuba, and the other way round."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.errors import ArgumentError, FileError
from djpt.jit.types import Float, TensorXf, backend

TENSORS = {
    "grid": np.arange(24, dtype=np.float32).reshape(2, 3, 4),
    "bytes": np.arange(5, dtype=np.uint8),
    "wide": np.array([[1, -2], [3, 4]], np.int64),
    "exact": np.array([0.1, 1e300]),
    "half": np.array([0.5, 2], np.float16),
    "one": np.float32([3]),
}


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "tensors.bin"
    djpt.tensor_io.write(path, **TENSORS, text="hello")
    found = djpt.tensor_io.read(path)
    assert bytes(found.pop("text")) == b"hello"
    assert list(found) == list(TENSORS)
    for name, tensor in TENSORS.items():
        assert found[name].dtype == tensor.dtype and found[name].shape == tensor.shape
        np.testing.assert_array_equal(found[name], tensor)


@pytest.mark.parametrize("align", [1, 8, 64])
def test_files_are_mitsubas_byte_for_byte(mi: Any, tmp_path: Path, align: int) -> None:
    mine, his = str(tmp_path / "mine"), str(tmp_path / "his")
    djpt.tensor_io.write(mine, align=align, **TENSORS)
    mi.tensor_io.write(his, align=align, **TENSORS)
    assert Path(mine).read_bytes() == Path(his).read_bytes()
    assert str(djpt.TensorFile(his)) == str(mi.TensorFile(his))
    assert str(djpt.TensorFile(his)["grid"]) == str(mi.TensorFile(his)["grid"])


def test_an_object_gives_single_tensors(tmp_path: Path) -> None:
    path = str(tmp_path / "tensors.bin")
    djpt.tensor_io.write(path, **TENSORS)
    file = djpt.TensorFile(path)
    assert "grid" in file and "grids" not in file
    assert (file.filename(), file.size()) == (path, Path(path).stat().st_size)
    assert file["grid"].shape == [2, 3, 4] and file["grid"].dtype.name == "Float32"
    np.testing.assert_array_equal(file["grid"].to(TensorXf).numpy(), TENSORS["grid"])
    with pytest.raises(ArgumentError, match="holds float32, not uint32"):
        file["grid"].to(backend.TensorXu)
    with pytest.raises(ArgumentError, match=r"expected a type of Dr\.Jit's tensors"):
        file["grid"].to(Float)
    with pytest.raises(FileError, match="has no field 'gird'; did you mean 'grid'"):
        file["gird"]


def test_broken_files_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "tensors.bin"
    with pytest.raises(FileError, match="there is no such file"):
        djpt.tensor_io.read(path)
    path.write_bytes(b"something else")
    with pytest.raises(FileError, match=r"isn't a tensor file of version 1\.0"):
        djpt.tensor_io.read(path)
    djpt.tensor_io.write(path, **TENSORS)
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    with pytest.raises(FileError, match="ends within the field 'one'"):
        djpt.tensor_io.read(path)
    path.write_bytes(whole[:30])
    with pytest.raises(FileError, match="ends within the list of its fields"):
        djpt.tensor_io.read(path)
    path.write_bytes(whole.replace(b"bytes\x01\x00\x01", b"bytes\x01\x00\x20"))
    with pytest.raises(FileError, match="'bytes' has numbers of an unknown type, number 32"):
        djpt.tensor_io.read(path)


def test_only_numbers_are_written(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="'flags' must hold numbers, found bool"):
        djpt.tensor_io.write(tmp_path / "x", flags=np.array([True]))
    with pytest.raises(ArgumentError, match="give tensors by keywords"):
        djpt.tensor_io.write(tmp_path / "x", TENSORS)
    with pytest.raises(FileError, match="there is no folder"):
        djpt.tensor_io.write(tmp_path / "nowhere" / "x", **TENSORS)


@pytest.mark.parametrize("size", [0, 12, 1023, 1024, 123456789, 5e20])
def test_sizes_are_worded_as_in_mitsuba(mi: Any, size: float) -> None:
    assert djpt.tensor_io.size_fmt(size) == mi.tensor_io.size_fmt(size)

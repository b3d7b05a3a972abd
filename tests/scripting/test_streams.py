"""Streams, paths, mapped files and files of tensors: what one writes the other reads, and what Mitsuba reads."""

from __future__ import annotations

import gzip
import io
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt import filesystem as fs
from djpt.errors import FileError

NUMBERS = {
    "int8": -5, "uint8": 250, "int16": -3000, "uint16": 60000, "int32": -7, "uint32": 2**32 - 1, "int64": -(2**40),
    "uint64": 2**63, "single": 0.5, "float": 0.25, "double": 1 / 3, "bool": True, "string": "smörgåsbord",
}  # fmt: skip


def fill(stream: Any) -> None:
    for kind, value in NUMBERS.items():
        getattr(stream, f"write_{kind}")(value)
    stream.write_line("a line")
    stream.write(b"\0bytes")


def check(stream: Any) -> None:
    for kind, value in NUMBERS.items():
        assert getattr(stream, f"read_{kind}")() == value
    assert stream.read_line() == "a line"
    assert stream.read(6) == b"\0bytes"


@pytest.mark.parametrize("big", [False, True])
def test_bytes_are_those_of_mitsuba(big: bool, mi: Any) -> None:
    found = []
    for m in (djpt, mi):
        stream = m.MemoryStream(8)
        if big:
            stream.set_byte_order(m.Stream.EByteOrder.EBigEndian)
        fill(stream)
        found.append(stream.raw_buffer())
        stream.seek(0)
        check(stream)
        assert stream.size() == stream.tell() == len(found[-1])
    assert found[0] == found[1]


def test_files_are_those_of_mitsuba(tmp_path: Path, mi: Any) -> None:
    for writer, reader in ((djpt, mi), (mi, djpt)):
        path = str(tmp_path / writer.__name__)
        stream = writer.FileStream(path, writer.FileStream.ETruncReadWrite)
        fill(stream)
        stream.close()
        check(reader.FileStream(path))


def test_sizes_and_positions() -> None:
    for stream in (djpt.MemoryStream(), djpt.DummyStream()):
        stream.truncate(10)
        assert (stream.size(), stream.tell()) == (10, 0)
        stream.seek(30)
        assert stream.size() == 10
        stream.write(b"x")
        assert stream.size() == 31
        stream.truncate(5)
        assert (stream.size(), stream.tell()) == (5, 5)
        stream.seek(0)
        stream.skip(2)
        assert stream.tell() == 2


def test_what_a_stream_refuses(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="3: can't be opened: No such file"):
        djpt.FileStream(tmp_path / "3")
    (tmp_path / "4").write_bytes(b"abc")
    stream = djpt.FileStream(tmp_path / "4")
    with pytest.raises(FileError, match="FileStream: the stream can't be written"):
        stream.write_int8(1)
    with pytest.raises(FileError, match="8 bytes were to be read, found 3 before the end"):
        stream.read_double()
    stream.close()
    assert not stream.can_read() and not stream.can_write()
    with pytest.raises(FileError, match="the stream is closed"):
        stream.tell()
    with pytest.raises(FileError, match="can't be read"):
        djpt.DummyStream().read(1)
    with pytest.raises(FileError, match="can't write 300 as a uint8"):
        djpt.MemoryStream().write_uint8(300)


def test_python_takes_streams() -> None:
    stream = djpt.MemoryStream()
    pickle.dump({"a": 1}, stream)
    stream.seek(0)
    assert pickle.load(stream) == {"a": 1}
    stream = djpt.MemoryStream()
    djpt.Bitmap(np.full((2, 3, 3), 0.5, np.float32)).write(stream, djpt.Bitmap.FileFormat.PFM)
    stream.seek(0)
    assert np.array(djpt.Bitmap(stream)).shape == (2, 3, 3)
    stream = djpt.MemoryStream()
    with gzip.open(stream, "wb") as packed:
        packed.write(b"compressed")
    stream.seek(0)
    with gzip.open(stream) as packed:
        assert packed.read() == b"compressed"
    stream = djpt.MemoryStream()
    text = io.TextIOWrapper(stream)
    json.dump([1, 2], text)
    text.flush()
    assert stream.raw_buffer() == b"[1, 2]"


@pytest.mark.parametrize("form", ["EDeflateStream", "EGZipStream"])
def test_compressed_streams_are_those_of_mitsuba(form: str, tmp_path: Path, mi: Any) -> None:
    for writer, reader in ((djpt, mi), (mi, djpt), (djpt, djpt)):
        path = str(tmp_path / "packed")
        child = writer.FileStream(path, writer.FileStream.ETruncReadWrite)
        stream = writer.ZStream(child, getattr(writer.ZStream, form))
        fill(stream)
        stream.flush()
        stream.write(b"more")
        del stream
        child.close()
        stream = reader.ZStream(reader.FileStream(path), getattr(reader.ZStream, form))
        check(stream)
        assert stream.read(4) == b"more"


def test_what_a_compressed_stream_refuses() -> None:
    child = djpt.MemoryStream()
    stream = djpt.ZStream(child)
    assert stream.child_stream() is child and "ZStream[\n  host_byte_order" in repr(stream)
    with pytest.raises(FileError, match="no positions"):
        stream.size()
    child.write(b"plain")
    child.seek(0)
    with pytest.raises(FileError, match="can't be decompressed"):
        djpt.ZStream(child).read(1)


@pytest.mark.parametrize("kind", ["DummyStream", "MemoryStream"])
def test_representations_are_those_of_mitsuba(kind: str, mi: Any) -> None:
    mine, other = (getattr(m, kind)() for m in (djpt, mi))
    for stream in (mine, other):
        stream.write_string("text")
    assert repr(mine) == repr(other)


def test_meshes_write_to_streams(tmp_path: Path) -> None:
    mesh, stream = djpt.Mesh("m", np.eye(3), [[0, 1, 2]]), djpt.MemoryStream()
    mesh.write_ply(stream=stream)
    mesh.write_ply(tmp_path / "m.ply")
    assert stream.raw_buffer() == (tmp_path / "m.ply").read_bytes()


PATHS = ["", ".", "..", "a", "a/b.c", "/a/b", "./a/../b", "a.b/c", ".hidden", "a/", "/", "a.tar.gz"]


@pytest.mark.parametrize("text", PATHS)
def test_paths_are_taken_apart_as_in_mitsuba(text: str, mi: Any) -> None:
    mine, other = fs.path(text), mi.filesystem.path(text)
    for question in ("empty", "is_absolute", "is_relative", "native", "filename", "extension", "parent_path"):
        assert str(getattr(mine, question)()) == str(getattr(other, question)()), question
    assert str(mine / "x.y") == str(other / "x.y") == str(fs.path(mine) / fs.path("x.y"))
    assert str(mine.replace_extension("png")) == str(other.replace_extension("png"))


def test_files_by_paths(tmp_path: Path) -> None:
    folder = fs.path(tmp_path) / "new"
    assert fs.create_directory(folder) and fs.is_directory(folder) and not fs.is_regular_file(folder)
    file, copied = folder / "a.txt", folder / "b.txt"
    Path(file).write_text("hello")
    assert fs.file_size(file) == 5 and fs.resize_file(file, 3) and fs.copy_file(file, copied)
    assert Path(copied).read_text() == "hel" and not fs.equivalent(file, copied)
    assert fs.equivalent(file, folder / "." / "a.txt") and fs.absolute(folder / "..") == fs.path(tmp_path)
    assert not fs.remove(folder) and fs.remove(file) and not fs.remove(file) and not fs.exists(file)
    with pytest.raises(FileError, match="the size isn't known"):
        fs.file_size(file)
    assert fs.current_path() == Path.cwd()


def test_files_in_memory(tmp_path: Path) -> None:
    path = tmp_path / "bytes"
    file = djpt.MemoryMappedFile(path, np.arange(4, dtype=np.uint16))
    assert np.array(file).view(np.uint16).tolist() == [0, 1, 2, 3] and file.can_write()
    file.resize(4)
    np.asarray(file)[:] = 7
    assert djpt.MemoryMappedFile(path).size() == 4 and path.read_bytes() == b"\7\7\7\7"
    with pytest.raises(FileError, match="can't be resized"):
        djpt.MemoryMappedFile(path).resize(2)
    temporary = djpt.MemoryMappedFile.create_temporary(3)
    name = Path(temporary.filename())
    assert name.stat().st_size == 3
    del temporary
    assert not name.exists()
    with pytest.raises(FileError, match="can't be mapped"):
        djpt.MemoryMappedFile(tmp_path / "none")

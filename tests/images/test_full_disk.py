"""Writers on a full disk: an error that names the file, and no trace of it.

A limit of the size of files stands for the disk: the system refuses what is beyond it, in the middle of a file.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.animation.frames import write_movie
from djpt.errors import FileError
from djpt.images.formats import FORMATS
from tests.long_renders.test_passes import box, last

resource = pytest.importorskip("resource")

NOISE = np.random.default_rng(1).random((96, 96, 3), np.float32)


@contextlib.contextmanager
def full_disk(room: int) -> Iterator[None]:
    """Let files have so many bytes at most."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def require_refused(folder: Path, write: Callable[[], Any], what: str) -> None:
    for room in (0, 500, 3000):
        with full_disk(room), pytest.raises(FileError, match=rf"can't write '.*{what}'"):
            write()
        assert not list(folder.iterdir())


@pytest.mark.parametrize("suffix", FORMATS)
def test_images(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    require_refused(tmp_path, lambda: djpt.write(path, NOISE), path.name)
    exact = suffix in (".exr", ".hdr", ".pfm", ".npy")
    bitmap = djpt.Bitmap(NOISE if exact else (NOISE * 255).astype(np.uint8))
    require_refused(tmp_path, lambda: bitmap.write(path), path.name)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.sparse(3)
def test_images_that_are_written_while_they_are_computed(suffix: str, tmp_path: Path) -> None:
    """Of more pixels than a file holds back: what was refused is tried again when it is closed."""
    path, scene = tmp_path / f"a{suffix}", box(size=96)
    djpt.render_to_file(scene, path, spp=1)
    path.unlink()
    require_refused(tmp_path, lambda: djpt.render_to_file(scene, path, spp=1), path.name)


def test_an_image_that_exists_stays(tmp_path: Path) -> None:
    path, scene = tmp_path / "a.pfm", box(size=96)
    path.write_text("old")
    with full_disk(3000), pytest.raises(FileError):
        djpt.render_to_file(scene, path, spp=1)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def mesh() -> djpt.Mesh:
    places = np.random.default_rng(1).random((999, 3)).astype(np.float32)
    return djpt.Mesh("m", vertex_positions=places, faces=np.arange(999).reshape(-1, 3))


WRITERS: dict[str, Callable[[Path], Any]] = {
    "a.ply": lambda path: mesh().write_ply(str(path)),
    "a.vol": lambda path: djpt.VolumeGrid(np.zeros((20, 20, 20, 1), np.float32)).write(path),
    "a.tensors": lambda path: djpt.tensor_io.write(path, a=np.zeros(9999)),
    "a.spd": lambda path: djpt.spectrum_to_file(path, list(range(400, 900)), [0.12345] * 500),
    "a.xml": lambda path: djpt.write_dict(
        path, {"type": "scene", **{f"shape{i}": {"type": "sphere", "radius": 1.0 + i} for i in range(99)}}
    ),
}


@pytest.mark.parametrize("name", WRITERS)
def test_other_files(name: str, tmp_path: Path) -> None:
    require_refused(tmp_path, lambda: WRITERS[name](tmp_path / name), name)


def test_checkpoints(tmp_path: Path) -> None:
    found = last(box(size=16), spp=1)
    require_refused(tmp_path, lambda: found.save(tmp_path / "a.djpt"), "a.djpt")


def test_streams(tmp_path: Path) -> None:
    """Whatever notices that the disk is full, bytes that are held back included."""
    path = tmp_path / "a.bin"
    for room, end in ((10, "close"), (10, "flush"), (10**5, "write")):
        stream = djpt.FileStream(str(path), djpt.FileStream.ETruncReadWrite)
        with full_disk(room), pytest.raises(FileError, match=r"can't write '.*a\.bin'"):
            stream.write(bytes(2000))
            stream.write(bytes(10**6 if end == "write" else 1))
            getattr(stream, end)()


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
@pytest.mark.sparse(2)
def test_movies(suffix: str, tmp_path: Path) -> None:
    if suffix == "mp4":
        pytest.importorskip("imageio_ffmpeg")
    frame, folder = tmp_path / "frame.png", tmp_path / "movies"
    djpt.write(frame, NOISE)
    folder.mkdir()
    path = folder / f"a.{suffix}"
    require_refused(folder, lambda: write_movie(path, [frame] * 3, 10), path.name)
    write_movie(path, [frame] * 3, 10)
    assert path.stat().st_size > 3000


@pytest.mark.skipif(sys.platform != "linux", reason="has no /dev/full")
def test_the_command_names_the_file(tmp_path: Path) -> None:
    from tests.kit.commands import run

    arguments = ("render", "cornell_box", "--width", "96", "--spp", "1", "-o", str(tmp_path / "a.pfm"), "-q")
    assert run(*arguments)[0] == 0
    with full_disk(3000):
        code, _, error = run(*arguments)
    assert (code, error) == (2, f"djpt: error: can't write '{tmp_path / 'a.pfm'}': file too large\n")

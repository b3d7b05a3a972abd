"""What all writers of files have in common: nothing but files is replaced, and a failed writing leaves no trace."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from tests.kit.processes import run_python

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="has no pipes and devices among its files")

IMAGE = np.full((8, 8, 3), 0.5, np.float32)


def triangle() -> djpt.Mesh:
    return djpt.Mesh("m", vertex_positions=[[0, 0, 0], [1, 0, 0], [0, 1, 0]], faces=[[0, 1, 2]])


SUFFIXES = ("exr", "hdr", "pfm", "npy", "png", "jpg", "bmp", "tga", "ppm", "tif")
WRITERS: dict[str, Callable[[Any], Any]] = {
    **{f"a.{suffix}": lambda path: djpt.write(path, IMAGE) for suffix in SUFFIXES},
    "b.exr": lambda path: djpt.Bitmap(IMAGE).write(path),
    "b.png": lambda path: djpt.util.write_bitmap(path, IMAGE, write_async=False),
    "a.xml": lambda path: djpt.xml.dict_to_xml({"type": "scene"}, path),
    "b.xml": lambda path: djpt.write_dict(path, {"type": "scene"}),
    "a.ply": lambda path: triangle().write_ply(path),
    "a.vol": lambda path: djpt.VolumeGrid(np.zeros((2, 2, 2, 1), np.float32)).write(path),
    "a.tensors": lambda path: djpt.tensor_io.write(path, a=np.zeros(3)),
    "a.spd": lambda path: djpt.spectrum_to_file(path, [400.0, 500.0], [1.0, 2.0]),
}
"""Functions that write a file, by a name that it may have."""


@pytest.mark.parametrize("name", WRITERS)
def test_writing_works(tmp_path: Path, name: str) -> None:
    WRITERS[name](str(tmp_path / name))
    assert os.listdir(tmp_path) == [name] and (tmp_path / name).stat().st_size


@pytest.mark.parametrize("kind", ["a pipe", "a device", "a folder", "a folder with files"])
@pytest.mark.parametrize("name", WRITERS)
def test_nothing_but_files_is_replaced(tmp_path: Path, name: str, kind: str) -> None:
    target = tmp_path / name
    if kind == "a pipe":
        os.mkfifo(target)
    elif kind == "a device":
        target.symlink_to("/dev/zero")
    else:
        target.mkdir()
        if "with" in kind:
            (target / "file").touch()
    before = os.lstat(target), os.stat(target).st_mode
    with pytest.raises(djpt.FileError, match=f"it is {kind.removesuffix(' with files')}"):
        WRITERS[name](str(target))
    assert (os.lstat(target).st_ino, os.stat(target).st_mode) == (before[0].st_ino, before[1])
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("wrong", ["a" * 5000, "no/", "a\0", "\ud800/"], ids=["long", "folder", "zero", "unicode"])
def test_names_that_cant_be_written(tmp_path: Path, name: str, wrong: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(djpt.FileError) as caught:
        WRITERS[name](wrong + name)
    assert len(str(caught.value)) < 600 and not os.listdir(tmp_path)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("wrong", [3.5, None, b"a.exr", ["a.exr"]], ids=repr)
def test_names_that_are_none(name: str, wrong: Any) -> None:
    with pytest.raises(djpt.DjptError):
        WRITERS[name](wrong)


FULL = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))
import sys
import djpt
from tests.images.test_targets import WRITERS
for name, write in WRITERS.items():
    try:
        write(sys.argv[1] + "/" + name)
    except djpt.FileError as error:
        print(name, error)
"""


@pytest.mark.slow
def test_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    ran = run_python("-c", FULL, str(tmp_path), timeout=300)
    assert ran.returncode == 0, ran.stderr
    assert {line.split()[0] for line in ran.stdout.splitlines()} == set(WRITERS), ran.stdout
    assert not os.listdir(tmp_path)

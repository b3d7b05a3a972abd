"""Written files appear whole or not at all, and only in the place of regular files."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from djpt.core.files import writing
from djpt.errors import FileError
from djpt.images.formats import FORMATS
from djpt.images.image import check_writable, read_pixels, write


def radiance(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((5, 7, 3), np.float32)


def test_a_failed_write_leaves_the_old_file_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.exr"
    write(path, radiance())
    old = path.read_bytes()

    def half_way(target: Path, image: np.ndarray, channels: object) -> None:
        target.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setitem(FORMATS, ".exr", FORMATS[".exr"]._replace(encode=half_way))
    with pytest.raises(FileError, match=r"can't write '.*a\.exr': no space left on device"):
        write(path, radiance(seed=1))
    assert path.read_bytes() == old
    assert os.listdir(tmp_path) == ["a.exr"], "no temporary file stays behind"


def test_a_write_keeps_the_link_and_the_permissions(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    real = tmp_path / "real" / "a.npy"
    write(real, radiance())
    assert stat.S_IMODE(real.stat().st_mode) == 0o666 & ~_umask(), "a new file has the usual permissions"
    real.chmod(0o640)
    (tmp_path / "link.npy").symlink_to(real)
    write(tmp_path / "link.npy", radiance(seed=1))
    assert (tmp_path / "link.npy").is_symlink()
    np.testing.assert_array_equal(read_pixels(real), radiance(seed=1))
    assert stat.S_IMODE(real.stat().st_mode) == 0o640


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


# ---------------------------------------------------------------- what is in the way


def test_a_folder_or_a_file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "a.exr").mkdir()
    (tmp_path / "b").write_text("")
    with pytest.raises(FileError, match="it is a folder"):
        check_writable(tmp_path / "a.exr")
    with pytest.raises(FileError, match="there is no folder"):
        check_writable(tmp_path / "b" / "c.exr")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_no_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(FileError, match="no permission"):
        check_writable(tmp_path / "a.exr")


@pytest.mark.skipif(sys.platform == "win32", reason="has no pipes and devices among its files")
@pytest.mark.parametrize("linked", [False, True])
@pytest.mark.parametrize("kind", ["a pipe", "a device"])
def test_nothing_but_files_is_replaced(tmp_path: Path, kind: str, linked: bool) -> None:
    place = Path("/dev/null") if kind == "a device" else tmp_path / "pipe.exr"
    if kind == "a pipe":
        os.mkfifo(place)
    target = tmp_path / "a.exr" if linked or kind == "a device" else place
    if target != place:
        target.symlink_to(place)
    before = place.stat()
    with pytest.raises(FileError, match=f"it is {kind}"):
        write(target, radiance())
    assert place.stat().st_ino == before.st_ino
    assert place.stat().st_mode == before.st_mode


def test_names_that_are_too_long() -> None:
    with pytest.raises(FileError, match="file name too long") as caught:
        write("a" * 5000 + ".exr", radiance())
    assert len(str(caught.value)) < 300


def test_a_working_directory_that_was_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    with pytest.raises(FileError, match=r"can't write 'a\.exr': no such file or directory"):
        write("a.exr", radiance())
    monkeypatch.chdir(tmp_path)


# ---------------------------------------------------------------- writings that were killed

KILLED = """
import sys, time
from pathlib import Path
from djpt.core.files import writing
with writing(Path(sys.argv[1])) as temporary:
    temporary.write_bytes(b"half")
    print("begun", flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="files aren't locked there")
def test_what_a_killed_writing_left_is_removed_by_the_next(tmp_path: Path) -> None:
    target = tmp_path / "a[1].exr"
    processes = [
        subprocess.Popen([sys.executable, "-c", KILLED, str(target)], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
    other = tmp_path / ".a[1].12345678.png"
    other.write_bytes(b"of another target")
    killed, working = processes
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert len(os.listdir(tmp_path)) == 3
    try:
        write(target, radiance())
        left = set(os.listdir(tmp_path)) - {target.name, other.name}
        assert len(left) == 1, "a writing that goes on is left alone"
    finally:
        working.send_signal(signal.SIGKILL)
        working.communicate()
    np.testing.assert_array_equal(read_pixels(target), radiance())
    write(target, radiance(1))
    assert set(os.listdir(tmp_path)) == {target.name, other.name}


def test_two_writings_of_one_file(tmp_path: Path) -> None:
    target = tmp_path / "a.bin"
    with writing(target) as first, writing(target) as second:
        first.write_bytes(b"1")
        second.write_bytes(b"2")
    assert target.read_bytes() == b"1", "the one that ended last"
    assert os.listdir(tmp_path) == ["a.bin"]

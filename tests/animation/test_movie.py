"""Movies from frames, and the commands that make them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import djpt
from djpt.apps.animation.frames import write_movie
from djpt.errors import FileError
from tests.kit.commands import run


def frames(folder: Path, count: int = 4, size: tuple[int, int] = (17, 13)) -> list[Path]:
    """Frames from black to red."""
    files = []
    for number in range(count):
        picture = np.zeros((size[1], size[0], 3), np.float32)
        picture[..., 0] = number / (count - 1)
        files.append(folder / f"{number}.png")
        djpt.write(files[-1], picture)
    return files


def test_mp4(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    target = tmp_path / "movie.mp4"
    write_movie(target, frames(tmp_path), fps=12)
    reader = ffmpeg.read_frames(str(target))
    about = next(reader)
    pictures = [np.frombuffer(data, np.uint8).reshape(14, 18, 3) for data in reader]
    assert about["size"] == (18, 14) and about["fps"] == 12
    assert len(pictures) == 4
    assert np.abs(pictures[0].astype(int)).max() < 30
    assert pictures[3][..., 0].min() > 220 and pictures[3][..., 1].max() < 30


def test_gif(tmp_path: Path) -> None:
    target = tmp_path / "movie.gif"
    write_movie(target, frames(tmp_path), fps=20)
    with Image.open(target) as movie:
        assert movie.size == (17, 13) and movie.n_frames == 4 and movie.info["duration"] == 50
        movie.seek(3)
        assert movie.convert("RGB").getpixel((3, 3)) == (255, 0, 0)


def test_what_cant_become_a_movie(tmp_path: Path) -> None:
    files = frames(tmp_path)
    with pytest.raises(FileError, match=r"unknown format '\.avi'"):
        write_movie(tmp_path / "movie.avi", files)
    with pytest.raises(FileError, match="at least one frame"):
        write_movie(tmp_path / "movie.gif", [])
    with pytest.raises(FileError, match="frames per second"):
        write_movie(tmp_path / "movie.gif", files, fps=0)
    djpt.write(tmp_path / "other.png", np.zeros((2, 2, 3), np.float32))
    for suffix in ("gif", "mp4"):
        with pytest.raises(FileError, match=r"has 2 x 2 pixels, .* has 17 x 13"):
            write_movie(tmp_path / f"movie.{suffix}", [*files, tmp_path / "other.png"])
        assert not (tmp_path / f"movie.{suffix}").exists()


def test_turntable(tmp_path: Path) -> None:
    folder, movie = tmp_path / "turn", tmp_path / "turn.gif"
    small = ("--width", "16", "--spp", "1", "--frames", "3", "--degrees", "9")
    code, out, err = run("turntable", "cornell_box", *small, "--movie", str(movie), "-o", str(folder))
    assert code == 0, err
    assert "3 frames" in out
    assert sorted(path.name for path in folder.glob("*.png")) == ["0000.png", "0001.png", "0002.png"]
    with Image.open(movie) as pictures:
        assert pictures.n_frames == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "nothing moves"),
        (("--set", "white.reflectance.value"), "--set takes"),
        (("--set", "white.colour=0:1"), "unknown parameter"),
        (("--set", "white.reflectance.value=0:x"), "keyframes are"),
        (("--set", "white.reflectance.value=0:1", "--movie", "a.mkv"), "unknown format"),
        (("--set", "white.reflectance.value=0:1", "--exposure", "auto"), "same for all frames"),
    ],
)
def test_wrong_options(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    code, _, err = run("animate", "cornell_box", "-o", str(tmp_path / "frames"), "--frames", "2", *arguments)
    assert code == 2
    assert message in err

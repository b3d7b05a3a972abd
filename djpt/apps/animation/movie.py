"""Movies from frames: mp4 by FFmpeg, from the wheel `imageio-ffmpeg`, and gif."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.core.files import as_path, check_target, writing
from djpt.errors import BackendError, FileError, near_miss
from djpt.images.image import Image, read_pixels

__all__ = ["MOVIES", "check_movie", "write_movie"]

Pixels = npt.NDArray[np.uint8]


def check_movie(path: str | os.PathLike[str]) -> Path:
    """The path of a movie, checked to be writable.

    Raises:
        FileError: Its format isn't known, or its place can't be written to.
        BackendError: The package `imageio-ffmpeg` is needed and missing.
    """
    target = as_path(path)
    suffix = target.suffix.lower()
    if suffix not in MOVIES:
        raise FileError(f"can't write '{target}': unknown format '{suffix}'{near_miss(suffix, MOVIES)}")
    if suffix == ".mp4":
        ffmpeg()
    check_target(target)
    return target


def write_movie(path: str | os.PathLike[str], frames: Sequence[Path], fps: float = 30.0) -> None:
    """Write a movie of images, all of one size; images of any range are clipped, as `djpt.write` does for png.

    Args:
        path: ``.mp4`` (H.264; an odd last row or column is duplicated, as the format needs even sizes) or
            ``.gif`` (256 colours, looping endlessly; its times are in hundredths of a second).
        frames: The files of the frames.
        fps: Frames per second.

    Raises:
        FileError: A frame can't be read, sizes differ, or the movie can't be written.
        BackendError: For mp4, the package `imageio-ffmpeg` is missing.
    """
    target = check_movie(path)
    if not frames:
        raise FileError(f"can't write '{target}': a movie needs at least one frame")
    if not 0 < fps <= 1000:
        raise FileError(f"can't write '{target}': frames per second must be above 0 and at most 1000, found {fps}")
    with writing(target) as temporary:
        MOVIES[target.suffix.lower()](temporary, frames, fps)


def write_mp4(target: Path, frames: Sequence[Path], fps: float) -> None:
    """Write an mp4."""
    height, width = even(pixels_of(frames[0])).shape[:2]
    sink = ffmpeg().write_frames(str(target), (width, height), fps=fps, quality=8, macro_block_size=1)
    sink.send(None)
    try:
        for pixels in of_one_size(frames):
            sink.send(np.ascontiguousarray(even(pixels)))
    finally:
        sink.close()
    # The program that writes isn't asked whether it could.
    try:
        written, _ = ffmpeg().count_frames_and_secs(str(target))
    except RuntimeError:
        written = 0
    if written != len(frames):
        raise OSError(f"{written} of {len(frames)} frames were written; is the disk full?")


def write_gif(target: Path, frames: Sequence[Path], fps: float) -> None:
    """Write a gif."""
    from PIL import Image as Pictures

    pictures = [Pictures.fromarray(pixels) for pixels in of_one_size(frames)]
    duration = max(20, round(100 / fps) * 10)
    pictures[0].save(target, format="GIF", save_all=True, append_images=pictures[1:], duration=duration, loop=0)


MOVIES: dict[str, Callable[[Path, Sequence[Path], float], None]] = {".mp4": write_mp4, ".gif": write_gif}
"""The functions that write movies, by the extension of the file."""


def ffmpeg() -> Any:
    """The package `imageio_ffmpeg`."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise BackendError(
            "mp4 needs the package 'imageio-ffmpeg': pip install imageio-ffmpeg; gif needs none"
        ) from None
    return imageio_ffmpeg


def pixels_of(file: Path) -> Pixels:
    """An image as 8-bit sRGB, (height, width, 3)."""
    pixels = Image(read_pixels(file)).srgb()
    return pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)


def even(pixels: Pixels) -> Pixels:
    """An image with even numbers of rows and columns: the last ones are duplicated if need be."""
    height, width = pixels.shape[:2]
    return np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def of_one_size(frames: Sequence[Path]) -> Iterator[Pixels]:
    """The pixels of each frame; raises `FileError` if one differs in size from the first."""
    size = None
    for file in frames:
        pixels = pixels_of(file)
        found = f"{pixels.shape[1]} x {pixels.shape[0]}"
        size = size or found
        if found != size:
            raise FileError(f"'{file}' has {found} pixels, '{frames[0]}' has {size}")
        yield pixels

"""`render_frames`: the frames of an animation as files, which a later run continues; and movies of them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from djpt.core.files import as_path, check_target, writing
from djpt.description.parameters import traverse
from djpt.errors import BackendError, FileError, ParameterError, near_miss
from djpt.images.image import Image, check_writable, read_pixels, write
from djpt.rendering.progressive.checkpoint import difference, fingerprint
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.render import render
from djpt.rendering.settings import RenderSettings, check_count
from djpt.scene.scene import Scene

__all__ = ["JOB", "MOVIES", "Moving", "check_movie", "render_frames", "write_movie"]

JOB = "animation.json"
"""The file, beside the frames, that identifies their animation."""


class Moving(Protocol):
    """The value of a parameter at each frame."""

    def at(self, frame: float) -> Any:
        """The parameter's value at a frame."""


def render_frames(
    scene: Scene,
    motion: Mapping[str, Moving],
    count: int,
    folder: str | os.PathLike[str],
    *,
    suffix: str = ".png",
    sensor: Any = 0,
    integrator: Any = None,
    spp: int = 0,
    seed: int = 0,
    convert: Callable[[Any], Any] | None = None,
    facts: Mapping[str, Any] | None = None,
) -> Iterator[Path]:
    """Render the frames of an animation, and yield the file of each as soon as it is written.

    Frame number n is the file ``n`` with leading zeros. Existing frames are yielded as they are: an interrupted run
    continues where it stopped, and its files are bit-identical to those of an uninterrupted one, since each frame
    depends on its own number alone. The scene's parameters get their old values back at the end.

    Args:
        scene: What `load_dict` returned.
        motion: Parameters of `traverse(scene)` by name, and their tracks, such as `djpt.apps.animation.tracks.Track`.
        count: The number of frames.
        folder: The folder for the files; created if it is missing. It holds the frames of one animation.
        suffix: The format: ``.png``, ``.exr`` and all others that `djpt.write` knows.
        sensor: As for `render`.
        integrator: As for `render`.
        spp: As for `render`.
        seed: Of the animation; each frame has a seed of its own, see `djpt.rendering.progressive.rounds.round_seed`.
        convert: Applied to each image before it is written, such as tone mapping.
        facts: Further settings that set these frames apart from others in the folder, such as the tone curve, by name.

    Raises:
        ParameterError: A parameter doesn't exist, or can't have a value of its track.
        RenderError: Arguments are out of range.
        FileError: The folder has the frames of another animation, or can't be written.
    """
    settings, count = RenderSettings.of(scene, sensor, integrator, seed=seed, spp=spp), check_count("count", count)
    sensor, integrator, seed, spp = settings.sensor, settings.integrator, settings.seed, settings.spp
    folder = as_path(folder)
    digits = max(4, len(str(count - 1)))
    files = [folder / f"{number:0{digits}}{suffix}" for number in range(count)]
    params = traverse(scene)
    values = [{key: track.at(number) for key, track in motion.items()} for number in range(count)]
    before = {key: params[key] for key in motion}  # a wrong name is an error now
    nodes = fingerprint(scene, sensor, integrator)
    claim(folder, {"scene": nodes, "motion": digest(values), "spp": spp, "seed": seed, "facts": dict(facts or {})})
    if files:
        check_writable(files[0])

    def rendered() -> Iterator[Path]:
        try:
            for number, file in enumerate(files):
                if not file.exists():
                    params.update(values[number])
                    seed_of_frame = round_seed(seed, number)
                    image = render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=seed_of_frame)
                    write(file, image if convert is None else convert(image))
                yield file
        finally:
            params.update(before)

    # Wrong arguments are errors of this call, and not of the first frame.
    return rendered()


# ---- one animation for a folder ----------------------------------------------------------------


def claim(folder: Path, job: dict[str, Any]) -> None:
    """Record in a folder which animation its frames belong to; raise `FileError` if they belong to another one."""
    note = folder / JOB
    if note.exists():
        try:
            found = json.loads(note.read_text(encoding="utf-8"))
            same_nodes = difference(found["scene"], job["scene"])
            differing = [f"the scene ({same_nodes})"] if same_nodes else []
            differing += [name for name in ("motion", "spp", "seed", "facts") if found[name] != job[name]]
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileError(f"'{note}' can't be read: {error}; remove it together with its frames") from None
        if differing:
            raise FileError(
                f"'{folder}' holds frames of another animation, which differs in {', '.join(differing)}: choose "
                "another folder, or remove them"
            )
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"can't create the folder '{folder}': {error.strerror}") from None
    with writing(note) as temporary:
        temporary.write_text(json.dumps(job, indent=1) + "\n", encoding="utf-8")


def digest(values: list[dict[str, Any]]) -> str:
    """A hash of the parameters of all frames."""
    state = hashlib.blake2b(digest_size=8)
    for frame in values:
        for key, value in frame.items():
            try:
                numbers = np.asarray(getattr(value, "matrix", value), np.float64)
            except (TypeError, ValueError):
                raise ParameterError(f"{key}: only numbers and transforms can be animated, found {value!r}") from None
            state.update(key.encode() + numbers.tobytes())
    return state.hexdigest()


# ---- movies: mp4 by FFmpeg, from the wheel `imageio-ffmpeg`, and gif -------------------------


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

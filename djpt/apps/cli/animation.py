"""The commands ``djpt turntable`` and ``djpt animate``, which render frames and movies."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, described_scene, require_positive, say
from djpt.errors import ParameterError, RenderError
from djpt.rendering.progress import progress_bar

if TYPE_CHECKING:
    from djpt.apps.animation.frames import Moving
    from djpt.scene.scene import Scene
    from djpt.sensors import Sensor

__all__ = ["animate", "turntable"]

Decorated = TypeVar("Decorated", bound=Callable[..., Any])


def of_frames(command: Decorated) -> Decorated:
    """The options of commands that render animations."""
    for option in reversed(
        (
            options.scene,
            click.option(
                "--output", "-o", type=click.Path(path_type=Path), required=True, help="Folder of the frames."
            ),
            click.option("--frames", type=int, default=60, help="Number of frames."),
            click.option(
                "--format", "suffix", default="png", help="Format of the frames: png, jpg, exr, hdr, pfm or npy."
            ),
            click.option(
                "--movie", type=click.Path(path_type=Path), help="Also write the frames as a movie, mp4 or gif."
            ),
            click.option("--fps", type=float, default=30.0, help="Frames per second of the movie."),
            click.option("--spp", type=int, help="Samples per pixel. Default: the scene's."),
            options.seed,
            options.width,
            options.height,
            options.rfilter,
            options.integrator,
            click.option("--sensor", type=click.IntRange(min=0), default=0, help="Index of the sensor, from 0."),
            click.option(
                "--tonemap", default="srgb", help="Tone curve of png and jpg: srgb (clipped), reinhard, aces or agx."
            ),
            options.exposure,
            options.define,
            options.quiet,
        )
    ):
        command = option(command)
    return command


@click.command("turntable", cls=Command, epilog=options.SCENE)
@of_frames
@click.option("--degrees", type=float, default=360.0, help="Total angle of the orbit.")
def turntable(degrees: float, **chosen: Any) -> None:
    """Render SCENE from all sides.

    The camera orbits the centre of its view at constant height; a full turn ends one step before the first frame.
    Existing frames are not rendered again.
    """

    def turning(scene: Scene, sensor: Sensor) -> dict[str, Moving]:
        import djpt
        from djpt.apps.animation.tracks import TurningCamera
        from djpt.apps.orbit import OrbitCamera

        names = djpt.traverse(scene).names_of(sensor)
        key = next((name for name in names if name.rpartition(".")[2] == "to_world"), None)
        if key is None:
            raise djpt.RenderError(f"'{sensor.id()}' can't be moved")
        return {key: TurningCamera(OrbitCamera.of(scene, sensor), degrees / chosen["frames"])}

    write(turning, **chosen)


@click.command("animate", cls=Command, epilog=options.SCENE)
@of_frames
@click.option(
    "--set",
    "tracks",
    metavar="KEY=FRAME:VALUE;..",
    multiple=True,
    help="Keyframes of a parameter: its values at given frames, counted from 0. A value is a number, comma-separated "
    "numbers, or the 16 entries of a matrix. May be repeated.",
)
def animate(tracks: tuple[str, ...], **chosen: Any) -> None:
    """Render an animation of parameters of SCENE.

    The parameters are those of `djpt.traverse`. Existing frames are not rendered again.
    """
    if not tracks:
        raise ParameterError("nothing moves: name a parameter with --set KEY=FRAME:VALUE;FRAME:VALUE")
    texts = {}
    for text in tracks:
        key, equals, values = text.partition("=")
        if not equals or key in texts:
            raise ParameterError(f"--set takes KEY=FRAME:VALUE;.. once for each KEY, found '{text}'")
        texts[key] = values

    def moving(scene: Any, sensor: Any) -> dict[str, Any]:
        from djpt.apps.animation.tracks import Track

        return {key: Track.parse(values) for key, values in texts.items()}

    write(moving, **chosen)


def write(
    moving: Callable[[Scene, Sensor], Mapping[str, Moving]],
    *,
    output: Path,
    frames: int,
    suffix: str,
    movie: Path | None,
    fps: float,
    spp: int | None,
    seed: int,
    sensor: int,
    tonemap: str,
    exposure: str,
    quiet: bool,
    **chosen: Any,
) -> None:
    """Render the frames that are missing, then the movie; `moving` says what moves in a scene seen by a sensor."""
    require_positive(spp=spp, frames=frames)
    description = described_scene(**chosen)[1]
    import djpt
    from djpt.apps.animation.frames import MOVIES, check_movie, render_frames, write_movie
    from djpt.apps.cli.pictures import Tone
    from djpt.scene.scene import find_sensor

    if output.suffix.lower() in MOVIES and not output.is_dir():
        raise RenderError(f"-o takes a folder for the frames; the movie: --movie {output}")
    if movie is not None:
        check_movie(movie)
    toned = tonemap != "srgb" or exposure != "0"
    if toned and exposure == "auto":
        raise RenderError("the exposure of an animation is the same for all frames: give a number of stops")
    tone = Tone(Path(f"0.{suffix}"), tonemap, exposure, None) if toned else None
    loaded = djpt.load_dict(description)
    start = time.perf_counter()
    files = []
    with progress_bar("rendering", "frames", quiet) as progress:
        for file in render_frames(
            loaded,
            moving(loaded, find_sensor(loaded, sensor)),
            frames,
            output,
            suffix=f".{suffix}",
            sensor=sensor,
            spp=spp or 0,
            seed=seed,
            convert=None if tone is None else tone.apply,
            facts={} if tone is None else tone.facts,
        ):
            files.append(file)
            progress(len(files), frames)
    if movie is not None:
        write_movie(movie, files, fps)
    if not quiet:
        seconds = time.perf_counter() - start
        say(f"{output}: {frames} frames, {seconds:.1f} s" + (f"; {movie}" if movie is not None else ""))

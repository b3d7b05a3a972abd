"""`render_to_file`: images that are written while they are computed, so that they may exceed the memory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.interruption import interruptible
from djpt.description.registry import name_of
from djpt.errors import RenderError
from djpt.images.image import check_writable, checked_labels
from djpt.images.row_files import is_streamed, writing_rows
from djpt.images.srgb import strips
from djpt.integrators.base import Integrator
from djpt.jit.kernels import begin_trace
from djpt.rendering.gradients.own_rendering import image_by_itself
from djpt.rendering.image import centres, channel_names, make_job, require_still
from djpt.rendering.progress import Progress, watched
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.memory import check_memory
from djpt.rendering.schedules.passes import SUMMED_PIXELS
from djpt.rendering.schedules.reconstruction import strips_of_rows
from djpt.rendering.settings import RenderSettings
from djpt.scene.scene import Scene
from djpt.version import __version__

__all__ = ["render_to_file"]

Pixels = npt.NDArray[np.float32]


def render_to_file(
    scene: Scene,
    path: str | os.PathLike[str],
    *,
    sensor: Any = 0,
    integrator: Any = None,
    seed: int = 0,
    spp: int = 0,
    schedule: str = "auto",
    progress: Progress | bool | None = None,
    pass_spp: int = 0,
    metadata: Mapping[str, Any] | None = None,
    convert: Callable[[Pixels], Any] | None = None,
    convert_at_once: bool = False,
    keep_partial: bool = False,
) -> None:
    """Render an image into a file, row by row: the memory of some rows is enough for an image of any size.

    The pixels are those of `render` with the same arguments, bit for bit, and the file is that of `write`. It appears
    when it is complete. Gradients of parameters are left alone, and the film keeps no image.

    ``exr``, ``png``, ``hdr``, ``pfm`` and ``npy`` are written while the image is computed. For other formats, and for
    integrators that make an image as a whole (`ptracer`, and those of scripts that render by themselves), the image
    is in memory until it is complete.

    SIGINT (Ctrl-C) and SIGTERM end the render after the pass at hand; a pass takes about a second.

    Args:
        scene: What `load_dict` returned.
        path: The file; its extension chooses the format, as for `write`.
        sensor: As for `render`, and so are the following.
        integrator: In place of the scene's.
        seed: Of the image.
        spp: Samples per pixel; 0 takes the sampler's `sample_count`.
        schedule: How lanes are filled.
        progress: Called with (samples done, samples in all) after each pass, or True.
        pass_spp: Samples per pixel of one pass; 0 chooses.
        metadata: As for `write`: further names and values for the header of an ``exr`` or ``png``. It always has
            ``Software``, ``integrator``, ``sampler``, ``sensor``, ``spp``, ``seed`` and ``seconds``.
        convert: Called with parts of the image from top to bottom, (rows, width, channels) of linear values; the
            array that it returns is written in place of a part: with tone mapping, say, or with fewer channels.
        convert_at_once: Call `convert` once, with the whole image, which is in memory then.
        keep_partial: Write the file even if a signal ends the render. Where the sums of all pixels fit into
            the memory, all pixels have the same fraction of their samples then; otherwise the rows that are finished
            have all of theirs, and the rest is black. The ``spp`` of the metadata is the mean number per pixel.

    Raises:
        RenderError: Nothing to render, arguments out of range, or too little memory.
        FileError: The file can't be written, or its format doesn't hold the channels.
        KeyboardInterrupt: SIGINT.
        Terminated: SIGTERM; a `SystemExit` with the status 143.
    """
    begin_trace()
    target, start = Path(path), time.perf_counter()
    check_writable(target)
    settings = RenderSettings.of(scene, sensor, integrator, seed=seed, spp=spp, schedule=schedule, pass_spp=pass_spp)
    film = settings.sensor.film()
    width, height = film.crop_size()
    names = channel_names(scene, settings.sensor, settings.integrator)
    if not names:
        raise RenderError(f"{film.id()}: there are no channels to write")
    count = len(names) if convert is None else np.asarray(convert(np.zeros((1, 1, len(names)), np.float32))).shape[2]
    stored = names[:count] if target.suffix.lower() == ".exr" else None
    found = {**facts(settings, sensor), "seconds": "0.00"}
    carries = target.suffix.lower() in (".exr", ".png")

    def labels() -> Any:
        return checked_labels(target, count, stored, {**found, **(metadata or {})} if carries else {})

    with (
        watched(progress, "rendering", "samples") as shown,
        interruptible(keep_partial) as interruption,
        writing_rows(target, (height, width, count), labels()) as file,
        dr.suspend_grad(),
    ):
        streamed = is_streamed(target) and not convert_at_once
        watching = replace(settings, progress=shown, interruption=interruption)
        parts = completed(parts_of_image(scene, watching, streamed), width, height, len(names))
        if convert_at_once:
            parts = iter([np.concatenate(list(parts))])
        for part in parts:
            file.add(part if convert is None else np.asarray(convert(part), np.float32))
        found["seconds"] = f"{time.perf_counter() - start:.2f}"
        if interruption.requested and interruption.total:
            found["spp"] = f"{found['spp'] * interruption.done / interruption.total:.6g}"
        file.close(labels())
    interruption.leave(f"'{target}' holds the partial image")


def parts_of_image(scene: Scene, settings: RenderSettings, streamed: bool) -> Iterator[Pixels]:
    """The rows of an image from top to bottom, some at a time; fewer if a signal ends the render early."""
    if type(settings.integrator).render is not Integrator.render:
        yield image_by_itself(scene, None, settings).numpy()
        return
    require_still(scene, settings.sensor)
    job = make_job(scene, settings)
    how = choose(settings.schedule, job)
    check_memory(job, in_bands=how.in_bands and streamed)
    if not how.in_bands:
        image = how.image(job).numpy()
        for part in strips(image):
            yield with_centres(job, image[part], part.start)
        return
    if not job.channel_names():
        width, height = job.film.crop_size()
        rows = max(1, SUMMED_PIXELS // width)
        for first in range(0, height, rows):
            yield centres(job, first, min(rows, height - first)).numpy()
        return
    for strip in strips_of_rows(job, how.rows(job)):
        rows = strip.values.numpy().reshape(strip.count, -1, job.channel_count())
        yield with_centres(job, rows, strip.first_row)


def completed(parts: Iterator[Pixels], width: int, height: int, channels: int) -> Iterator[Pixels]:
    """The rows of an image, not many at a time; where they end early, black ones follow."""
    row = 0
    for part in parts:
        row += len(part)
        for strip in strips(part):
            yield part[strip]
    for _ in range(row, height):
        yield np.zeros((1, width, channels), np.float32)


def with_centres(job: Job, rows: Pixels, first_row: int) -> Pixels:
    """Some rows with the channels that come from the centres of their pixels."""
    if not job.integrator.unfiltered_names():
        return rows
    return np.concatenate([rows, centres(job, first_row, len(rows)).numpy()], axis=2)


def facts(settings: RenderSettings, sensor: Any) -> dict[str, Any]:
    """The metadata of all images; `sensor` is how the sensor was asked for."""

    def type_of(plugin: Any) -> str:
        return name_of(type(plugin)) or type(plugin).__name__

    return {
        "Software": f"djpt {__version__}",
        "integrator": type_of(settings.integrator),
        "sampler": type_of(settings.sensor.sampler()),
        "sensor": sensor if isinstance(sensor, int) else settings.sensor.id(),
        "spp": settings.sample_count,
        "seed": settings.seed,
    }

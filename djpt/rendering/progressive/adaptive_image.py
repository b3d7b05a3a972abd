"""Adaptive images in one call."""

from __future__ import annotations

from typing import Any

from djpt.core.process.interruption import noticing
from djpt.errors import RenderError
from djpt.jit.frozen import recording
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.leaves import attached_parameters
from djpt.rendering.image import channel_names
from djpt.rendering.progress import Progress, watched
from djpt.rendering.progressive.passes import render_passes
from djpt.samplers.seeds import Seed
from djpt.scene.arguments import find_sensor
from djpt.scene.scene import Scene

__all__ = ["render_adaptively"]


def render_adaptively(
    scene: Scene,
    sensor: Any,
    integrator: Any,
    seed: Seed,
    spp: int,
    schedule: str,
    progress: Progress | bool | None,
    keep_partial: bool,
) -> TensorXf:
    """The image of `render` with ``adaptive=True``; the film keeps it, too. Arguments as there."""
    if recording():
        raise RenderError("a frozen function can't render adaptively: the host decides where samples are taken")
    film = find_sensor(scene, sensor).film()
    if attached_parameters(scene):
        raise RenderError(
            "adaptive images have no derivatives: render with adaptive=False, or without gradients enabled"
        )
    names = channel_names(scene, sensor, integrator)
    spp = spp or find_sensor(scene, sensor).sampler().sample_count()
    options: dict[str, Any] = {"sensor": sensor, "integrator": integrator, "seed": seed, "spp": spp}
    with watched(progress, "rendering", "samples") as shown, noticing(keep_partial) as interruption:
        for found in render_passes(scene, adaptive=True, schedule=schedule, interruption=interruption, **options):
            pixels = found.size[0] * found.size[1]
            if shown is not None:
                shown(min(found.spp, spp) * pixels, spp * pixels)
            if interruption is not None and interruption.requested:
                break
        image = found.image()
        film.keep(image, names)
        if interruption is not None:
            interruption.leave("the film keeps what exists")
    return image

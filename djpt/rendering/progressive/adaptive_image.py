"""Adaptive images in one call."""

from __future__ import annotations

from dataclasses import replace

from djpt.errors import RenderError
from djpt.jit.frozen import recording
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.leaves import attached_parameters
from djpt.rendering.image import channel_names
from djpt.rendering.progressive.passes import AdaptiveImage, Goal, begun, rounds
from djpt.rendering.settings import RenderSettings
from djpt.scene.scene import Scene

__all__ = ["adaptive_image"]


def adaptive_image(scene: Scene, settings: RenderSettings) -> TensorXf:
    """The image of `render` with ``adaptive=True``; the film keeps it, too.

    Raises:
        RenderError: Gradients are enabled, a frozen function is recorded, or the integrator can't render adaptively.
    """
    if recording():
        raise RenderError("a frozen function can't render adaptively: the host decides where samples are taken")
    if attached_parameters(scene):
        raise RenderError(
            "adaptive images have no derivatives: render with adaptive=False, or without gradients enabled"
        )
    film = settings.sensor.film()
    names = channel_names(scene, settings.sensor, settings.integrator)
    goal = Goal.of(settings, adaptive=True)
    progress, interruption = settings.progress, settings.interruption
    # Rounds are short: nobody is told of their passes.
    image = AdaptiveImage(scene, replace(settings, progress=None, pass_spp=0), goal)
    width, height = film.crop_size()
    for found in rounds(begun(image, None), goal, image):
        if progress is not None:
            progress(min(found.spp, goal.spp) * width * height, goal.spp * width * height)
        if interruption is not None and interruption.requested:
            break
    result = found.image()
    film.keep(result, names)
    return result

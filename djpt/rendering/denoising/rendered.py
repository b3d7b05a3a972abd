"""Images that are rendered and denoised in one call."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from djpt.description.properties import Properties
from djpt.errors import RenderError
from djpt.images.image import write
from djpt.jit.frozen import recording
from djpt.jit.types import TensorXf
from djpt.rendering.denoising.filtering import Guides, Pixels, check_method, colour_count, denoise_pixels
from djpt.rendering.denoising.guides import render_guides
from djpt.rendering.gradients.leaves import attached_parameters
from djpt.rendering.image import channel_names
from djpt.rendering.settings import RenderSettings
from djpt.rfilters.box import Box
from djpt.scene.scene import Scene
from djpt.sensors import Sensor

__all__ = ["Cleaner", "render_denoised", "write_raw"]


@dataclass
class Cleaner:
    """Removes the noise of an image of a scene, with guides that it renders for it.

    As the argument `convert` of `render_to_file` it is first asked with a single pixel, how many channels it returns.
    """

    scene: Scene
    method: str
    """One of `djpt.denoise`."""
    settings: RenderSettings
    """Those of the image."""
    raw: str | os.PathLike[str] | None = None
    """A file for the noisy image and its guides: see `write_raw`."""

    def __post_init__(self) -> None:
        check_method(self.method)
        self.channels = channel_names(self.scene, self.settings.sensor, self.settings.integrator)
        self.size = tuple(self.settings.sensor.film().crop_size())
        colour_count(np.zeros((1, 1, len(self.channels)), np.float32), self.channels)

    def __call__(self, pixels: Pixels) -> Pixels:
        """The image (H, W, C) without its noise; of another size, the pixels as they are."""
        if (pixels.shape[1], pixels.shape[0]) != self.size:
            return pixels
        guides = render_guides(self.scene, self.settings)
        if self.raw is not None:
            write_raw(self.raw, pixels, self.channels, guides)
        return denoise_pixels(pixels, guides, colour_count(pixels, self.channels), self.method)


def write_raw(path: str | os.PathLike[str], pixels: Pixels, channels: tuple[str, ...], guides: Guides) -> None:
    """Write a noisy image and the layers ``albedo`` and ``normal`` to an exr, for `djpt denoise` to read."""
    names, planes = list(channels), [pixels]
    for layer, guide, parts in (("albedo", guides.albedo, "RGB"), ("normal", guides.normal, "XYZ")):
        if guide is not None and not any(name.startswith(f"{layer}.") for name in channels):
            planes.append(guide)
            names += [f"{layer}.{part}" for part in parts]
    write(path, np.concatenate(planes, axis=2), names)


def render_denoised(
    scene: Scene, method: str, settings: RenderSettings, render: Callable[[RenderSettings], TensorXf]
) -> TensorXf:
    """The image that `render` makes with the box filter, without its noise; the film keeps the noisy one."""
    if recording():
        raise RenderError("a frozen function can't denoise: render in it, and pass its result to djpt.denoise")
    if attached_parameters(scene):
        raise RenderError(
            "denoised images have no derivatives: render with denoise=False, or without gradients enabled"
        )
    by_box = replace(settings, sensor=unmixed(settings.sensor))
    cleaner = Cleaner(scene, method, by_box)
    try:
        noisy = render(by_box)
    finally:
        # A signal leaves what exists.
        found = by_box.sensor.film()._image
        if found is not None:
            settings.sensor.film().keep(found, cleaner.channels)
    return TensorXf(cleaner(noisy.numpy()))


def unmixed(sensor: Sensor) -> Sensor:
    """A copy of a sensor whose pixels share no samples: by the box filter."""
    result, film = copy.copy(sensor), copy.copy(sensor.film())
    film._image = None
    film._rfilter = Box(Properties("box", "rfilter", {}))
    result._film = film
    return result

"""Images that are rendered and denoised in one call, guided by albedo and normals."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.records import BSDFContext, BSDFFlags, Ray3f, has_flag
from djpt.description.properties import Properties
from djpt.errors import RenderError
from djpt.images.image import write
from djpt.integrators.base import Integrator
from djpt.integrators.termination import Terminating
from djpt.jit.frozen import recording
from djpt.jit.kernels import loop_traced_once, minimum, wide
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point3f, TensorXf, UInt32, Vector3f
from djpt.rendering.denoising.filtering import Guides, Pixels, check_method, colour_count, denoise_pixels
from djpt.rendering.gradients.leaves import attached_parameters
from djpt.rendering.image import channel_names, make_job, primal
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.memory import check_memory
from djpt.rendering.settings import RenderSettings
from djpt.rfilters.box import Box
from djpt.samplers.base import SampleStream
from djpt.scene.scene import Scene
from djpt.sensors import Sensor

__all__ = ["Cleaner", "GuideIntegrator", "render_denoised", "render_guides", "write_raw"]

SAMPLES = 32
"""Samples per pixel of guides: their noise is that of edges and of glass, and is filtered as well."""


class GuideIntegrator(Terminating, Integrator):
    """The albedo and the shading normal of the first surface that isn't a mirror or clear glass: six channels.

    Mirrors, glass and openings are followed, by the lobes that their BSDFs sample, down to `max_depth` surfaces. The
    albedo is the weight f abs(cos) / pdf of the BSDF's sample there, whose mean is the fraction of light that the
    surface reflects, times the weights on the way. Lights are black, which makes them stand out from what they shine
    on; the environment is seen as it is. No channel is more than 1.

    Parameters: `max_depth` (default 8), `hide_emitters`.
    """

    pure = True
    samples_lights = False
    differentiable = False
    writes_color = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", 8, low=1)

    def check_scene(self, scene: Scene, sensor: Any) -> None:
        """Nothing: what these images leave out, the picture shows."""

    def aov_names(self) -> Sequence[str]:
        return ("albedo.R", "albedo.G", "albedo.B", "normal.X", "normal.Y", "normal.Z")

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        lanes = dr.width(ray, sampler)
        start = Look(
            o=wide(ray.o, lanes),
            d=wide(ray.d, lanes),
            medium=wide(ray.medium, lanes),
            times=wide(ray.times, lanes),
            sampler=sampler,
            throughput=dr.full(Color3f, 1, lanes),
            depth=dr.zeros(UInt32, lanes),
            albedo=dr.zeros(Color3f, lanes),
            normal=dr.zeros(Normal3f, lanes),
            covered=dr.full(Bool, False, lanes),
            active=Bool(active) & dr.full(Bool, True, lanes),
        )

        def body(look: Look) -> tuple[Look]:
            first = look.depth == 0
            way = Ray3f(look.o, look.d, maxt=dr.select(first, ray.maxt, dr.inf), medium=look.medium)
            way.times = look.times
            pi = scene.closest_hit(way, through_lights=first if self.hide_emitters else None)
            si = scene.surface_interaction(way, pi)
            hit = si.is_valid()
            throughput = look.throughput * scene.media.transmittance(way, si.t)
            emitted = si.emitter().eval(si)
            sky = dr.select(hit | (first & self.hide_emitters), 0, emitted)

            bsdf = si.bsdf()
            bs, weight = bsdf.sample(BSDFContext(), si, look.sampler.next_1d(), look.sampler.next_2d(), hit)
            follows = hit & has_flag(bs.sampled_type, BSDFFlags.Delta) & (look.depth + 1 < self.longest)
            reflects = hit & ~follows & (dr.max(emitted) == 0)
            shown = throughput * (sky + dr.select(reflects, weight, 0))
            on = si.spawn_ray(si.to_world(bs.wo))
            return (
                Look(
                    o=on.o,
                    d=on.d,
                    medium=on.medium,
                    times=on.times,
                    sampler=look.sampler,
                    throughput=dr.select(follows, throughput * weight, throughput),
                    depth=look.depth + 1,
                    albedo=look.albedo + shown,
                    normal=dr.select(hit & ~follows, bsdf.sh_frame(si).n, look.normal),
                    covered=look.covered | hit,
                    active=follows,
                ),
            )

        (end,) = loop_traced_once(start, lambda look: look.active, body, label="guides")
        albedo = [minimum(c, Float(1)) for c in end.albedo]
        return Color3f(0), end.covered, [*albedo, end.normal.x, end.normal.y, end.normal.z]


@dataclass
class Look:
    """Loop state."""

    o: Point3f
    d: Vector3f
    medium: UInt32 | None
    times: Any
    sampler: SampleStream
    throughput: Color3f
    depth: UInt32
    albedo: Color3f
    normal: Normal3f
    covered: Bool
    active: Bool


def render_guides(scene: Scene, settings: RenderSettings) -> Guides:
    """Render albedo and normals for an image with some settings, of which neither the film nor anybody else is told."""
    props = Properties("guides", "integrator", {"hide_emitters": settings.integrator.hide_emitters})
    sensor, integrator = settings.sensor, GuideIntegrator(props)
    job = make_job(scene, RenderSettings(sensor, integrator, settings.seed, SAMPLES))
    check_memory(job, attached=False)
    pixels = np.array(primal(job, choose("auto", job)))
    return Guides(albedo=pixels[..., :3], normal=pixels[..., 3:])


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

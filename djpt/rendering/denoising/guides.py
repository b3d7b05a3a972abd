"""The albedo and the normals that a denoiser is guided by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.records import BSDFContext, BSDFFlags, Ray3f, has_flag
from djpt.description.properties import Properties
from djpt.integrators.base import Integrator
from djpt.integrators.termination import Terminating
from djpt.jit.kernels import loop_traced_once, minimum, wide
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point3f, UInt32, Vector3f
from djpt.rendering.denoising.filtering import Guides
from djpt.rendering.image import make_job, primal
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.memory import check_memory
from djpt.rendering.settings import RenderSettings
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["GuideIntegrator", "render_guides"]

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

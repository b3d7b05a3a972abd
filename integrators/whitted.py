"""Recursive ray tracing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, Ray3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.integrators.base import Integrator
from djpt.integrators.paths.ray_stack import Branch, RayStack, branch, camera_branch
from djpt.jit.kernels import while_loop, wide
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["Whitted"]

LAST = 1 - 2.0**-24
"""The largest number that a sampler gives: with it a BSDF chooses its last lobe, with 0 its first."""

MIDDLE = Point2f(0.5)


class Whitted(Integrator):
    """Mirrors and panes are followed, everything else is lit by the lights alone.

    L = Le + sum over lights of f cos Li V + R L(reflected) + T L(refracted): the two lobes of a pane are both followed,
    with their Fresnel reflectance and transmittance, down to `max_depth` surfaces.

    Assumes that lights are points: of an area light a single, fixed point is used (the middle of a rectangle), so
    shadows are hard. Leaves out all light that reaches a surface by way of another one: light behind glass, caustics,
    indirect light. Environments are seen, also in mirrors, but don't light surfaces. There is noise only at edges.

    Parameters: `max_depth` (surfaces that a ray may meet one after the other, default 8), `hide_emitters`.

    T. Whitted, "An improved illumination model for shaded display", CACM 23(6), 1980.
    """

    pure = True
    in_any_frame = True

    needs_light = True
    differentiable = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", 8, low=1, high=64)

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        if all(emitter.is_environment() for emitter in scene.emitters()):
            raise RenderError(
                "'whitted' can't light a scene by its environment alone: add a point, spot, directional or area "
                "light, or use 'path'"
            )

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        lanes = dr.width(ray, sampler)
        stack = RayStack(self.max_depth)
        start = Walk(
            wide(camera_branch(ray), lanes),
            dr.zeros(UInt32, lanes),
            dr.zeros(Color3f, lanes),
            dr.full(Bool, False, lanes),
            Bool(active) & dr.full(Bool, True, lanes),
        )

        def body(walk: Walk) -> tuple[Walk]:
            ray, depth = walk.branch.ray, walk.branch.depth
            first = depth == 0
            pi = scene.closest_hit(ray, through_lights=first if self.hide_emitters else None)
            si = scene.surface_interaction(ray, pi)
            hit = si.is_valid()
            throughput = walk.branch.throughput * scene.media.transmittance(ray, si.t)

            # ---------------------- Emission ----------------------
            emitted = si.emitter().eval(si)
            if self.hide_emitters:
                emitted = dr.select(first & ~hit, 0, emitted)
            radiance = walk.radiance + throughput * (emitted + dr.select(hit, self.lit(scene, si), 0))

            # --------------- Reflection and refraction -------------
            proceed = hit & (depth + 1 < self.max_depth)
            lobes = []
            for choice in (0.0, LAST):
                bs, weight = si.bsdf().sample(BSDFContext(), si, Float(choice), MIDDLE, proceed)
                onward = si.spawn_ray(si.to_world(bs.wo))
                followed = branch(onward, si.p, si.n, throughput * weight * bs.pdf, Float(0), depth + 1)
                mirrored = proceed & has_flag(bs.sampled_type, BSDFFlags.Delta) & (dr.max(followed.throughput) > 0)
                lobes.append((followed, mirrored, bs.sampled_type))
            (one, follow_one, type_one), (other, follow_other, type_other) = lobes
            # A mirror has one lobe, and so has a pane at total reflection.
            follow_other &= ~follow_one | (type_one != type_other)

            # ---------------------- Next branch --------------------
            size = stack.push(walk.size, other, follow_one & follow_other)
            goes_on = follow_one | follow_other
            size, waiting, waited = stack.pop(size, ~goes_on)
            return (
                Walk(
                    branch=dr.select(follow_one, one, dr.select(follow_other, other, waiting)),
                    size=size,
                    radiance=radiance,
                    covered=walk.covered | (hit & first),
                    active=goes_on | waited,
                ),
            )

        (end,) = while_loop((start,), lambda walk: walk.active, body, label="whitted")
        return end.radiance, end.covered, []

    def lit(self, scene: Scene, si: SurfaceInteraction3f) -> Color3f:
        """The light of the lights that the surface's smooth lobes send to the eye."""
        emitters = [i for i, e in enumerate(scene.emitters()) if not e.is_environment()]
        total = Color3f(0)
        for number in emitters:
            ds, light = scene.emitter_ptr(UInt32(number)).sample_direction(si, MIDDLE)
            value = si.bsdf().eval(BSDFContext(), si, si.to_local(ds.d), si.is_valid())
            total += scene.transmittance(scene.shadow_ray(si, ds), value * light)
        return total


@dataclass
class Walk:
    """Loop state."""

    branch: Branch
    size: UInt32
    """The number of branches on the stack."""
    radiance: Color3f
    covered: Bool
    active: Bool


register_integrator("whitted", Whitted)

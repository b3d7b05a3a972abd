"""Distributed ray tracing: many rays where Whitted's algorithm has one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, DirectionSample3f, Ray3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.emitters.light_samplers import LIGHT_SAMPLERS
from djpt.integrators.base import Integrator, mis_weight
from djpt.integrators.paths.ray_stack import Branch, RayStack, branch, camera_branch
from djpt.jit.kernels import while_loop, wide
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Distributed"]


class Distributed(Integrator):
    """At every surface `split` rays go on and `light_samples` go to the lights.

    Estimates L = Le + 1/m sum of w_e f Le V / p_e + 1/n sum of f abs(cos) / p L(next), where the Le of the next
    surface is weighted by w_b; w_e and w_b are the power heuristic of m p_e against n p. Soft shadows, blurred
    reflections and refractions, depth of field (with a `thinlens`) come from the choice of the rays.

    The work grows as split^max_depth: practical for a few bounces only. Leaves out paths of more than
    `max_depth` edges.

    Parameters: `split` (rays that go on from a surface, 1 to 16, default 4), `light_samples` (1 to 16, default 4),
    `max_depth` (edges of the longest path, default 3, at most 16), `hide_emitters`, `emitter_choice` (see `Path`).

    R. Cook, T. Porter and L. Carpenter, "Distributed Ray Tracing", SIGGRAPH 1984.
    """

    pure = True
    in_any_frame = True

    needs_light = True
    differentiable = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.split = props.integer("split", 4, low=1, high=16)
        self.light_samples = props.integer("light_samples", 4, low=1, high=16)
        self.max_depth = props.integer("max_depth", 3, low=1, high=16)
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=LIGHT_SAMPLERS)

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        lanes = dr.width(ray, sampler)
        stack = RayStack((self.split - 1) * self.max_depth)
        start = Walk(
            branch=wide(camera_branch(ray), lanes),
            sampler=sampler,
            size=dr.zeros(UInt32, lanes),
            radiance=dr.zeros(Color3f, lanes),
            covered=dr.full(Bool, False, lanes),
            active=Bool(active) & dr.full(Bool, True, lanes),
        )

        def body(walk: Walk) -> tuple[Walk]:
            here, ray = walk.branch, walk.branch.ray
            first = here.depth == 0
            pi = scene.closest_hit(ray, through_lights=first if self.hide_emitters else None)
            si = scene.surface_interaction(ray, pi)
            throughput = here.throughput * scene.media.transmittance(ray, si.t)

            # ---------------------- Emission ----------------------
            ds = DirectionSample3f.between(here.p, ray, si)
            emitter_pdf = scene.pdf_emitter_direction(here.reference, ds)
            mis = mis_weight(here.bsdf_pdf * self.split, emitter_pdf * self.light_samples)
            emitted = si.emitter().eval(si) * dr.select(here.bsdf_pdf > 0, mis, 1)
            if self.hide_emitters:
                emitted = dr.select(first & ~si.is_valid(), 0, emitted)
            radiance = walk.radiance + throughput * emitted
            proceed = si.is_valid() & (here.depth + 1 < self.max_depth)

            # ------------------- Light sampling -------------------
            for _ in range(self.light_samples):
                arrived = self.direct(scene, walk.sampler, si, proceed)
                radiance += throughput * arrived * (1 / self.light_samples)

            # -------------------- BSDF sampling -------------------
            # The last of the rays goes on, the others wait.
            size, goes_on, ahead = walk.size, Bool(False), here
            for _ in range(self.split):
                bs, weight = si.bsdf().sample(
                    BSDFContext(), si, walk.sampler.next_1d(), walk.sampler.next_2d(), proceed
                )
                size = stack.push(size, ahead, goes_on)
                onward = si.spawn_ray(si.to_world(bs.wo))
                pdf = dr.select(has_flag(bs.sampled_type, BSDFFlags.Delta), 0, bs.pdf)
                ahead = branch(onward, si.p, si.n, throughput * weight * (1 / self.split), pdf, here.depth + 1)
                goes_on = proceed & (dr.max(ahead.throughput) > 0)

            # ---------------------- Next branch --------------------
            size, waiting, waited = stack.pop(size, ~goes_on)
            covered = walk.covered | (si.is_valid() & first)
            ahead = dr.select(goes_on, ahead, waiting)
            return (Walk(ahead, walk.sampler, size, radiance, covered, goes_on | waited),)

        (end,) = while_loop((start,), lambda walk: walk.active, body, label="distributed")
        return end.radiance, end.covered, []

    def direct(self, scene: Scene, sampler: SampleStream, si: SurfaceInteraction3f, active: Bool) -> Color3f:
        """Light of one sampled emitter, weighted against the rays that go on."""
        ds, light = scene.sample_emitter_direction(si, sampler.next_2d(), active=active)
        to_light = si.to_local(ds.d)
        value, pdf = si.bsdf().eval_pdf(BSDFContext(), si, to_light, active)
        mis = dr.select(ds.delta, 1, mis_weight(ds.pdf * self.light_samples, pdf * self.split))
        return value * light * mis


@dataclass
class Walk:
    """Loop state."""

    branch: Branch
    sampler: SampleStream
    size: UInt32
    """The number of branches on the stack."""
    radiance: Color3f
    covered: Bool
    active: Bool


register_integrator("distributed", Distributed)

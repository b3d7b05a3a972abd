"""Direct illumination with several samples per strategy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, DirectionSample3f, Ray3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.emitters.light_samplers import LIGHT_SAMPLERS
from djpt.errors import SceneError
from djpt.integrators.base import Integrator, mis_weight
from djpt.jit.types import Bool, Color3f, Float
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Direct"]


class Direct(Integrator):
    """Light that arrives straight from emitters at the first visible surface.

    L = Le + 1/n_e sum w_e f Le V / p_e + 1/n_b sum w_b f Le / p_b, with the power heuristic of
    the densities times the fraction of samples of each strategy.

    Parameters: `shading_samples` (sets both counts, default 1), or `emitter_samples` and
    `bsdf_samples` (0 turns a strategy off), `hide_emitters`, `emitter_choice` (see `Path`).
    """

    pure = True
    in_any_frame = True

    needs_light = True
    settings = ("emitter_samples", "bsdf_samples")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if "shading_samples" in props and ("emitter_samples" in props or "bsdf_samples" in props):
            raise SceneError(f"{props.node}: give 'shading_samples', or 'emitter_samples' and 'bsdf_samples'")
        both = props.integer("shading_samples", 1, low=1, high=1024)
        self.emitter_samples = props.integer("emitter_samples", both, low=0, high=1024)
        self.bsdf_samples = props.integer("bsdf_samples", both, low=0, high=1024)
        if self.emitter_samples + self.bsdf_samples == 0:
            raise SceneError(f"{props.node}: 'emitter_samples' and 'bsdf_samples' can't both be 0")
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=LIGHT_SAMPLERS)
        self.shows_delta, self.samples_lights = self.bsdf_samples > 0, self.emitter_samples > 0

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        total = self.emitter_samples + self.bsdf_samples
        emitter_fraction, bsdf_fraction = self.emitter_samples / total, self.bsdf_samples / total
        ctx = BSDFContext()

        # ------------------- Visible surface ------------------
        through = Bool(True) if self.hide_emitters else None
        pi = scene.closest_hit(ray, active, through_lights=through)
        si = scene.surface_interaction(ray, pi, scene.surface_detail)
        result = Color3f(0)
        if not self.hide_emitters:
            result += si.emitter().eval(si, active)
        lit = si.is_valid() & active
        bsdf = si.bsdf()

        # ------------------- Light sampling -------------------
        # Where all lobes are deltas no numbers are drawn, as in Mitsuba.
        smooth = lit & has_flag(bsdf.flags(), BSDFFlags.Smooth)
        for _ in range(self.emitter_samples):
            ds, light = scene.sample_emitter_direction(si, sampler.next_2d(smooth), True, smooth)
            value, pdf = bsdf.eval_pdf(ctx, si, si.to_local(ds.d), smooth)
            weight = mis_weight(ds.pdf * emitter_fraction, pdf * bsdf_fraction)
            weight = dr.select(ds.delta, 1, weight) * (1 / self.emitter_samples)
            result += value * light * weight

        # -------------------- BSDF sampling -------------------
        # Where no ray meets light they bring none; as the last ones they leave no number for others.
        for _ in range(self.bsdf_samples if scene.lights.can_be_met else 0):
            # Direction before lobe: the order in which Mitsuba's `direct` draws them.
            sample2 = sampler.next_2d(lit)
            bs, bsdf_weight = bsdf.sample(ctx, si, sampler.next_1d(lit), sample2, lit)
            ray_b = si.spawn_ray(si.to_world(bs.wo))
            si_b = met_by(scene, ray_b, lit)
            ds = DirectionSample3f.between(si.p, ray_b, si_b)
            delta = has_flag(bs.sampled_type, BSDFFlags.Delta)
            emitter_pdf = Float(0)
            if self.emitter_samples:
                emitter_pdf = dr.select(delta, 0, scene.pdf_emitter_direction(si, ds, lit))
            mis = mis_weight(bs.pdf * bsdf_fraction, emitter_pdf * emitter_fraction) * (1 / self.bsdf_samples)
            met = si_b.emitter().eval(si_b, lit) * scene.media.transmittance(ray_b, si_b.t)
            result += bsdf_weight * met * mis

        return dr.select(active, result * scene.media.transmittance(ray, si.t), 0), si.is_valid() & active, []


def met_by(scene: Scene, ray: Ray3f, active: Bool) -> SurfaceInteraction3f:
    """The surface point that a ray from a surface meets, with derivatives if the ray has some, or if shapes move."""
    if dr.grad_enabled(ray.o, ray.d) or scene.moving():
        return scene.ray_intersect(ray, active)
    return scene.surface_interaction(ray, scene.closest_hit(ray, active), scene.surface_detail)


register_integrator("direct", Direct)

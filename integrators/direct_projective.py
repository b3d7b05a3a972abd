"""Direct light, with derivatives by the shapes that move."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import (
    BSDFContext,
    BSDFFlags,
    DirectionSample3f,
    Interaction3f,
    Ray3f,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.integrators.projective.kept import keep
from djpt.integrators.projective.projective_sampling import PSIntegrator
from djpt.integrators.projective.reattach import (
    attached_light,
    attached_ray,
    attached_wi,
    bsdf_weight,
    has_mirrors,
    mirrored,
    relative,
)
from djpt.integrators.projective.self_views import following, sees_itself
from djpt.integrators.projective.wedges import above_horizon
from djpt.integrators.projective.weights import mis_weight
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32, Vector3f
from djpt.materials.base import eval_pdf_light
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["DirectProjectiveIntegrator"]

SMOOTH, DELTA = int(BSDFFlags.Smooth), int(BSDFFlags.Delta)


class DirectProjectiveIntegrator(PSIntegrator):
    """Emitters seen directly, and their light on surfaces; differentiable by the place of shapes.

    At each hit one sample by the emitters and one by the BSDF, with multiple importance sampling. Derivatives are those
    of the code, and of silhouettes: see `djpt.ad.integrators.projective_sampling`. As in Mitsuba 3.9.1, light is
    followed whose path the silhouette of a moving shape cuts; shadows that fall on a moving shape from one that stays
    have derivatives as far as the light of unshadowed points has.

    Parameters: those of `PSIntegrator`, of which `max_depth` is 1 (emitters alone) or more; `project_seed` (`both`,
    `bsdf` or `emitter`, default `both`): the rays that are projected to guide samples.
    """

    pure = True
    direct_light_only = True
    radiative_backprop = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.project_seed = props.string("project_seed", "both", choices=("both", "bsdf", "emitter"))

    def sample(  # type: ignore[override]
        self,
        mode: dr.ADMode,
        scene: Any,
        sampler: Any,
        ray: Any,
        depth: Any = None,
        δL: Any = None,
        state_in: Any = None,
        active: Any = True,
        project: bool = False,
        si_shade: Any = None,
        horizon: Any = None,
        **kwargs: Any,
    ) -> Any:
        attached = mode != dr.ADMode.Primal
        ray, active = ray if attached else dr.detach(ray), Bool(active)
        with dr.resume_grad(when=attached):
            si = self.first_hit(scene, ray, active) if si_shade is None else si_shade
            light = Color3f(0)
            if not self.hide_emitters:
                light = dr.select(active, si.emitter(scene).eval(si, active), 0)
        if attached:
            keep(si.t, si.uv, si.prim_index, light)
        covered = si.is_valid() & active
        onward = covered & (self.max_depth > 1)
        bsdf, ctx = si.bsdf(), BSDFContext()

        by_light = onward & has_flag(bsdf.flags(), SMOOTH)
        ds, weight = scene.sample_emitter_direction(dr.detach(si), sampler.next_2d(), True, by_light)
        lit = by_light & (ds.pdf != 0)
        if horizon is not None:
            lit &= above_horizon(ds, horizon)
        with dr.resume_grad(when=attached):
            d = ds.d
            if attached:
                keep(ds, weight)
                d, weight = attached_light(scene, si, ds, weight, True, lit)
            value, pdf = bsdf.eval_pdf(ctx, si, si.to_local(d), lit)
            mis = dr.select(ds.delta, 1, mis_weight(ds.pdf, pdf))
            light = light + dr.select(lit, value * weight * mis, 0)

        lobe, square = sampler.next_1d(), sampler.next_2d()
        bs, scattered = bsdf.sample(ctx, dr.detach(si), lobe, square, onward)
        scattered = dr.detach(scattered)
        by_bsdf = onward & dr.any(scattered != 0)
        delta = has_flag(bs.sampled_type, DELTA)
        mirror = by_bsdf & delta
        next_ray = dr.detach(si.spawn_ray(si.to_world(bs.wo)))
        with dr.resume_grad(when=attached):
            if attached and has_mirrors(scene):
                # What a mirror shows moves with it.
                turned = bsdf.sh_frame(si, mirror).to_world(mirrored(si.wi, bs.wo, bs.eta))
                next_ray = attached_ray(next_ray, Ray3f(si.p, turned), mirror)
            found = scene.closest_hit(dr.detach(next_ray), by_bsdf)
            along = sees_itself(scene, si.shape_index, found.shape_index, by_bsdf & ~delta & found.is_valid())
            target = scene.surface_interaction_of(found, following(next_ray, si.p, along))
            if attached:
                keep(next_ray, target.t, target.uv, target.prim_index)
                smooth = bsdf_weight(scene, bsdf, si, dr.detach(next_ray.d), target, along, by_bsdf & ~delta)
                _, by_mirror = bsdf.sample(ctx, si, lobe, square, mirror)
                scattered = scattered * dr.select(mirror, Color3f(relative(by_mirror)), smooth)
                target.wi = dr.select(mirror | along, target.wi, attached_wi(target, si.p))
            emitted = target.emitter(scene).eval(target, by_bsdf)
            seen = DirectionSample3f(scene, dr.detach(target), dr.detach(si))
            other = scene.pdf_emitter_direction(dr.detach(si), seen, by_bsdf & ~delta)
            mis = dr.select(delta, 1, mis_weight(bs.pdf, other))
            light = light + dr.select(by_bsdf, emitted * scattered * mis, 0)

        if not project:
            return light, covered, [], None
        return light, covered, [], self._seed_rays(si, ds, by_light, next_ray, by_bsdf & target.is_valid(), sampler)

    def _seed_rays(
        self, si: Any, ds: Any, by_light: Bool, next_ray: Ray3f, by_bsdf: Bool, sampler: Any
    ) -> tuple[Ray3f, Bool]:
        """The rays to project: to the emitter, also through what hides it, or along the BSDF's sample."""
        to_light = si.spawn_ray_to(ds.p)
        to_light.maxt = Float(dr.inf)
        by_light = by_light & (dr.dot(si.n, to_light.d) * dr.dot(si.n, si.to_world(si.wi)) > 0)
        if self.project_seed == "emitter":
            return to_light, by_light
        if self.project_seed == "bsdf":
            return next_ray, by_bsdf
        second = by_bsdf & ((sampler.next_1d() > 0.5) | ~by_light)
        o, d = dr.select(second, next_ray.o, to_light.o), dr.select(second, next_ray.d, to_light.d)
        return Ray3f(o, d), by_light | second

    def sample_radiances(
        self, scene: Any, ss: SilhouetteSample3f, curr_depth: Any, sampler: Any, active: Any
    ) -> tuple[Color3f, Color3f, SurfaceInteraction3f, Bool]:
        depth = int(curr_depth[0]) if dr.is_array_v(curr_depth) else int(curr_depth)
        if depth not in (0, 1):
            raise RenderError(f"direct_projective: silhouettes are on the first two edges of a path, found {depth}")
        si, seen_behind, behind, active = self.both_sides(scene, ss, depth == 0, active)
        if depth == 1:
            back, front = (point.emitter(scene).eval(point, active) for point in (seen_behind, si))
        else:
            # The same random numbers on both sides: where they look alike, the difference vanishes.
            ray = ss.spawn_ray()
            back = self.shade(scene, sampler.clone(), ray, 0, seen_behind, active)
            front = self.shade(scene, sampler, ray, 0, si, active)
        return dr.select(active, Color3f(front), 0), dr.select(active, Color3f(back), 0), behind, active

    def radiance_along(
        self, scene: Any, ray: Any, si: Any, depth: Any, sampler: Any, active: Bool, horizon: Vector3f
    ) -> Color3f:
        seen = active & (UInt32(depth) == 0)
        shaded = super().radiance_along(scene, ray, si, 0, sampler, seen, horizon)
        return dr.select(seen, shaded, dr.select(active, si.emitter(scene).eval(si, active & ~seen), 0))

    def sample_importance(
        self,
        scene: Any,
        sensor: Any,
        ss: SilhouetteSample3f,
        max_depth: Any,
        sampler: Any,
        wavelengths: Any,
        active_: Any,
    ) -> tuple[Color3f, Point2f, UInt32, Bool]:
        si = scene.ray_intersect(ss.toward_viewer().spawn_ray(wavelengths), active=active_)
        active = active_ & si.is_valid()
        it = dr.zeros(Interaction3f)
        it.p = si.p
        ds, importance = sensor.sample_direction(it, sampler.next_2d(), active)
        active = active & dr.any(importance != 0)
        active = active & ~self.hides_point(scene, si, ds.p, active)
        to_sensor = si.to_local(ds.d)
        value = si.bsdf().visit(lambda bsdf: eval_pdf_light(bsdf, si, to_sensor, active)[0], active)
        found = Color3f(dr.select(active, value * importance, 0))
        return found, ds.uv, UInt32(2), active & dr.any(found != 0)


register_integrator("direct_projective", DirectProjectiveIntegrator)

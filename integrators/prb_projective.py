"""Paths, with derivatives by the shapes that move."""

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
from djpt.dispatch.family import NONE
from djpt.integrators.projective.carried_rays import carried_rays, onward_direction
from djpt.integrators.projective.projective_sampling import PSIntegrator
from djpt.integrators.projective.reattach import attached_light, attached_wi, bsdf_weight, has_mirrors, relative
from djpt.integrators.projective.self_views import (
    MOST_FOLLOWED,
    Approach,
    body_of,
    has_bodies,
    no_rays,
    noted,
    sees_itself,
)
from djpt.integrators.projective.wedges import above_horizon
from djpt.integrators.projective.weights import mis_weight
from djpt.jit.kernels import opaque
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.materials.base import eval_pdf_light, sample_light
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["PathProjectiveIntegrator"]

SMOOTH, DELTA = int(BSDFFlags.Smooth), int(BSDFFlags.Delta)


class PathProjectiveIntegrator(PSIntegrator):
    """Paths with light sampling, differentiable by the place of shapes.

    The derivative within surfaces replays paths: D. Vicini, S. Speierer and W. Jakob, "Path Replay Backpropagation",
    ACM Trans. Graph. 40(4), 2021; see `docs/theory/path-replay.md`. Those at silhouettes are `PSIntegrator`'s: a path
    is begun at the silhouette, and continued to the sensor and to the emitters. What is said of shadows at
    `djpt.ad.integrators.direct_projective` holds here, too.

    Parameters: those of `PSIntegrator`; `project_seed` (`both`, `bsdf` or `emitter`, default `both`): the rays that are
    projected to guide samples.
    """

    pure = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.project_seed = props.string("project_seed", "both", choices=("both", "bsdf", "emitter"))

    @dr.syntax
    def sample(  # type: ignore[no-untyped-def, override]
        self,
        mode,
        scene,
        sampler,
        ray,
        depth,
        δL,
        state_in,
        active,
        project=False,
        si_shade=None,
        horizon=None,
        **kwargs,
    ):
        primal = mode == dr.ADMode.Primal
        ctx = BSDFContext()
        # The state of loops is an array from the start: what seems constant at first may not stay so.
        zero = dr.opaque(Float, 0, sampler.wavefront_size())
        # Inputs of the kernel, which is that of all depths.
        longest, roulette_from = dr.opaque(UInt32, self.max_depth), dr.opaque(UInt32, self.rr_depth)
        L = Color3f(0 if state_in is None else state_in) + zero
        δL = Color3f(0 if δL is None else δL) + zero
        # Whether rays are attached, and what is known of their changes or adjoints.
        with dr.resume_grad():
            by_camera = not primal and dr.grad_enabled(ray.o, ray.d)
        carries = not primal and (by_camera or has_mirrors(scene) or has_bodies(scene))
        forward, backward = mode == dr.ADMode.Forward, mode == dr.ADMode.Backward
        rays = carried_rays(mode, ray, sampler.wavefront_size())
        β, η = Color3f(1) + zero, Float(1) + zero
        depth = UInt32(depth) + UInt32(zero)
        o, d = Point3f(dr.detach(ray.o)) + zero, Vector3f(dr.detach(ray.d)) + zero
        # That of the sensor's ray, which ends at the far plane, or at once in a dark corner of the film.
        maxt = Float(dr.detach(ray.maxt)) + zero
        # Where the path was before; of its first ray nothing is asked.
        o_before, d_before, p_before = Point3f(zero), Vector3f(zero) + 1, Point3f(zero)
        pdf_before, delta_before = Float(1) + zero, Bool(zero == 0)
        # How many rays in a row a body has taken along by which it sees itself.
        followed = UInt32(zero)
        active = Bool(active) & (zero == 0)
        covered, first = Bool(zero != 0), Bool(zero == 0)
        seeds = UInt32(zero)
        o_seed, d_seed, seeded = Point3f(zero), Vector3f(zero), Bool(zero != 0)

        def hit(ray: Ray3f, active: Bool, from_camera: Bool) -> Any:
            return self.first_hit(scene, ray, active, from_camera)

        while dr.hint(active, label="vertices"):
            here, previous = Ray3f(o, d, maxt=maxt), p_before
            carried = first | delta_before | (followed > 0)
            with dr.resume_grad(when=not primal):
                if dr.hint(not primal, mode="scalar"):
                    moved, previous = rays.attach(here, p_before)
                    moved.maxt = maxt
                    here = moved if carries else here
                si = self.first_hit(scene, here, active, first & (depth == 0))
                if dr.hint(not primal, mode="scalar"):
                    si.wi = dr.select(carried, si.wi, attached_wi(si, previous))
            if dr.hint(si_shade is not None, mode="scalar"):
                si = dr.select(first, si_shade, si)
            still = dr.detach(si)
            covered |= active & first & still.is_valid()
            bsdf = si.bsdf()

            # Light that the vertex emits.
            visible = active & (still.is_valid() | ~first | (depth > 0) if self.hide_emitters else True)
            ds = DirectionSample3f(scene, still, Interaction3f(0, 0, [], p_before))
            known = scene.pdf_emitter_direction(Interaction3f(0, 0, [], p_before), ds, ~delta_before)
            mis = dr.select(delta_before, 1, mis_weight(pdf_before, known))
            with dr.resume_grad(when=not primal):
                Le = β * mis * dr.select(visible, si.emitter(scene).eval(si, visible), 0)

            # Light of emitters.
            onward = active & still.is_valid() & (depth + 1 < longest)
            by_light = onward & has_flag(bsdf.flags(), SMOOTH)
            ds, weight = scene.sample_emitter_direction(still, sampler.next_2d(), True, by_light)
            by_light &= ds.pdf != 0
            if dr.hint(horizon is not None, mode="scalar"):
                by_light &= ~first | above_horizon(ds, horizon)
            with dr.resume_grad(when=not primal):
                toward = ds.d
                if dr.hint(not primal, mode="scalar"):
                    toward, weight = attached_light(scene, si, ds, weight, followed < MOST_FOLLOWED, by_light)
                value, pdf = bsdf.eval_pdf(ctx, si, si.to_local(toward), by_light)
                chance = dr.select(ds.delta, 1, mis_weight(ds.pdf, pdf))
                Lr = β * dr.select(by_light, value * weight * chance, 0)

            # The way onward.
            lobe, square = sampler.next_1d(), sampler.next_2d()
            bs, scattered = bsdf.sample(ctx, still, lobe, square, onward)
            scattered = dr.detach(scattered)
            smooth = onward & has_flag(bs.sampled_type, DELTA)
            onward_ray = dr.detach(still.spawn_ray(still.to_world(bs.wo)))
            L = L + dr.detach(Le + Lr) if primal else L - dr.detach(Le + Lr)

            if dr.hint(project, mode="scalar"):
                to_light = dr.detach(still.spawn_ray_to(ds.p))
                front = dr.dot(still.n, to_light.d) * dr.dot(still.n, still.to_world(still.wi)) > 0
                front |= has_flag(bsdf.flags(), int(BSDFFlags.Transmission))
                by_emitter = self.project_seed == "emitter"
                if dr.hint(self.project_seed == "both", mode="scalar"):
                    by_emitter = front & (sampler.next_1d() > 0.5)
                candidate = onward & (front | ~Bool(by_emitter))
                seeds += dr.select(candidate, UInt32(1), 0)
                chosen = candidate & (sampler.next_1d() * Float(seeds) <= 1)
                o_seed = dr.select(chosen, dr.select(by_emitter, to_light.o, onward_ray.o), o_seed)
                d_seed = dr.select(chosen, dr.select(by_emitter, to_light.d, onward_ray.d), d_seed)
                seeded |= chosen

            throughput = dr.select(onward, β * scattered, 0)
            if dr.hint(not primal, mode="scalar"):
                target = dr.detach(scene.ray_intersect(onward_ray, onward))
                along = onward & ~smooth & target.is_valid() & (followed < MOST_FOLLOWED)
                along = sees_itself(scene, still.shape_index, target.shape_index, along)
                leads = smooth | along
                with dr.resume_grad():
                    change = bsdf_weight(scene, bsdf, si, onward_ray.d, target, along, onward & ~smooth)
                    turned = onward_ray.d
                    if dr.hint(carries, mode="scalar"):
                        _, by_mirror = bsdf.sample(ctx, si, lobe, square, smooth)
                        change = dr.select(smooth, relative(by_mirror), change)
                        turned = dr.select(smooth, onward_direction(si, bs.wo, bs.eta, smooth), turned)
                    Lo = Le + Lr + dr.select(onward, L * change, 0)
                    if dr.hint(backward, mode="scalar"):
                        dr.backward_from(δL * Lo, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)

            way_before = Ray3f(o_before, d_before)
            o_before, d_before, p_before = Point3f(o), Vector3f(d), Point3f(still.p)
            o, d, maxt = Point3f(onward_ray.o), Vector3f(onward_ray.d), Float(onward_ray.maxt)
            pdf_before, delta_before = Float(bs.pdf), has_flag(bs.sampled_type, DELTA)
            η = dr.select(onward, η * bs.eta, η)
            β = Color3f(throughput)
            depth += dr.select(still.is_valid(), UInt32(1), 0)
            # Russian roulette.
            largest = dr.max(β)
            survival = dr.minimum(largest * dr.square(η), 0.95)
            roulette = depth > roulette_from
            β = dr.select(roulette, β / survival, β)
            goes_on = onward & (largest > 0) & (~roulette | (sampler.next_1d() < survival))

            if dr.hint(forward, mode="scalar"):
                with dr.resume_grad():
                    change, rays = rays.leave(Lo, si.p, turned, leads)
                δL = δL + change
            if dr.hint(backward, mode="scalar"):
                with dr.resume_grad():
                    mirrors_on = ~carried & smooth & goes_on
                    rays = rays.end_before(hit, way_before, dr.grad(previous), active & ~carried & ~mirrors_on)
                    rays = rays.keep_rough(way_before, previous, active & mirrors_on)
                    ended = active & carried & ~goes_on
                    rays = rays.end(hit, dr.grad(moved.o), dr.grad(moved.d), ended)
                    η_onward = dr.select(along, -1, bs.eta)
                    by_previous = Vector3f(dr.grad(previous))
                    rays = rays.go_on(moved, bs.wo, η_onward, leads & goes_on, by_previous, mirrors_on)
            if dr.hint(not primal, mode="scalar"):
                followed = dr.select(along, followed + 1, 0)
            active, first = goes_on, first & False

        if backward and by_camera:
            with dr.resume_grad():
                # The graph of the camera is needed again, for what moves on the film.
                seen = dr.dot(ray.o, rays.camera_o) + dr.dot(ray.d, rays.camera_d)
                dr.backward_from(seen, flags=dr.ADFlag.ClearInterior)
        seed_rays = Ray3f(o_seed, d_seed)
        return (L if primal else δL), covered, [], ((seed_rays, seeded) if project else L)

    def sample_radiances(
        self, scene: Any, ss: SilhouetteSample3f, curr_depth: Any, sampler: Any, active: Any
    ) -> tuple[Color3f, Color3f, SurfaceInteraction3f, Bool]:
        ray = ss.spawn_ray()
        si, seen_behind, behind, active = self.both_sides(scene, ss, UInt32(curr_depth) == 0, active)
        # The same random numbers on both sides: where they look alike, the difference vanishes.
        back = self.shade(scene, sampler.clone(), ray, curr_depth, seen_behind, active)
        front = self.shade(scene, sampler, ray, curr_depth, si, active)
        return dr.select(active, Color3f(front), 0), dr.select(active, Color3f(back), 0), behind, active

    def sample_importance(
        self,
        scene: Any,
        sensor: Any,
        ss: SilhouetteSample3f,
        max_depth: Any,
        sampler: Any,
        wavelengths: Any,
        active: Any,
    ) -> tuple[Color3f, Point2f, UInt32, Bool]:
        found = self.sample_viewer(scene, sensor, ss, max_depth, sampler, active)  # type: ignore[no-untyped-call]
        return found[0], found[1], found[2], found[3]

    @dr.syntax
    def sample_viewer(self, scene, sensor, ss, max_depth, sampler, active):  # type: ignore[no-untyped-def]
        start = ss.toward_viewer().spawn_ray()
        # The state of loops is an array from the start: what seems constant at first may not stay so.
        zero, longest = dr.opaque(Float, 0, sampler.wavefront_size()), opaque(UInt32(max_depth))
        o, d = Point3f(start.o) + zero, Vector3f(start.d) + zero
        active = Bool(active) & (zero == 0)
        β, W, place = Color3f(1) + zero, Color3f(zero), Point2f(zero)
        edges, found, count = UInt32(1) + UInt32(zero), UInt32(zero), UInt32(zero)
        # The rays that lead to the first vertex, and how many of them one body takes along.
        most = max(0, min(MOST_FOLLOWED + 1 if has_bodies(scene) else 1, self.max_depth - 2))
        ways = no_rays(most, sampler.wavefront_size())
        viewer, row, unbroken, row_found = UInt32(NONE) + UInt32(zero), UInt32(zero), zero == 0, UInt32(zero)

        while dr.hint(active, label="vertices to the sensor"):
            si = scene.ray_intersect(Ray3f(o, d), active)
            active &= si.is_valid()
            bsdf = si.bsdf()
            it = Interaction3f(0, 0, [], si.p)
            ds, importance = sensor.sample_direction(it, sampler.next_2d(), active)
            edges += dr.select(active, UInt32(1), 0)
            back = si.spawn_ray(-d)
            ways = noted(ways, edges - 3, back, active)
            here = body_of(scene, si.shape_index, active)
            unbroken &= (edges == 2) | ((here == viewer) & (viewer != NONE))
            row += dr.select(unbroken & (edges > 2), UInt32(1), 0)
            viewer = UInt32(here)
            connects = active & has_flag(bsdf.flags(), SMOOTH) & dr.any(importance != 0)
            connects &= ~self.hides_point(scene, si, ds.p, connects)
            count += dr.select(connects, UInt32(1), 0)
            # Of all connections of a path one is kept, each with the same probability.
            chosen = connects & (sampler.next_1d() * Float(count) <= 1)
            value = reflected(si, si.to_local(ds.d), chosen)
            W = dr.select(chosen, β * value * importance, W)
            place = dr.select(chosen, ds.uv, place)
            found, row_found = dr.select(chosen, edges, found), dr.select(chosen, row, row_found)

            active &= edges < longest
            bs, scattered = carried_on(si, sampler.next_1d(), sampler.next_2d(), active)
            β = dr.select(active, β * scattered, β)
            active &= dr.any(β != 0)
            unbroken &= ~has_flag(bs.sampled_type, DELTA) | (edges == 2)
            onward = si.spawn_ray(si.to_world(bs.wo))
            o, d = Point3f(onward.o), Vector3f(onward.d)

        followed = row_found - (row_found // (MOST_FOLLOWED + 1)) * (MOST_FOLLOWED + 1)
        approach = Approach(ways, followed, found == followed + 2)
        return W * Float(count), place, found, dr.any(W != 0), approach


def reflected(si: SurfaceInteraction3f, wo: Vector3f, active: Bool) -> Color3f:
    """The factor of what arrives at surfaces and goes on to a viewer: see `djpt.materials.base.eval_pdf_light`."""
    found: Color3f = si.bsdf().visit(lambda bsdf: eval_pdf_light(bsdf, si, wo, active)[0], active)
    return found


def carried_on(si: SurfaceInteraction3f, lobe: Float, square: Point2f, active: Bool) -> tuple[Any, Color3f]:
    """A sample of a direction to viewers, and its weight."""
    found: tuple[Any, Color3f] = si.bsdf().visit(lambda bsdf: sample_light(bsdf, si, lobe, square, active), active)
    return found


register_integrator("prb_projective", PathProjectiveIntegrator)

"""Edges beyond the film that no shape knows of: rough surfaces see them in mirrors, or are seen in mirrors to do so.

A path that begins at a silhouette reaches the rough surface that sees it, and is connected to the camera. What a chain
of smooth surfaces shows to the rough one, or the rough one to the camera, it doesn't find; nor the edges of patches of
textures, and curves in which surfaces meet. Here a path begins at the camera, and at one of its rough surfaces a random
line on the sphere of directions looks for edges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, BSDFFlags, DirectionSample3f, Ray3f, SurfaceInteraction3f, has_flag
from djpt.core.warp import square_to_uniform_sphere
from djpt.dispatch.family import NONE
from djpt.integrators.projective.crossings import PRECISION, Lines, edges_on_lines
from djpt.integrators.projective.detail import seen_through
from djpt.integrators.projective.kept import keep
from djpt.integrators.projective.self_views import MOST_FOLLOWED, body_of
from djpt.integrators.projective.smooth_chains import MOST_CHAIN_LINKS, Chains, random_turns
from djpt.integrators.projective.spread import spread
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f

__all__ = ["path_edges"]

LENGTH, PARTS = 0.5, 32
"""The length of lines, an angle, and the parts of them that are looked at."""
BY_LIGHT, ANYWHERE = 0.4, 0.2
"""The shares of lines about directions to lights, and about any direction; the others follow the BSDF."""
ROUGH, DELTA = int(BSDFFlags.Smooth), int(BSDFFlags.Delta)
ROUGH_LOBES = BSDFContext(type_mask=ROUGH)


@dataclass
class Arrival:
    """How a path arrives at a rough surface: by a chain of smooth ones from the camera, or from another rough one."""

    o: Point3f
    """Where its first ray begins."""
    d: Vector3f
    """The direction of the first ray."""
    from_camera: Bool
    bits: UInt32
    """The turns of the chain."""
    link: UInt32
    """The number of the ray that arrives, counted from 0."""
    viewer: UInt32
    """The number of the body where the first ray begins, if it takes rays along by which it sees itself."""

    @staticmethod
    def along(o: Point3f, d: Vector3f, from_camera: Bool, none: UInt32, viewer: UInt32) -> Arrival:
        """One whose first ray arrives; `none` is 0 in each lane."""
        return Arrival(Point3f(o), Vector3f(d), from_camera, UInt32(none), UInt32(none), UInt32(viewer))

    def where(self, mask: Bool, other: Arrival) -> Arrival:
        """This on some lanes, another one on the others."""
        return Arrival(*(dr.select(mask, getattr(self, f.name), getattr(other, f.name)) for f in fields(self)))


def path_edges(integrator: Any, scene: Any, sensor: Any, sampler: Any, meetings: bool) -> tuple[Color3f, Point2f, Bool]:
    """The derivative by random points of such edges, attached, their places on the film, and where there are any.

    `meetings`: whether curves count, too, in which surfaces meet.
    """
    window, sensor = Point2f(sensor.film().crop_size()), seen_through(sensor, sampler)
    with dr.suspend_grad():
        place = spread(sampler) * window
        shown, importance = sensor.sample_ray_differential(0, 0, place / window, Point2f(0))
        here, before, viewer, weight, depth, mirrored, active = walk(  # type: ignore[no-untyped-call]
            integrator, scene, sampler, shown, Color3f(importance)
        )
        keep(place, here, before, viewer, weight, depth, mirrored, active)
    camera = sensor.sample_ray_differential(0, 0, place / window, Point2f(0))[0]
    # The point before may have been reached from a rough surface itself, which is taken to stay.
    previous = arrived(integrator, scene, camera, before, None, active).p
    si = arrived(integrator, scene, camera, here, Point3f(previous), active)
    with dr.suspend_grad():
        still = dr.detach(si)
        active &= still.is_valid()
        middle, density = direction(scene, still, sampler, active)
        active &= density > 0
        sin, cos = dr.sincos(2 * math.pi * sampler.next_1d())
        frame = Frame3f.from_normal(middle)
        along, aside = frame.s * cos + frame.t * sin, frame.t * cos - frame.s * sin
        chains = Chains(integrator, scene, integrator.max_depth - 2, False)

    def toward(s: Float, r: Float) -> Vector3f:
        a, b = dr.sincos(s - 0.5 * LENGTH), dr.sincos(r)
        return Vector3f((middle * a[1] + along * a[0]) * b[1] + aside * b[0])

    def rays(s: Float, r: Float) -> Ray3f:
        d = toward(s, r)
        return Ray3f(dr.detach(still.spawn_ray(dr.detach(d)).o), d)

    bits = random_turns(sampler)
    lines = Lines(
        rays, LENGTH, PRECISION, PARTS, bits, depth, meetings, outlines=mirrored, start=Point3f(si.p), viewer=viewer
    )

    def scattered(s: Float) -> Color3f:
        """The BSDF in the direction of an edge, by the density of lines."""
        value = still.bsdf().eval(ROUGH_LOBES, still, still.to_local(toward(s, Float(0))), active)
        return Color3f(weight * value * dr.select(active, dr.rcp(density), 0))

    value, mass, _ = edges_on_lines(integrator, chains, lines, sampler, active, scattered)
    return value, place, mass > 0


def arrived(
    integrator: Any, scene: Any, camera: Ray3f, way: Arrival, previous: Point3f | None, active: Bool
) -> SurfaceInteraction3f:
    """The hits that chains lead to, attached to the camera's rays, and to the points that others come from."""
    chains = Chains(integrator, scene, integrator.max_depth - 1, way.from_camera)
    first = Ray3f(dr.select(way.from_camera, camera.o, way.o), dr.select(way.from_camera, camera.d, way.d))
    ray = chains.attached(first, way.bits, way.link, active, previous, way.viewer)
    return chains.hit(ray, way.link, active)


def direction(scene: Any, si: SurfaceInteraction3f, sampler: Any, active: Bool) -> tuple[Vector3f, Float]:
    """A direction that much light arrives from, or any one, and its density."""
    bs, _ = si.bsdf().sample(ROUGH_LOBES, si, sampler.next_1d(), sampler.next_2d(), active)
    ds, _ = scene.sample_emitter_direction(si, sampler.next_2d(), False, active)
    choice, anywhere = sampler.next_1d(), square_to_uniform_sphere(sampler.next_2d())
    by_light = (choice < BY_LIGHT) & (ds.pdf > 0) & ~ds.delta
    by_bsdf = (choice >= BY_LIGHT) & (choice < 1 - ANYWHERE) & (bs.pdf > 0)
    d = dr.select(by_light, ds.d, dr.select(by_bsdf, si.to_world(bs.wo), anywhere))
    hit = scene.ray_intersect(si.spawn_ray(d), active=active)
    of_light = scene.pdf_emitter_direction(si, DirectionSample3f(scene, hit, si), active)
    of_bsdf = si.bsdf().pdf(ROUGH_LOBES, si, si.to_local(d), active)
    # Directions to lights that something hides count only as those of the BSDF.
    valid = active & ((by_light & (of_light > 0)) | by_bsdf | (choice >= 1 - ANYWHERE))
    density = BY_LIGHT * of_light + (1 - BY_LIGHT - ANYWHERE) * of_bsdf + ANYWHERE / (4 * math.pi)
    return Vector3f(d), dr.select(valid, density, 0)


@dr.syntax
def walk(integrator, scene, sampler, ray, weight):  # type: ignore[no-untyped-def]
    """A path from the camera, of whose rough surfaces one is chosen.

    Returns how the path arrives there, and at the rough surface before; the number of the body there if it takes rays
    along, else `NONE`; the weight, the number of edges up to there, whether the first surface of the path was smooth,
    and where there is such a path.
    """
    ctx = BSDFContext()
    zero = dr.opaque(Float, 0, sampler.wavefront_size())
    longest, roulette_from = dr.opaque(UInt32, integrator.max_depth), dr.opaque(UInt32, integrator.rr_depth)
    none = UInt32(zero)
    o, d, maxt = Point3f(ray.o) + zero, Vector3f(ray.d) + zero, ray.maxt + zero
    nothing = UInt32(NONE) + none
    way, way_before, here, before = (Arrival.along(o, d, zero == 0, none, nothing) for _ in range(4))
    β, kept, depth, edges = Color3f(weight) + zero, Color3f(zero), UInt32(none), UInt32(none)
    row, viewer, kept_viewer = UInt32(none), UInt32(nothing), UInt32(nothing)
    count, mirrored, η, active = UInt32(none), zero != 0, Float(1) + zero, zero == 0

    while dr.hint(active, label="vertices before an edge"):
        si = integrator.first_hit(scene, Ray3f(o, d, maxt=maxt), active, depth == 0)
        depth += 1
        active &= si.is_valid() & (depth < longest)
        bsdf = si.bsdf()

        # A rough surface sees edges by its rough lobes. Of those of a path one is kept, each with the same probability.
        sees = active & has_flag(bsdf.flags(), ROUGH) & (way.link <= MOST_CHAIN_LINKS)
        count += dr.select(sees, UInt32(1), 0)
        chosen = sees & (sampler.next_1d() * Float(count) <= 1)
        here, before = way.where(chosen, here), way_before.where(chosen, before)
        same = (way.viewer != NONE) & (way.viewer == body_of(scene, si.shape_index, active))
        row = dr.select((way.link == 0) & same, row + 1, 0)
        viewer = body_of(scene, si.shape_index, active & (row < MOST_FOLLOWED))
        kept_viewer = dr.select(chosen, viewer, kept_viewer)
        kept, edges = dr.select(chosen, β, kept), dr.select(chosen, depth, edges)

        bs, scattered = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), active)
        β = dr.select(active, β * scattered, β)
        smooth = has_flag(bs.sampled_type, DELTA)
        mirrored |= active & (depth == 1) & smooth
        onward = si.spawn_ray(si.to_world(bs.wo))
        o, d, maxt = Point3f(onward.o), Vector3f(onward.d), Float(onward.maxt)
        through = dr.select(bs.wo.z * si.wi.z < 0, UInt32(1), 0)
        led_on = Arrival(way.o, way.d, way.from_camera, way.bits | (through << way.link), way.link + 1, way.viewer)
        fresh = Arrival.along(o, d, zero != 0, none, viewer)
        way_before = way_before.where(smooth, way)
        way = led_on.where(smooth, fresh)

        # Russian roulette.
        η = dr.select(active, η * bs.eta, η)
        largest = dr.max(β)
        survival = dr.minimum(largest * dr.square(η), 0.95)
        roulette = depth > roulette_from
        β = dr.select(roulette, β / survival, β)
        active &= (largest > 0) & (~roulette | (sampler.next_1d() < survival))

    return here, before, kept_viewer, kept * Float(count), edges, mirrored, count > 0

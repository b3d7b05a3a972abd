"""Paths of a given length, each by a single strategy of bidirectional path tracing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, Ray3f, Reference, SurfaceInteraction3f, has_flag
from djpt.integrators.bdpt import BidirectionalPath
from djpt.integrators.bidirectional.subpath import CompactInteraction, Subpath, meeting, mis_weight
from djpt.integrators.paths.path_vertex import PathVertex, Scattering
from djpt.jit.kernels import loop_traced_once, wide
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.materials.base import BSDF, sample_light
from djpt.samplers.base import SampleStream
from djpt.sensors.base import Sensor

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["LastVertex", "SingleStrategy", "numbers_drawn"]


def numbers_drawn(edges: int) -> int:
    """The most numbers that `SingleStrategy.sample` draws for a path of so many edges."""
    # The emission, the film with lens and time, the joint; then three for each vertex.
    return 5 + 5 + 2 + 3 * edges


class LastVertex(CompactInteraction):
    """The last vertex of one side of a path, as local memory keeps it."""

    valid: UInt32
    """1 on a surface, 0 where the sky was met. Local memory of masks isn't possible."""
    medium: UInt32
    throughput: Color3f
    vcm: Float
    vc: Float
    depth: UInt32
    covered: UInt32
    """1 where the path has hit a surface other than null interfaces before."""

    @staticmethod
    def at(si: SurfaceInteraction3f, subpath: Subpath, covered: Bool) -> LastVertex:
        """The vertex `si`, where the `subpath` of a path has arrived; on a miss, the sky."""
        kept = CompactInteraction.fields_of(si)
        kept["face"] = dr.select(si.is_valid(), si.face, 0)
        vertex: LastVertex = LastVertex.holding(
            **kept,
            valid=dr.select(si.is_valid(), UInt32(1), 0),
            medium=UInt32(0) if si.medium is None else si.medium,
            throughput=subpath.throughput,
            vcm=subpath.vcm,
            vc=subpath.vc,
            depth=subpath.depth,
            covered=dr.select(covered, UInt32(1), 0),
        )
        return vertex

    def surface(self, scene: Scene, time: tuple[Float, ...]) -> SurfaceInteraction3f:
        """The surface point, at the given time."""
        si = self.interaction(scene, (self.medium,) if scene.media else ())
        valid = self.valid != 0
        si.found_at(dr.select(valid, Float(0), dr.inf), valid)
        if time:
            si.time = time[0]
        return si

    def subpath(self, si: SurfaceInteraction3f) -> Subpath:
        """The subpath that ends here, at the surface point `si`."""
        d = dr.select(si.is_valid(), si.to_world(self.wi), self.wi)
        return Subpath(Ray3f(self.p, -d), self.throughput, self.vcm, self.vc, Float(0), None, self.depth)


@dataclass
class Walk:
    """Loop state: first the path from the light is walked, then that from the camera."""

    subpath: Subpath
    numbers: Any
    on_light: Bool
    left: UInt32
    """The number of vertices to come on this side."""
    covered: Bool
    """True where the camera path has hit a surface other than null interfaces."""
    active: Bool
    complete: Bool
    """True where both sides have been walked to their last vertices."""
    last: Any
    """The last vertices, in local memory: of the light's side, and of the camera's."""


@dataclass
class SingleStrategy:
    """Samples the light of paths of a given length, each by one of the strategies.

    With N strategies (s, t) for paths of k edges, s + t = k + 1, the expectation of

        N w_s C_s,    s uniform among the strategies,

    is all light of that length: w_s is the weight of `djpt.integrators.bidirectional.subpath`, and C_s what the path
    brings. k rays are traced for a path of k edges, no matter which strategy makes it.
    """

    bdpt: BidirectionalPath
    scene: Scene
    camera: Sensor
    ray_at: Callable[[Point2f, SampleStream], Ray3f]
    """The camera ray through a place in [0, 1)^2 of the crop window."""

    def count(self, edges: UInt32) -> UInt32:
        """The number of strategies for paths of so many edges."""
        return edges + 1 if self.camera.can_be_reached else edges

    def chosen(self, edges: UInt32, u: Float) -> UInt32:
        """The strategy that a uniform number chooses: the vertices on the light's side."""
        count = self.count(edges)
        return dr.minimum(UInt32(u * Float(count)), count - 1)

    def sample(
        self, edges: UInt32, s: UInt32, numbers: SampleStream, last: Any
    ) -> tuple[Point2f, Color3f, SampleStream, Any]:
        """A path of `edges` edges, two or more, with `s` vertices on the light's side.

        Returns the place in [0, 1)^2 of the crop window that it lights, and its light N w_s C_s as a density: that per
        pixel is the mean over all samples times the number of pixels. Also the stream, and the local memory `last` of
        two `LastVertex`, which is only used meanwhile.
        """
        scene, bdpt = self.scene, self.bdpt
        t = edges + 1 - s

        # ---------------- Where both sides begin --------------
        light, power = bdpt.at_light(scene, numbers)
        position = numbers.next_2d()
        ray = self.ray_at(position, numbers)
        if ray.times:
            light.ray.time = ray.time
        camera = bdpt.at_camera(scene, self.camera, ray, Bool(True))
        joint = numbers.next_2d()

        # ----------------------- Walk -------------------------
        lanes, from_light = dr.width(edges, numbers, ray), s > 1
        light, camera = replace(light, eta=None), replace(camera, eta=None)
        start = Walk(
            subpath=dr.select(from_light, light, camera),
            numbers=numbers,
            on_light=from_light,
            left=dr.select(from_light, s, t) - 1,
            covered=Bool(False),
            active=Bool(True),
            complete=Bool(False),
            last=None,
        )
        start = wide(start, lanes)
        start.last = last

        def body(walk: Walk) -> tuple[Walk]:
            return (self.next_vertex(walk, camera, t),)

        (walk,) = loop_traced_once(start, lambda walk: walk.active, body, "one strategy")

        # ----------------------- Join -------------------------
        at_light = walk.last.read(UInt32(0), walk.complete & from_light)
        at_camera = walk.last.read(UInt32(1), walk.complete & (t > 1))
        shown, brought = self.joined(s, t, walk.complete, at_light, at_camera, power, joint, position, ray.times)
        return shown, brought * Float(self.count(edges)), walk.numbers, walk.last

    def next_vertex(self, walk: Walk, camera: Subpath, t: UInt32) -> Walk:
        """Walk to the next vertex, and turn to the camera's side after the last one of the light's."""
        scene, h, ray, on_light = self.scene, self.bdpt.h, walk.subpath.ray, walk.on_light
        passes_lights = ~on_light & (walk.subpath.depth == 1) if self.bdpt.hide_emitters else None
        si = scene.surface_interaction(ray, scene.closest_hit(ray, through_lights=passes_lights), scene.surface_detail)
        vertex, hit = PathVertex(si, None), si.is_valid()
        subpath = walk.subpath.arrived(vertex, scene.media.transmittance(ray, si.t), h)
        is_last = walk.left == 1
        walk.last.write(
            LastVertex.at(si, subpath, walk.covered), dr.select(on_light, UInt32(0), 1), walk.active & is_last
        )
        turns = is_last & on_light & hit & (t > 1)

        goes_on = walk.active & hit & ~is_last
        s = self.scattered(si, on_light, walk.numbers, goes_on)
        throughput = subpath.throughput * s.weight
        goes_on &= dr.max(throughput) > 0
        passes = has_flag(s.sample.sampled_type, BSDFFlags.Null)
        walk.covered |= ~on_light & ~passes
        walk.subpath = dr.select(turns, camera, subpath.scattered(vertex, s, throughput, h))
        # What has met the sky may still be a path: see `joined`.
        walk.complete = walk.active & is_last & ~turns & (hit | ~on_light)
        walk.active = goes_on | (walk.active & turns)
        walk.on_light = on_light & ~turns
        walk.left = dr.select(turns, t, walk.left) - 1
        return walk

    def scattered(self, si: SurfaceInteraction3f, on_light: Bool, numbers: SampleStream, active: Bool) -> Scattering:
        """Sample the BSDF, for either side of a path."""
        sample1, sample2 = numbers.next_1d(), numbers.next_2d()

        def method(bsdf: BSDF) -> tuple[BSDFSample3f, Color3f, Float]:
            bs, weight = bsdf.sample(BSDFContext(), si, sample1, sample2, active)
            of_light, adjoint = sample_light(bsdf, si, sample1, sample2, active)
            bs = dr.select(on_light, of_light, bs)
            # Whichever way light goes, the way back has the density of its direction.
            back = bsdf.eval_pdf_both(BSDFContext(), si, bs.wo, active)[2]
            return bs, dr.select(on_light, adjoint, weight), back

        bs, weight, back = si.bsdf().visit(method, active)
        return Scattering(Color3f(0), Float(0), Float(0), bs, weight, back)

    def joined(
        self,
        s: UInt32,
        t: UInt32,
        complete: Bool,
        v: LastVertex,
        z: LastVertex,
        power: Float,
        joint: Point2f,
        position: Point2f,
        time: tuple[Float, ...],
    ) -> tuple[Point2f, Color3f]:
        """The place on the film, and the weighted light, of a path whose sides end at `v`, the light's, and `z`."""
        scene, bdpt, h = self.scene, self.bdpt, self.bdpt.h
        lit, seen = v.surface(scene, time), z.surface(scene, time)
        at_lit, at_seen = PathVertex(lit, None), PathVertex(seen, None)
        subpath = z.subpath(seen)
        flux = v.throughput * power
        sampled, shown = s == 1, t == 1

        light = scene.lights.sampling.sample(Reference(seen.p, seen.n), joint, complete & sampled)
        ds = light.ds
        between = v.p - z.p
        falloff = dr.rcp(dr.squared_norm(between))
        d = between * dr.sqrt(falloff)

        d_seen = dr.select(sampled, ds.d, d)
        value, pdf, back = at_seen.evaluate(scene, True, d_seen)
        by_sample = bdpt.light_sample_weight(scene, subpath, at_seen, ds, pdf, back)
        d_lit, importance = -d, Float(0)
        if self.camera.can_be_reached:
            to_camera, importance = self.camera.sample_wi(v.p, joint)
            d_lit = dr.select(shown, to_camera.d, d_lit)
            position = dr.select(shown, to_camera.uv, position)
        sent, sent_pdf, sent_back = at_lit.evaluate(scene, False, d_lit)

        # From one vertex to the other, or to the lens.
        at_light = pdf * dr.abs(dr.dot(lit.n, d)) * falloff
        at_camera = sent_pdf * dr.abs(dr.dot(seen.n, d)) * falloff
        by_camera = dr.select(shown, Float(0), meeting(subpath.vcm, subpath.vc, at_camera, back, h))
        seen_from = dr.select(shown, importance * dr.abs(dr.dot(lit.n, d_lit)), at_light)
        by_light = meeting(v.vcm, v.vc, seen_from, sent_back, h)
        weight = dr.select(sampled, by_sample, mis_weight(by_light + by_camera))

        value = dr.select(shown, 1, subpath.throughput * value)
        sent = dr.select(sampled, light.weight, flux * sent * dr.select(shown, importance, falloff))
        joins = (s > 0) & (shown | smooth(seen)) & (sampled | smooth(lit))
        result = dr.select(complete & joins & (shown | seen.is_valid()), value * sent * weight, 0)
        ray = dr.select(sampled, scene.shadow_ray(seen, ds), seen.spawn_ray_to(lit.offset_p(-d)))
        if self.camera.can_be_reached:
            if bdpt.hide_emitters:
                result = dr.select(shown & lit.emitter().is_valid(), 0, result)
            ray = dr.select(shown, lit.spawn_ray_to(to_camera.p), ray)
        through_lights = shown if bdpt.hide_emitters else False
        result = scene.transmittance(ray, result, to_emitter=False, through_lights=through_lights)

        # --------------------- Light met ----------------------
        met, met_weight = bdpt.met(scene, subpath, at_seen, z.covered != 0)
        result = dr.select(s == 0, dr.select(complete, met * met_weight, 0), result)
        largest = dr.max(result)
        return position, dr.select((largest > 0) & (largest < dr.inf), result, 0)


def smooth(si: SurfaceInteraction3f) -> Bool:
    """True where vertices can be joined at a surface point."""
    return has_flag(si.bsdf().flags(), BSDFFlags.Smooth)

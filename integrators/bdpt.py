"""Bidirectional path tracing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import DirectionSample3f, Ray3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.integrators.bidirectional.strategies import (
    MAX_PYRAMID,
    Sink,
    SplattingIntegrator,
    StrategyImages,
    layer_names,
)
from djpt.integrators.bidirectional.subpath import (
    CameraHit,
    CameraLane,
    CameraStep,
    Lane,
    LightHit,
    LightStep,
    LightVertex,
    Subpath,
    balance,
    departure,
    is_beam,
    meeting,
    mis_weight,
    power,
    scaled,
    vertices,
)
from djpt.integrators.paths.path_vertex import NextVertex, PathVertex, Scattering, is_half_open, next_vertex
from djpt.integrators.paths.transmittance import transmittance
from djpt.integrators.termination import Terminating, first_roulette, roulette
from djpt.jit.kernels import loop_traced_once, while_loop, wide
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32
from djpt.samplers.base import SampleStream
from djpt.sensors.base import Sensor

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["JOINED", "BidirectionalPath"]

JOINED = 32
"""Edges of the longest path that is joined from both ends; longer ones are left to the camera's side.

Light paths have memory for as many vertices, whatever `max_depth` is: a kernel's memory can't be a value.
"""


@dataclass
class ChosenConnection:
    """One of the connections of a vertex."""

    to: Point3f
    """Where its ray ends."""
    color: Color3f
    """Its light, if nothing were on the way, with the largest channel 1."""
    total: Float
    """The sum of the largest channels of all connections so far."""


class BidirectionalPath(Terminating, SplattingIntegrator):
    """Joins a path from the camera and one from a light in all ways that there are.

    A light path y_0 .. y_(m-1) and a camera path x_0 .. x_(n-1) give, for each s <= m and t <= n, one sample of the
    light along paths of s + t - 1 edges: s = 0 is a light that is met, s = 1 a light sample, t = 1 a light path's
    vertex that the camera sees. Each counts with its weight against all others that could have made the same path:
    see `djpt.integrators.bidirectional.subpath`.

    Strong where light comes from a lamp in a fixture or through glass; elsewhere a sample costs several times as
    much as one of `path`, and gains little. Sensors that light can't be traced to, such as meters, are left out as
    ends: t = 1 then gives nothing.

    Media that scatter light are followed as by `volpath`: a place where light is scattered is a vertex, and null
    surfaces are none, for paths and for what joins them. Densities of distances aren't in the weights.

    Parameters: `max_depth` (edges of the longest path, -1 = unbounded, default -1), `rr_depth` (Russian roulette
    starts there, on either side, default 5), `hide_emitters`, `emitter_choice` (`uniform`, default, or `power`),
    `heuristic` (`power`, default, or `balance`), `strategies` (default false): further images, of each strategy by
    itself, weighted (``s2t3.R`` ..) and as if there were no other (``s2t3.alone.R`` ..), for paths of two and more
    edges; needs a `max_depth` from 2 to 8. Paths of more than 32 edges are found from the camera only.

    E. Lafortune and Y. Willems, "Bi-directional Path Tracing", 1993; E. Veach and L. Guibas, "Bidirectional Estimators
    for Light Transport", 1994; weights are those of I. Georgiev, "Implementing Vertex Connection and Merging", 2012.
    """

    pure = True
    starts_at_lights = True
    follows_media = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", -1, low=-1)
        self.rr_depth = first_roulette(props, self.max_depth)
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=("uniform", "power"))
        self.h = {"power": power, "balance": balance}[props.string("heuristic", "power", choices=("power", "balance"))]
        self.strategies = props.boolean("strategies", False)
        if self.strategies and not 2 <= self.max_depth <= MAX_PYRAMID:
            raise props.error("strategies", f"needs a 'max_depth' from 2 to {MAX_PYRAMID}, found {self.max_depth}")
        self.differentiable = not self.strategies

    @property
    def joined(self) -> UInt32:
        """The edges of the longest path that is joined from both ends, 1-wide."""
        return dr.minimum(self.longest, JOINED)

    @property
    def starts_light_paths(self) -> bool:
        """True if there are light paths: false if only directly visible light is shown."""
        return not 0 <= self.max_depth <= 1

    def layer_names(self) -> Sequence[str]:
        return layer_names(self.max_depth) if self.strategies else ()

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        if not scene.emitters():
            raise RenderError("'bdpt' starts at emitters, and the scene has none; possible: the integrator 'volpath'")
        super().check_scene(scene, sensor)

    def splat_sample(
        self, scene: Scene, camera: Sensor, sampler: SampleStream, ray: Ray3f, position: Point2f, sink: Sink
    ) -> tuple[Color3f, Bool, list[Float]]:
        strategy_images, lanes = StrategyImages(sink, position, self.strategies), dr.width(ray, sampler)
        light = self.light_path(scene, camera, sampler, strategy_images, lanes)
        camera_path = CameraLane(
            subpath=wide(self.at_camera(scene, camera, ray, strategy_images.inside), lanes),
            sampler=light.sampler,
            active=dr.full(Bool, self.max_depth != 0, lanes),
            vertices=light.vertices,
            count=light.count,
            radiance=dr.zeros(Color3f, lanes),
            covered=dr.full(Bool, False, lanes),
        )

        def from_camera(lane: CameraLane) -> tuple[CameraLane]:
            hit = self.camera_hit(scene, lane.subpath, ray.maxt, lane.covered, lane.sampler, lane.active)
            t = hit.subpath.depth + 1
            radiance = lane.radiance + strategy_images.weighed(hit.met, hit.weight, UInt32(0), t)
            if hit.emitted is not None:
                radiance += hit.emitted
            step = self.camera_step(scene, hit, lane.sampler)
            radiance += strategy_images.weighed(step.lit, step.weight, UInt32(1), t)

            count = dr.select(hit.joins, lane.count, 0)
            if not self.strategies:
                found, lane.sampler, lane.vertices = self.one_connection(scene, hit, count, lane.sampler, lane.vertices)
                lane.radiance = radiance + found
            else:

                def connect(
                    i: UInt32, radiance: Color3f, sampler: Any, vertices: Any
                ) -> tuple[UInt32, Color3f, Any, Any]:
                    v = vertices.read(i)
                    to, value, weight = self.connection(scene, hit.subpath, hit.vertex, v)
                    value = transmittance(scene, sampler, hit.vertex.ray_to(to), value, to_emitter=False)
                    radiance += strategy_images.weighed(value, weight, v.depth + 1, t)
                    return i + 1, radiance, sampler, vertices

                _, lane.radiance, lane.sampler, lane.vertices = while_loop(
                    (dr.zeros(UInt32, dr.width(count)), radiance, lane.sampler, lane.vertices),
                    lambda i, radiance, sampler, vertices: i < count,
                    connect,
                    label="connections",
                )
            lane.covered |= step.covers
            lane.subpath, lane.active = self.after(scene, hit, step, lane.sampler)
            return (lane,)

        (camera_path,) = loop_traced_once(camera_path, lambda lane: lane.active, from_camera, "camera path")
        sky: Any = scene.environment() is not None and not self.hide_emitters and self.max_depth != 0
        if sky and scene.has_image_circle:
            sky = ray.maxt > 0
        return camera_path.radiance, camera_path.covered | sky, []

    # ---- from the light ----------------------------------------------------------------

    def light_path(
        self, scene: Scene, camera: Sensor, sampler: SampleStream, strategy_images: StrategyImages, lanes: int
    ) -> Lane:
        """Trace a light path, and show its vertices to the camera; the lane goes on with its random numbers."""
        subpath, power = self.at_light(scene, sampler)
        start = Lane(
            subpath=wide(subpath, lanes),
            sampler=sampler,
            active=dr.full(Bool, self.starts_light_paths, lanes),
            vertices=vertices(scene, JOINED),
            count=dr.zeros(UInt32, lanes),
        )

        def body(lane: Lane) -> tuple[Lane]:
            hit = self.light_hit(scene, lane.subpath, power, lane.sampler, lane.active)
            lane.vertices.write(hit.light_vertex, lane.count, hit.joins)
            step = self.light_step(scene, camera, hit, lane.sampler)
            if step.shown is not None:
                strategy_images.show(step.position, step.shown, step.weight, hit.subpath.depth + 1)
            lane.subpath, lane.active = step.subpath, step.active
            lane.count = dr.select(hit.joins, lane.count + 1, lane.count)
            if is_half_open(scene):
                # Paths that pass a surface straight can be joined to it as well, and have no edge less.
                lane.active &= lane.count < JOINED
            return (lane,)

        return loop_traced_once(start, lambda lane: lane.active, body, "light path")[0]

    def at_light(self, scene: Scene, sampler: SampleStream) -> tuple[Subpath, Float]:
        """A path that leaves an emitter, with throughputs up to 1, and the power that they are shares of."""
        start = departure(scene, sampler)
        es, inverse = start.sample, start.inverse
        # The density of light sampling over that of emission; the choice of the emitter is part of both.
        vcm = self.h(dr.rcp(dr.select(es.finite, es.pdf_direction, es.pdf_position)))
        if any(is_beam(e.flags()) for e in scene.emitters()):
            vcm = dr.select(is_beam(start.emitter.flags()), 0, vcm)  # no light sample finds it
        power = dr.detach(dr.max(es.weight) * inverse)
        if dr.grad_enabled(es.weight):
            power = dr.select(power > 0, power, 1)  # black light may have derivatives
        subpath = Subpath(
            ray=start.ray(scene),
            throughput=es.weight * dr.select(power > 0, inverse * dr.rcp(power), 0),
            vcm=vcm,
            vc=dr.select(es.delta, 0, self.h(es.cos * inverse * dr.rcp(es.pdf_position * es.pdf_direction))),
            before=dr.select(es.finite, Float(0), dr.inf),
            eta=Float(1) if scene.bsdfs.refract else None,
            depth=UInt32(1),
        )
        return subpath, power

    def light_hit(self, scene: Scene, incoming: Subpath, power: Float, sampler: SampleStream, active: Bool) -> LightHit:
        """Follow a light path to its next vertex."""
        si = scene.surface_interaction(incoming.ray, scene.closest_hit(incoming.ray), scene.surface_detail)
        reached = next_vertex(scene, incoming.ray, si, incoming.throughput, sampler)
        vertex = reached.vertex
        subpath = self.joinable(scene, incoming.arrived(vertex, reached.transmittance, self.h), vertex)
        on = active & vertex.si.is_valid()
        joins = on & vertex.is_smooth()
        flux = subpath.throughput * power
        light_vertex = LightVertex.at(vertex, dr.detach(flux), subpath)
        return LightHit(vertex, incoming, subpath, flux, light_vertex, joins, on)

    def light_step(self, scene: Scene, camera: Sensor, hit: LightHit, sampler: SampleStream) -> LightStep:
        """Show a vertex of a light path to the camera, and go on."""
        vertex, subpath, joins = hit.vertex, hit.subpath, hit.joins
        shows = self.shows_light(scene, camera)
        position, shown, weight, to_camera = Point2f(0), None, Float(0), None
        if shows:
            ds, importance = camera.sample_wi(vertex.si.p, sampler.next_2d() if camera.uses_aperture else Point2f(0.5))
            position, to_camera = ds.uv, ds.d
        s = vertex.scatter(scene, False, to_camera, sampler, hit.active)
        if shows:
            shown = hit.flux * s.value * importance
            if self.hide_emitters:
                shown = dr.select(vertex.si.emitter().is_valid(), 0, shown)
            shown = dr.select(joins, shown, 0)
            lit = joins if dr.grad_enabled(shown) else None
            shown = transmittance(
                scene, sampler, vertex.ray_to(ds.p), shown, lit, to_emitter=False, through_lights=self.hide_emitters
            )
            vcm, vc = self.mergeable(scene, subpath, vertex, None, None)
            weight = mis_weight(meeting(vcm, vc, importance * vertex.cos(ds.d), s.back, self.h))

        onward, survives = self.onwards(scene, sampler, hit, s, subpath.depth > self.roulette_from)
        active = hit.active & (onward.depth < self.joined) & survives
        return LightStep(position, shown, weight, onward, active)

    def shows_light(self, scene: Scene, camera: Sensor) -> bool:
        """True if vertices of light paths are shown to the camera."""
        # Among media rays to the camera go through null surfaces, but not through lamps.
        return camera.can_be_reached and not (self.hide_emitters and scene.media.scatter)

    # ---- from the camera ---------------------------------------------------------------

    def at_camera(self, scene: Scene, camera: Sensor, ray: Ray3f, inside: Bool) -> Subpath:
        """A path that begins with a camera ray; `inside`: whether a light path can be shown there."""
        vcm, before = Float(0), Float(0)
        if self.shows_light(scene, camera):
            pdf, before = camera.pdf_ray(ray)
            vcm = dr.select(inside, self.h(dr.rcp(pdf)), 0)
        eta = Float(1) if scene.bsdfs.refract else None
        return Subpath(ray, Color3f(1), vcm, Float(0), before, eta, UInt32(1))

    def camera_hit(
        self, scene: Scene, incoming: Subpath, maxt: Float, covered: Bool, sampler: SampleStream, active: Bool
    ) -> CameraHit:
        """Follow a camera path to its next vertex, where it may meet light."""
        first = incoming.depth == 1
        ray = Ray3f(incoming.ray.o, incoming.ray.d, maxt=dr.select(first, maxt, dr.inf), medium=incoming.ray.medium)
        hit = scene.closest_hit(ray, through_lights=first if self.hide_emitters else None)
        si = scene.surface_interaction(ray, hit, scene.surface_detail)
        reached = next_vertex(scene, ray, si, incoming.throughput, sampler)
        vertex, emitted = reached.vertex, reached.emitted
        subpath = incoming.arrived(vertex, reached.transmittance, self.h)
        met, weight = self.met(scene, subpath, vertex, covered)
        on = active & vertex.si.is_valid()
        further = on & (subpath.depth < self.longest)
        joins = further & vertex.is_smooth()
        emitted = None if emitted is None else incoming.throughput * emitted
        for found in (
            self.merged(scene, subpath, vertex, sampler, joins),
            self.crossed(scene, incoming, reached, active),
        ):
            if found is not None:
                emitted = found if emitted is None else emitted + found
        # Through null surfaces all paths go on.
        return CameraHit(
            vertex,
            incoming,
            self.joinable(scene, subpath, vertex),
            emitted,
            met,
            weight,
            joins,
            on if scene.media.scatter else further,
        )

    def camera_step(self, scene: Scene, hit: CameraHit, sampler: SampleStream) -> CameraStep:
        """Sample light at a vertex of a camera path, and a continuation."""
        vertex, subpath, joins = hit.vertex, hit.subpath, hit.joins
        light = scene.lights.sampling.sample(vertex.reference, sampler.next_2d(), joins)
        ds = light.ds
        s = vertex.scatter(scene, True, ds.d, sampler, hit.active)
        value = dr.select(joins, subpath.throughput * s.value * light.weight, 0)
        lit = joins if dr.grad_enabled(value) else None
        shadow_ray = vertex.in_medium(scene.shadow_ray(vertex.si, ds))
        lit_by = transmittance(scene, sampler, shadow_ray, value, lit)
        weight = self.light_sample_weight(scene, subpath, vertex, ds, s.pdf, s.back)
        return CameraStep(s, lit_by, weight, vertex.si.is_valid() & ~vertex.passes(s))

    def after(self, scene: Scene, hit: CameraHit, step: CameraStep, sampler: SampleStream) -> tuple[Subpath, Bool]:
        """The continuation of a camera path at a vertex, and where there is one."""
        onward, survives = self.onwards(scene, sampler, hit, step.scattering, hit.subpath.depth >= self.roulette_from)
        active = hit.active & survives
        return onward, active & (onward.depth <= self.longest) if scene.media.scatter else active

    def met(self, scene: Scene, subpath: Subpath, vertex: PathVertex, covered: Bool) -> tuple[Color3f, Float]:
        """The emission of the surface, or of the environment, that a camera path has hit, and its weight: s = 0."""
        si = vertex.si
        emitter = si.emitter()
        radiance = subpath.throughput * emitter.eval(si)
        if vertex.medium_vertex is not None:
            radiance = dr.select(vertex.medium_vertex.inside, 0, radiance)
        if self.hide_emitters:
            radiance = dr.select(covered | si.is_valid(), radiance, 0)
        chosen = scene.lights.choice.probability(Point3f(0), None, emitter.index)
        position, direction = emitter.pdf_emission(-subpath.ray.d, si.sh_frame.n, si.uv)
        # Light from infinity is sampled by direction, and its rays by position then.
        last, before = (dr.select(si.is_valid(), a, b) for a, b in ((position, direction), (direction, position)))
        others = meeting(subpath.vcm, self.shared(subpath.vc, subpath.depth), chosen * last, before, self.h)
        return radiance, dr.select(subpath.depth == 1, 1, mis_weight(others))

    def light_sample_weight(
        self, scene: Scene, subpath: Subpath, vertex: PathVertex, ds: DirectionSample3f, pdf: Float, back: Float
    ) -> Float:
        """The weight of a light sample, with the densities of both ways at the vertex: s = 1."""
        chosen = scene.lights.choice.probability(Point3f(0), None, ds.emitter_index)
        position, direction = scene.emitter_ptr(ds.emitter_index).pdf_emission(-ds.d, ds.n, ds.uv)
        finite = ds.dist < dr.inf
        falloff = dr.select(finite, dr.rcp(dr.square(ds.dist)), 1)
        met = dr.select(finite, dr.abs(dr.dot(ds.n, ds.d)) * falloff * dr.rcp(position), dr.rcp(direction))
        by_bsdf = dr.select(ds.delta, 0, self.h(pdf * met * dr.rcp(chosen)))
        here = dr.select(finite, direction * falloff, position) * vertex.cos(ds.d)
        by_light = meeting(subpath.vcm, subpath.vc, here, back, self.h)
        return mis_weight(by_bsdf + self.shared(by_light, subpath.depth + 1))

    def connection(
        self, scene: Scene, subpath: Subpath, vertex: PathVertex, v: LightVertex
    ) -> tuple[Point3f, Color3f, Float]:
        """Where the ray from a vertex to the vertex `v` of the light path ends, the light sent back, and its weight."""
        there = v.vertex(scene)
        to_light = v.p - vertex.si.p
        falloff = dr.rcp(dr.squared_norm(to_light))
        d = to_light * dr.sqrt(falloff)
        value, pdf, pdf_back = vertex.evaluate(scene, True, d)
        sent, sent_pdf, sent_back = there.evaluate(scene, False, -d)
        value = subpath.throughput * value * v.flux * sent * falloff
        at_light = pdf * there.cos(d) * falloff
        at_camera = sent_pdf * vertex.cos(d) * falloff
        by_light = meeting(*self.mergeable(scene, v, there, subpath, vertex), at_light, sent_back, self.h)
        by_camera = meeting(subpath.vcm, subpath.vc, at_camera, pdf_back, self.h)
        fits = subpath.depth + v.depth < self.joined
        return there.si.offset_p(-d), dr.select(fits, value, 0), mis_weight(by_light + by_camera)

    def one_connection(
        self, scene: Scene, hit: CameraHit, count: UInt32, sampler: Any, vertices: Any
    ) -> tuple[Color3f, Any, Any]:
        """The weighted light of the connections of a vertex with `count` others, by the ray of one of them.

        It is chosen by the light that it would bring if nothing were between the two vertices, while the light path is
        read once (M. T. Chao, "A general purpose unequal probability sampling plan", 1982): with L_i of all connections
        and the transmittance T_k of the one that was chosen, L_k / max(L_k) T_k sum of max(L_i).
        """

        def connect(
            i: UInt32, chosen: ChosenConnection, sampler: Any, vertices: Any
        ) -> tuple[UInt32, ChosenConnection, Any, Any]:
            to, value, weight = self.connection(scene, hit.subpath, hit.vertex, vertices.read(i))
            light = value * weight
            amount = dr.max(light)
            total = chosen.total + amount
            takes = sampler.next_1d() * total < amount
            color = light * dr.rcp(dr.select(takes, amount, 1))
            chosen = ChosenConnection(
                to=dr.select(takes, to, chosen.to), color=dr.select(takes, color, chosen.color), total=total
            )
            return i + 1, chosen, sampler, vertices

        lanes = dr.width(count)
        _, chosen, sampler, vertices = while_loop(
            (dr.zeros(UInt32, lanes), dr.zeros(ChosenConnection, lanes), sampler, vertices),
            lambda i, chosen, sampler, vertices: i < count,
            connect,
            label="connections",
        )
        light = chosen.color * chosen.total
        way = hit.vertex.ray_to(chosen.to)
        return transmittance(scene, sampler, way, light, to_emitter=False), sampler, vertices

    def merged(
        self, scene: Scene, subpath: Subpath, vertex: PathVertex, sampler: SampleStream, joins: Bool
    ) -> Color3f | None:
        """The light that is found at a vertex of a camera path, where it `joins`, in other ways: none."""
        return None

    def crossed(self, scene: Scene, incoming: Subpath, reached: NextVertex, active: Bool) -> Color3f | None:
        """The light that is found along an edge of a camera path, before the vertex that it has reached: none."""
        return None

    # ---- either way --------------------------------------------------------------------

    def joinable(self, scene: Scene, subpath: Subpath, vertex: PathVertex) -> Subpath:
        """The subpath up to a vertex that can be joined; further ways to join it add to its numbers: here none."""
        return subpath

    def mergeable(
        self,
        scene: Scene,
        light: Subpath | LightVertex,
        vertex: PathVertex,
        camera: Subpath | None,
        before: PathVertex | None,
    ) -> tuple[Float, Float]:
        """The `vcm` and `vc` of a light path at a vertex that is joined to the vertex `before` of a camera path.

        Where both are None, it is joined to the lens. Further ways to join both paths at vertices of the light path
        add to the numbers: here none.
        """
        return light.vcm, light.vc

    def continued(
        self, scene: Scene, subpath: Subpath, vertex: PathVertex, s: Scattering, throughput: Color3f
    ) -> Subpath:
        """The subpath continued from a vertex by the scattering `s`, with the given throughput."""
        return subpath.scattered(vertex, s, throughput, self.h)

    def shared(self, others: Float, edges: UInt32) -> Float:
        """The part of a weight due to further strategies, which longer paths lack."""
        return dr.select(edges <= self.joined, others, 0)

    def onwards(
        self, scene: Scene, sampler: SampleStream, hit: LightHit | CameraHit, s: Scattering, roulette_begins: Bool
    ) -> tuple[Subpath, Bool]:
        """The subpath after a vertex, by the sampled continuation, and where it survives roulette."""
        subpath, vertex = hit.subpath, hit.vertex
        eta = None if subpath.eta is None else subpath.eta * s.sample.eta
        product, zero_weight = scaled(
            subpath.throughput, subpath.zero_weight, s.weight, lambda: vertex.si.bsdf().vanishes() & (s.sample.pdf > 0)
        )
        throughput, survives = roulette(sampler, product, eta, roulette_begins)
        onward = self.continued(scene, replace(subpath, zero_weight=zero_weight), vertex, s, throughput)
        if scene.media.scatter:
            onward = hit.incoming.passing(vertex, vertex.passes(s), onward)
        return onward, survives


register_integrator("bdpt", BidirectionalPath)

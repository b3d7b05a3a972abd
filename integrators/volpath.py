"""The path tracer for scenes with media."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, Ray3f, SurfaceInteraction3f, has_flag
from djpt.core.records.flags import PhaseFunctionContext
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.integrators.base import PathState, Vertex, mis_weight
from djpt.integrators.paths.transmittance import null_transmittance
from djpt.integrators.paths.unidirectional import UnidirectionalPath
from djpt.integrators.termination import roulette
from djpt.jit.kernels import minimum
from djpt.jit.types import Bool, Color3f, Float, Normal3f, UInt32
from djpt.media.flight import Flight, of_channel
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["VolumetricPath", "VolumetricPathState"]

BEYOND = 1 + 1e-5
"""The part of a flight's length that is searched for surfaces."""


@dataclass
class VolumetricPathState(PathState):
    """The state of a path through media."""

    channel: UInt32 | None = None
    """The channel whose extinction samples distances; None if no medium is coloured, or each flight draws its own."""
    scatters: Bool | None = None
    """True where light is scattered at the ray's origin, a point in a medium; None if no path begins like that."""
    flown: Float | None = None
    """Length of the path's last ray up to its end; None unless it is asked for."""

    def throughput_after(self, flight: Flight) -> Color3f:
        """The throughput of the path at the end of a flight."""
        return self.throughput * flight.value * dr.rcp(of_channel(flight.pdf, self.channel))


class VolumetricPath(UnidirectionalPath):
    """Unidirectional path tracing with light sampling, Russian roulette, and scattering in media.

    Between two surfaces light is scattered where the flight that a medium samples ends; there the phase function is
    what the BSDF is on a surface. Paths go straight through null surfaces, without a vertex, and so do shadow rays:
    they are weakened by what lies between.

    Parameters: `max_depth` (edges of the longest path, -1 = unbounded, default -1; null surfaces don't count),
    `rr_depth` (Russian roulette from the edge after it on, default 5), `hide_emitters`.

    Draws, weights and termination are those of Mitsuba's `volpath`, with one exception: the transmittance of shadow
    rays through homogeneous media is computed, where Mitsuba estimates it by random numbers.
    """

    pure = True
    in_any_frame = True

    schedules: tuple[str, ...] = ("flat", "media_machine", "wave")
    follows_media = True
    follows_camera = True
    spectral_mis = False
    """True if each flight draws a channel, and has the density of all together: see `djpt.integrators.volpathmis`."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.rr_depth = props.integer("rr_depth", 5, low=1)

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        scene = scene.replace(all_media=True)
        if scene.media and ray.medium is None:
            ray = ray.replaced(medium=scene.media.number_of(medium))
        return super().sample(scene, sampler, ray, medium, active)

    def start(self, scene: Scene) -> VolumetricPathState:
        plain = super().start(scene)
        plain.covered = Bool(False)
        return VolumetricPathState(**vars(plain))

    def begin(self, scene: Scene, sampler: SampleStream) -> VolumetricPathState:
        state, u = self.start(scene), sampler.next_1d()
        if scene.media.are_coloured and not self.spectral_mis:
            state.channel = UInt32(dr.minimum(u * 3, 2))
        # Mitsuba draws the number of the roulette before a vertex, also before the first.
        sampler.next_1d()
        return state

    def trace(
        self, scene: Scene, state: PathState, ray: Ray3f, sampler: SampleStream | None = None
    ) -> SurfaceInteraction3f:
        assert isinstance(state, VolumetricPathState)
        # What light would reach only beyond the end of its flight needn't be found. In thick media that is most.
        if sampler is not None and ray.medium is not None and state.scatters is None and state.flown is None:
            reach = scene.media.reach(ray, state.channel, state.throughput, sampler)
            # A little longer, whatever rounding does to distances. Without matter the distance may be NaN.
            ray = ray.replaced(maxt=minimum(reach * BEYOND, ray.maxt))
        return super().trace(scene, state, ray)

    def advance(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        assert isinstance(state, VolumetricPathState)
        flight = Flight.none() if ray.medium is None else self.flight(scene, sampler, state, ray, si)
        return self.arrive(scene, sampler, state, ray, si, flight)

    def arrive(
        self,
        scene: Scene,
        sampler: SampleStream,
        state: VolumetricPathState,
        ray: Ray3f,
        si: SurfaceInteraction3f,
        flight: Flight,
    ) -> Vertex:
        """Process the end of a `flight`: in a medium, or at the hit (or miss) `si` of `ray`."""
        assert state.covered is not None
        ctx = BSDFContext()

        # ----------------- Flight to the vertex ---------------
        flown = flight.value * dr.rcp(of_channel(flight.pdf, state.channel))
        samples_emitters = Bool(True) if ray.medium is None else scene.media.sample_emitters(ray.medium)
        inside, surface = flight.scattered, si.is_valid() & ~flight.scattered
        throughput = state.throughput * flown
        at = vertex_of(ray, si, flight)

        # ---------------------- Emission ----------------------
        bsdf = si.bsdf()
        extends = state.depth + 1 < self.longest
        lit = extends & ((inside & samples_emitters) | (surface & has_flag(bsdf.flags(), BSDFFlags.Smooth)))
        of_lights, weighted = scene.lights.sampling, state.bsdf_pdf > 0
        met, light = of_lights.at_vertex(state.reference, ray, at, sampler.next_2d(lit), lit, weighted, inside)
        mis = dr.select(weighted, mis_weight(state.bsdf_pdf, met.pdf), 1)
        emitted = self.shown(state, si, dr.select(inside, 0, throughput * mis * met.radiance))
        if scene.media.emit and self.max_depth != 0:
            emitted = emitted + state.throughput * flight.emitted

        # ------------ Light sampling, and the next direction ---
        ds = light.ds
        # In this order, since Mitsuba's C++ compiler evaluates arguments from the last to the first.
        u2 = sampler.next_2d()
        u1 = sampler.next_1d()
        value, pdf, bs, weight = bsdf.eval_pdf_sample(ctx, si, si.to_local(ds.d), u1, u2, surface)
        wo, eta = si.to_world(bs.wo), bs.eta
        crosses = surface & has_flag(bs.sampled_type, BSDFFlags.Null)
        next_pdf = dr.select(has_flag(bs.sampled_type, BSDFFlags.Delta), 0, bs.pdf)
        if scene.media.scatter and ray.medium is not None:
            phase = scene.media.phases(ray.medium)
            mei = MediumInteraction3f.on(ray, flight.t, at.p)
            of_phase = phase.eval_pdf_sample(PhaseFunctionContext(None), mei, ds.d, u1, u2, inside)
            value, pdf, wo, weight, next_pdf = dr.select(inside, of_phase, (value, pdf, wo, weight, next_pdf))
            next_pdf = dr.select(~inside | samples_emitters, next_pdf, 0)
            eta = dr.select(inside, 1, eta)
        mis = dr.select(ds.delta, 1, dr.rcp(1 + dr.square(pdf * ds.weight)))
        reflected = dr.select(lit, throughput * (value * light.weight * mis), 0)

        # ------------------ Russian roulette ------------------
        depth = dr.select(crosses, state.depth, state.depth + 1)
        eta = None if state.eta is None else state.eta * eta
        flown_weight, matter = flown * weight, scene.media.are_attached()
        onward = state.weighted(
            flown_weight, lambda: dr.select(surface, bsdf.vanishes() & (bs.pdf > 0), inside & matter)
        )
        next_throughput, survives = roulette(sampler, onward.throughput, eta, depth > self.roulette_from)

        # ---------------------- Next vertex -------------------
        shadow_ray, next_ray = scene.shadow_ray(at, ds), at.spawn_ray(wo)
        if ray.medium is not None:
            here = scene.media.along(ray, flight.t, inside)
            for leaving in (shadow_ray, next_ray):
                leaving.medium = dr.select(inside, here, leaving.medium)
        covered = state.covered | inside | (surface & ~crosses)
        sky = not self.hide_emitters and scene.covered_by_sky(si)
        return Vertex(
            emitted=emitted,
            reflected=reflected,
            shadow_ray=shadow_ray,
            weight=flown_weight,
            ray=next_ray,
            state=replace(
                onward,
                p=dr.select(crosses, state.p, at.p),
                throughput=next_throughput,
                bsdf_pdf=dr.select(crosses, state.bsdf_pdf, next_pdf),
                eta=eta,
                depth=depth,
                n=None if state.n is None else dr.select(crosses, state.n, at.n),
                covered=covered,
                scatters=None if state.scatters is None else Bool(False),
                flown=None if state.flown is None else dr.select(inside, flight.t, at.t),
            ),
            active=(inside | surface) & survives & (depth < self.longest),
            valid=(covered | sky) & Bool(self.max_depth != 0),
            lit=lit & (pdf > 0) & (ds.pdf > 0),
        )

    def flight(
        self, scene: Scene, sampler: SampleStream, state: VolumetricPathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Flight:
        """The flight of light on the way to a surface: up to it, or to a point where a medium scatters."""
        length = dr.select(si.is_valid(), si.t, ray.maxt)
        if state.scatters is not None:
            length = dr.select(state.scatters, 0, length)
        flight = scene.media.fly(ray, length, state.channel, state.throughput, sampler)
        if state.scatters is None:
            return flight
        at_once = Flight(Float(0), Bool(True), Color3f(1), Color3f(1), Color3f(0))
        return dr.select(state.scatters, at_once, flight)

    def shown(self, state: PathState, si: SurfaceInteraction3f, emitted: Color3f) -> Color3f:
        if self.hide_emitters:
            emitted = dr.select(state.depth == 0, 0, emitted)
        return Color3f(0) if self.max_depth == 0 else emitted

    def transmittance(self, scene: Scene, sampler: SampleStream, v: Vertex) -> Color3f:
        lit = v.lit if dr.grad_enabled(v.reflected) else None
        return null_transmittance(scene, sampler, v.shadow_ray, v.reflected, lit)


def vertex_of(ray: Ray3f, si: SurfaceInteraction3f, flight: Flight) -> SurfaceInteraction3f:
    """The surface point, moved to the place in the medium where light is scattered before; the normal is 0 there."""
    inside = flight.scattered
    at: SurfaceInteraction3f = si.replaced(
        p=dr.select(inside, ray(flight.t), si.p), n=dr.select(inside, Normal3f(0), si.n)
    )
    at.found_at(dr.select(inside, flight.t, si.t), inside | si.is_valid())
    return at


register_integrator("volpath", VolumetricPath)

"""The path tracer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from djpt.description.properties import Properties
from djpt.integrators.base import PathIntegrator, PathState, Vertex, mis_weight
from djpt.light_choice import CHOICES
from djpt.minmax import maximum, minimum
from djpt.records import BSDFContext, BSDFFlags, DirectionSample3f, Ray3f, SurfaceInteraction3f, has_flag
from djpt.samplers.base import SampleStream
from djpt.types import Bool, Color3f, Float, Normal3f, Point3f, UInt32

if TYPE_CHECKING:
    from djpt.scene import Scene

__all__ = ["Path"]

UNBOUNDED = 0xFFFFFFFF


class Path(PathIntegrator):
    """Unidirectional path tracing with light sampling and Russian roulette.

    Estimates L = sum over vertices k of T_k (w_b Le_k + w_e f Le / p_e V), T_k the product of
    f abs(cos) / p of the sampled directions, with the power heuristic weighting BSDF sampling
    (w_b) against light sampling (w_e).

    Parameters: `max_depth` (edges of the longest path, -1 = unbounded, default -1; 1 shows only
    lights, 0 nothing), `rr_depth` (Russian roulette starts there, default 5), `hide_emitters`,
    `emitter_choice` (`uniform`, default: as Mitsuba, by `sampling_weight`; `power`: by the emitters' power;
    `tree`: by power, distance and orientation, for many lights).

    J. Kajiya 1986; E. Veach and L. Guibas 1995. Draws, weights and termination are those of
    Mitsuba's `path`, number by number.
    """

    default_max_depth = -1
    covers_sky = True
    """Does an environment count as covered (alpha 1)?"""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", self.default_max_depth, low=-1)
        self.rr_depth = props.integer("rr_depth", 5, low=1)
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=CHOICES)

    @property
    def longest_path(self) -> int:
        return self.max_depth

    def start(self, scene: Scene) -> PathState:
        return PathState(
            p=Point3f(0),
            throughput=Color3f(1),
            bsdf_pdf=Float(0),
            eta=Float(1) if scene.refracts else None,
            depth=UInt32(0),
            n=Normal3f(0) if scene.emitter_choice.looks_at_normal else None,
            covered=Bool(False) if scene.has_null else None,
            body=scene.camera_body if scene.interior.exists else None,
        )

    def vertex(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        max_depth = UNBOUNDED if self.max_depth < 0 else self.max_depth
        first = state.depth == 0
        throughput, arriving, interior = state.throughput, Color3f(1), scene.interior
        if state.body is not None:
            arriving = interior.transmittance(scene.lookup, state.body, si.t)
            throughput = throughput * arriving

        # ---------------------- Emission ----------------------
        ds = DirectionSample3f.between(state.p, ray, si)
        emitter_pdf = scene.pdf_emitter_direction(state.p, ds, n=state.n)
        mis = dr.select(state.bsdf_pdf > 0, mis_weight(state.bsdf_pdf, emitter_pdf), 1)
        emitted = throughput * mis * si.emitter(scene).eval(si)
        if self.hide_emitters:
            # Openings don't bring the sky back.
            straight = first if state.covered is None else ~state.covered
            emitted = dr.select(straight & ~si.is_valid(), 0, emitted)
        if self.max_depth == 0:
            emitted = Color3f(0)
        # Is there an edge left to reach one more vertex?
        proceed = si.is_valid() & (state.depth + 1 < max_depth)

        # ------------------- Light sampling -------------------
        ds, light = scene.sample_emitter_direction(si, sampler.next_2d(), test_visibility=False)
        shadow_ray = scene.shadow_ray(si, ds)

        # -------------------- BSDF sampling -------------------
        to_light = si.to_local(ds.d)
        value, pdf, bs, weight = si.bsdf().eval_pdf_sample(
            BSDFContext(), si, to_light, sampler.next_1d(), sampler.next_2d(), proceed
        )
        body = state.body
        if body is not None:
            light *= interior.transmittance(scene.lookup, interior.beyond(si, to_light, body), ds.dist)
            body = interior.beyond(si, bs.wo, body)
        # The power heuristic from 1 / p_e: one division less.
        mis = dr.select(ds.delta, 1, dr.rcp(1 + dr.square(pdf * ds.weight)))
        reflected = dr.select(proceed, throughput * (value * light * mis), 0)
        next_ray = si.spawn_ray(si.to_world(bs.wo))
        weight = weight * arriving
        throughput = state.throughput * dr.detach(weight)
        eta = None if state.eta is None else state.eta * bs.eta

        # ------------------ Russian roulette ------------------
        largest = maximum(maximum(throughput.x, throughput.y), throughput.z)
        survival = minimum(largest if eta is None else largest * dr.square(eta), Float(0.95))
        roulette = self.roulette_depth(state.depth) >= self.rr_depth
        survives = ~roulette | (sampler.next_1d() < survival)
        throughput = dr.select(roulette, throughput * dr.rcp(survival), throughput)

        # ---------------------- Next vertex -------------------
        delta = has_flag(bs.sampled_type, BSDFFlags.Delta)
        covered = self.covered(state, si, has_flag(bs.sampled_type, BSDFFlags.Null))
        next_state = PathState(
            p=si.p,
            throughput=throughput,
            bsdf_pdf=dr.select(delta, 0, bs.pdf),
            eta=eta,
            depth=state.depth + 1,
            n=None if state.n is None else si.n,
            covered=None if state.covered is None else covered,
            body=body,
        )
        sky = self.covers_sky and scene.environment() is not None and not self.hide_emitters
        return Vertex(
            emitted=emitted,
            reflected=reflected,
            shadow_ray=shadow_ray,
            weight=weight,
            ray=next_ray,
            state=next_state,
            active=proceed & (largest > 0) & survives,
            valid=(covered | sky) & Bool(self.max_depth != 0),
        )

    def covered(self, state: PathState, si: SurfaceInteraction3f, passes: Bool) -> Bool:
        """Has the path met a surface that it didn't merely pass straight through, this vertex included?"""
        if state.covered is None:
            return (state.depth > 0) | si.is_valid()
        return state.covered | (si.is_valid() & ~passes)

    def roulette_depth(self, depth: UInt32) -> UInt32:
        """The depth that is compared with `rr_depth`: that of the next vertex."""
        return depth + 1

"""The path tracer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from djpt.core.records import BSDFContext, Ray3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.emitters.light_samplers import LIGHT_SAMPLERS
from djpt.integrators.base import PathState, Vertex, mis_weight
from djpt.integrators.paths.unidirectional import UnidirectionalPath
from djpt.integrators.termination import first_roulette, roulette
from djpt.jit.types import Bool, UInt32
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Path"]


class Path(UnidirectionalPath):
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

    pure = True
    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.rr_depth = first_roulette(props, self.max_depth)
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=LIGHT_SAMPLERS)

    def vertex(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        proceed = self.proceeds(state, si)
        weighted = state.bsdf_pdf > 0
        sampled = proceed if scene.bsdfs.reflect_lights else Bool(False)
        met, light = scene.lights.sampling.at_vertex(state.reference, ray, si, sampler.next_2d(), sampled, weighted)

        # ---------------------- Emission ----------------------
        mis = dr.select(weighted, mis_weight(state.bsdf_pdf, met.pdf), 1)
        emitted = self.shown(state, si, state.throughput * mis * met.radiance)

        # ------------------- Light sampling -------------------
        ds = light.ds
        shadow_ray = scene.shadow_ray(si, ds)
        to_light = si.to_local(ds.d)

        # -------------------- BSDF sampling -------------------
        bsdf = si.bsdf()
        value, pdf, bs, weight = bsdf.eval_pdf_sample(
            BSDFContext(), si, to_light, sampler.next_1d(), sampler.next_2d(), proceed
        )
        # The power heuristic from 1 / p_e: one division less.
        mis = dr.select(ds.delta, 1, dr.rcp(1 + dr.square(pdf * ds.weight)))
        reflected = dr.select(sampled, state.throughput * (value * light.weight * mis), 0)

        # ------------------ Russian roulette ------------------
        eta = None if state.eta is None else state.eta * bs.eta
        begins = self.roulette_depth(state.depth) >= self.roulette_from
        onward = state.weighted(weight, lambda: bsdf.vanishes() & (bs.pdf > 0))
        throughput, survives = roulette(sampler, onward.throughput, eta, begins)

        # ---------------------- Next vertex -------------------
        return Vertex(
            emitted=emitted,
            reflected=reflected,
            shadow_ray=shadow_ray,
            weight=weight,
            ray=si.spawn_ray(si.to_world(bs.wo)),
            state=self.next_state(scene, onward, si, bs, throughput),
            active=proceed & survives,
            valid=self.counts(scene, state, si, bs),
            lit=sampled & (pdf > 0) & (ds.pdf > 0),
        )

    def roulette_depth(self, depth: UInt32) -> UInt32:
        """The depth that is compared with `rr_depth`: that of the next vertex."""
        return depth + 1


register_integrator("path", Path)

"""Path tracing as courses teach it: direct light by sampling the lights, indirect light by sampling the surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from djpt.core.records import BSDFContext, Ray3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.emitters.light_samplers import LIGHT_SAMPLERS
from djpt.integrators.base import PathState, Vertex
from djpt.integrators.paths.unidirectional import UnidirectionalPath
from djpt.jit.types import Float
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["PathNEE"]


class PathNEE(UnidirectionalPath):
    """Next event estimation: one light is sampled at every vertex.

    Estimates L = Le_0 + sum over vertices k of T_k f Le V / p_e, T_k the product of f abs(cos) / (p q), where q is the
    constant chance of surviving a vertex. Every kind of path is counted once, without weights: light that a path
    runs into counts only as seen by the camera, directly or by mirrors, because light sampling has counted it before.

    Assumes that lights are sampled well: close to a light, or on shiny surfaces that show one, noise is high.

    Parameters: `russian_roulette` (the chance q in (0, 1], default 0.8), `max_depth` (see `Path`, default -1),
    `hide_emitters`, `emitter_choice` (see `Path`).

    The recursive form with a fixed q is that of many courses, such as L. Yan's GAMES101 (2020); the idea of next event
    estimation is older than graphics: R. Coveyou, V. Cain and K. Yost, "Adjoint and Importance in Monte Carlo
    Application", 1967.
    """

    pure = True
    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.russian_roulette = props.float("russian_roulette", 0.8, low=0.0, high=1.0, low_open=True)
        if self.russian_roulette == 1 and self.max_depth < 0:
            raise props.error(
                "russian_roulette", "must be less than 1 if 'max_depth' is unbounded: paths would never end"
            )
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=LIGHT_SAMPLERS)

    def vertex(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        # ---------------------- Emission ----------------------
        seen = state.bsdf_pdf == 0
        emitted = self.shown(state, si, dr.select(seen, state.throughput * si.emitter().eval(si), 0))
        proceed = self.proceeds(state, si)

        # ------------------- Light sampling -------------------
        ds, light = scene.sample_emitter_direction(si, sampler.next_2d(), test_visibility=False)

        # -------------------- BSDF sampling -------------------
        bsdf = si.bsdf()
        value, pdf, bs, weight = bsdf.eval_pdf_sample(
            BSDFContext(), si, si.to_local(ds.d), sampler.next_1d(), sampler.next_2d(), proceed
        )
        reflected = dr.select(proceed, state.throughput * value * light, 0)

        # ------------------ Russian roulette ------------------
        survives = sampler.next_1d() < self.russian_roulette
        onward = state.weighted(weight, lambda: bsdf.vanishes() & (bs.pdf > 0))
        throughput = onward.throughput * Float(1 / self.russian_roulette)

        # ---------------------- Next vertex -------------------
        return Vertex(
            emitted=emitted,
            reflected=reflected,
            shadow_ray=scene.shadow_ray(si, ds),
            weight=weight,
            ray=si.spawn_ray(si.to_world(bs.wo)),
            state=self.next_state(scene, onward, si, bs, throughput),
            active=proceed & survives & (dr.max(throughput) > 0),
            valid=self.counts(scene, state, si, bs),
            lit=proceed & (pdf > 0) & (ds.pdf > 0),
        )


register_integrator("path_nee", PathNEE)

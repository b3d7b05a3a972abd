"""Path tracing as in a first lecture: paths go in random directions until they hit a light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, Ray3f, SurfaceInteraction3f, has_flag
from djpt.core.warp import (
    square_to_cosine_hemisphere,
    square_to_cosine_hemisphere_pdf,
    square_to_uniform_hemisphere,
    square_to_uniform_hemisphere_pdf,
)
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.integrators.base import PathState, Vertex
from djpt.integrators.paths.unidirectional import UnidirectionalPath
from djpt.integrators.termination import first_roulette, roulette
from djpt.jit.types import Bool, Color3f, Float, UInt32, Vector3f
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["PathNaive"]

SMOOTH_TRANSMISSION = BSDFFlags.DiffuseTransmission | BSDFFlags.GlossyTransmission


class PathNaive(UnidirectionalPath):
    """Light found by chance: no light sampling, and directions that know nothing of the material.

    Estimates L = sum over vertices k of T_k Le_k, T_k the product of f abs(cos) / p, where p is uniform, 1 / (2 pi),
    or cosine-weighted, cos / pi, over the hemisphere that the path arrived from.

    Mirrors and smooth glass can't be found that way and are followed; at a surface that has other lobes as well, a
    coin decides. Another coin chooses the side where light passes through in all directions (rough glass).

    Leaves out point, spot and directional lights: no path meets them.

    Parameters: `hemisphere` (`uniform` or `cosine`, default `cosine`), `max_depth` (see `Path`, default -1),
    `rr_depth` (Russian roulette starts there, default 5), `hide_emitters`.

    J. Kajiya, "The Rendering Equation", SIGGRAPH 1986.
    """

    pure = True
    in_any_frame = True

    samples_lights = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.hemisphere = props.string("hemisphere", "cosine", choices=("uniform", "cosine"))
        self.rr_depth = first_roulette(props, self.max_depth)

    def vertex(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        # ---------------------- Emission ----------------------
        emitted = self.shown(state, si, state.throughput * si.emitter().eval(si))
        proceed = self.proceeds(state, si)

        # ---------------- Hemisphere sampling -----------------
        bsdf = si.bsdf()
        flags = bsdf.flags()
        wo, pdf = self.direction(si, sampler, has_flag(flags, SMOOTH_TRANSMISSION))
        value, _, bs, mirrored = bsdf.eval_pdf_sample(
            BSDFContext(), si, wo, sampler.next_1d(), sampler.next_2d(), proceed
        )
        smooth, mirrors = has_flag(flags, BSDFFlags.Smooth), has_flag(flags, BSDFFlags.Delta)
        both = smooth & mirrors
        follows = mirrors & (~smooth | (sampler.next_1d() < 0.5))
        scattered = value * dr.select(pdf > 0, dr.rcp(pdf), 0)
        # Where mirrors are followed, samples of the other lobes count nothing.
        mirrored = dr.select(has_flag(bs.sampled_type, BSDFFlags.Delta), mirrored, 0)
        weight = dr.select(follows, mirrored, scattered) * dr.select(both, Float(2), 1)
        chosen = BSDFSample3f(
            wo=dr.select(follows, bs.wo, wo),
            pdf=dr.select(follows, bs.pdf, pdf),
            # Known for mirrored directions only; roulette stays unbiased with any number.
            eta=dr.select(follows, bs.eta, 1),
            sampled_type=dr.select(follows, bs.sampled_type, UInt32(int(BSDFFlags.DiffuseReflection))),
            sampled_component=bs.sampled_component,
        )

        # ------------------ Russian roulette ------------------
        eta = None if state.eta is None else state.eta * chosen.eta
        begins = state.depth + 1 >= self.roulette_from
        onward = state.weighted(weight, lambda: bsdf.vanishes() & (chosen.pdf > 0))
        throughput, survives = roulette(sampler, onward.throughput, eta, begins)

        # ---------------------- Next vertex -------------------
        return Vertex(
            emitted=emitted,
            reflected=Color3f(0),
            shadow_ray=si.spawn_ray(ray.d),
            weight=weight,
            ray=si.spawn_ray(si.to_world(chosen.wo)),
            state=self.next_state(scene, onward, si, chosen, throughput),
            active=proceed & survives,
            valid=self.counts(scene, state, si, chosen),
        )

    def direction(self, si: SurfaceInteraction3f, sampler: SampleStream, passes: Bool) -> tuple[Vector3f, Float]:
        """A local direction on the side of `wi` or, where light `passes`, on either side; and its density."""
        sample = sampler.next_2d()
        if self.hemisphere == "uniform":
            wo = square_to_uniform_hemisphere(sample)
            pdf = square_to_uniform_hemisphere_pdf(wo)
        else:
            wo = square_to_cosine_hemisphere(sample)
            pdf = square_to_cosine_hemisphere_pdf(wo)
        beyond = passes & (sampler.next_1d() < 0.5)
        wo.z = dr.select((si.wi.z < 0) ^ beyond, -wo.z, wo.z)
        return wo, dr.select(passes, 0.5 * pdf, pdf)


register_integrator("path_naive", PathNaive)

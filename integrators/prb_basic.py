"""Path replay backpropagation in its plainest form."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from djpt.core.records import BSDFContext, Ray3f, SurfaceInteraction3f
from djpt.description.registry import register_integrator
from djpt.integrators.base import PathState, Vertex
from djpt.integrators.paths.unidirectional import UnidirectionalPath
from djpt.jit.types import Bool, Color3f
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["PRBBasic"]


class PRBBasic(UnidirectionalPath):
    """BSDF sampling alone: no light sampling, no weights, no Russian roulette.

    Estimates L = sum over vertices k of T_k Le_k, T_k the product of f abs(cos) / p of the sampled directions. Its
    gradients come from path replay, like those of `prb`: this is the version to read first.

    Leaves out point, spot and directional lights: no path meets them.

    Parameters: `max_depth` (see `Path`, default 6), `hide_emitters`. Draws are those of Mitsuba's `prb_basic`.

    D. Vicini, S. Speierer and W. Jakob, "Path Replay Backpropagation", SIGGRAPH 2021.
    """

    pure = True
    in_any_frame = True

    default_max_depth = 6
    covers_sky = False
    samples_lights = False

    def vertex(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        # ---------------------- Emission ----------------------
        emitted = self.shown(state, si, state.throughput * si.emitter().eval(si))
        proceed = self.proceeds(state, si)

        # -------------------- BSDF sampling -------------------
        # All of the weight's derivative is in `eval`: ask for both at once.
        bsdf = si.bsdf()
        _, _, bs, weight = bsdf.eval_pdf_sample(BSDFContext(), si, si.wi, sampler.next_1d(), sampler.next_2d(), proceed)
        onward = state.weighted(weight, lambda: bsdf.vanishes() & (bs.pdf > 0))

        # ---------------------- Next vertex -------------------
        return Vertex(
            emitted=emitted,
            reflected=Color3f(0),
            shadow_ray=si.spawn_ray(ray.d),
            weight=weight,
            ray=si.spawn_ray(si.to_world(bs.wo)),
            state=self.next_state(scene, onward, si, bs, onward.throughput),
            active=proceed & (dr.max(onward.throughput) > 0),
            valid=self.counts(scene, state, si, bs),
        )

    def covered(self, state: PathState, si: SurfaceInteraction3f, passes: Bool) -> Bool:
        """Openings count as surfaces here."""
        return (state.depth > 0) | si.is_valid()


register_integrator("prb_basic", PRBBasic)

"""Path tracing by a guide that has learned where light comes from."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import BSDFContext, BSDFFlags, Ray3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.emitters.light_samplers import LIGHT_SAMPLERS
from djpt.integrators.base import PathState, mis_weight
from djpt.integrators.guiding.guide import SIDE, SQUARES, Cells, Guide, Leaves
from djpt.integrators.guiding.training import GuidedVertex, LearningIntegrator, TrainingPaths, train
from djpt.integrators.paths.unidirectional import UnidirectionalPath
from djpt.integrators.termination import first_roulette, roulette
from djpt.jit.kernels import minimum
from djpt.jit.types import Color3f, Float
from djpt.materials.base import BSDF
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["GuidedPath"]

FIRST = 2**15
"""The paths of the first pass of training; later ones have twice as many as the one before."""

TRAINING_PATHS = 2**13, 2**20
"""The least and the most training paths."""

VISITS = 2000
"""The visits in a leaf before it is divided."""

DOUBT = 300
"""The visits after which a guide is followed half as often as one that is certain."""

BLUR = 0.2
"""The fraction of a square's weight given to either neighbour, along rows and then along columns."""


@dataclass
class GuidedState(PathState):
    """The state of a guided path."""

    reach: Float = field(default_factory=lambda: Float(1))
    """The largest throughput, if the BSDF alone had chosen all directions: for Russian roulette, since directions that
    matter are chosen often and have low weights."""


class GuidedPath(UnidirectionalPath, LearningIntegrator):
    """`path` with directions that are drawn from what earlier paths have learned.

    Passes of training, each with twice as many paths as the one before, are guided by what those before them have
    found; the image comes after them, from paths of its own. Before a path leaves a surface, chance decides whether it
    follows the guide of the place or the BSDF, and the direction counts with the density of both together:

        p = share p_guide + (1 - share) p_BSDF,

    at mirrors and smooth glass p_BSDF alone. Light samples are weighted against p as in `path`. A guide is a histogram
    over the sphere for each leaf of a tree over the scene: see `djpt.integrators.guiding`.

    Strong where most light comes from few directions that neither light samples nor the material know: through a
    narrow gap, from a bright spot on a wall. Elsewhere `path` is faster, a sample of which costs half as much.

    Parameters: `max_depth` (edges of the longest path, -1 = unbounded, default -1), `rr_depth` (Russian roulette starts
    there, default 5), `hide_emitters`, `emitter_choice` (as for `path`), `share` (the chance to follow a guide that has
    seen much, default 0.5), `practice` (paths to learn from, as a fraction of the image's samples, default 0.125; at
    least 2^13, at most 2^20), `bounces`.

    T. Müller, M. Gross and J. Novák, "Practical path guiding for efficient light-transport simulation", 2017, for the
    passes and the tree; A. Rath and others, "Variance-aware path guiding", 2020, for what is learned; the histogram
    over regular squares goes back to H. Jensen, "Importance driven path tracing using the photon map", 1995.
    """

    pure = True
    schedules: tuple[str, ...] = ("learning",)
    in_any_frame = True
    follows_overlaps = False

    guide: Guide
    """The distribution that was learned; there is none before."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.rr_depth = first_roulette(props, self.max_depth)
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=LIGHT_SAMPLERS)
        self.share = props.float("share", 0.5, low=0.0, high=0.95)
        self.practice = props.float("practice", 0.125, low=0.0, high=16.0)
        self._trained_schedules: tuple[str, ...] = ("wave",) if self.bounces else UnidirectionalPath.schedules
        self.schedules, self.differentiable = GuidedPath.schedules, False

    def prepare_scene(self, scene: Scene) -> None:
        super().prepare_scene(scene)
        scene.lights.brightness  # noqa: B018

    # ---- training ----------------------------------------------------------------------

    def trained(self, training_paths: TrainingPaths) -> GuidedPath:
        scene = training_paths.scene
        cells = Cells(*scene.bbox())
        leaves = Leaves.equal(cells, 6)
        guide = Guide(cells, leaves, np.zeros((leaves.count, SQUARES)), np.zeros(leaves.count))
        unit = scene.lights.brightness**2
        least, most = TRAINING_PATHS
        count = int(min(max(self.practice * training_paths.samples, least), most))
        for begin, end in passes(count):
            training_paths.pause()
            sampler, ray = training_paths.begin(begin, end)
            guided = self.following(guide)
            result = train(guided, scene, sampler, ray, guide.leaves.count, cells.count, unit)
            unit = result.mean or unit
            share = self.share * confidence(guide.leaves, result.visits)
            known = Guide(cells, guide.leaves, blurred(np.sqrt(result.sums)), share)
            guide = known if end == count else divided(known, result.visits)
        return self.following(guide)

    def following(self, guide: Guide) -> GuidedPath:
        """This integrator with a guide."""
        follower = copy.copy(self)
        follower.guide, follower.schedules = guide, self._trained_schedules
        return follower

    # ---- paths -------------------------------------------------------------------------

    def start(self, scene: Scene) -> GuidedState:
        return GuidedState(**vars(super().start(scene)))

    def vertex(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> GuidedVertex:
        assert isinstance(state, GuidedState)
        proceed = self.proceeds(state, si)
        weighted = state.bsdf_pdf > 0
        met, light = scene.lights.sampling.at_vertex(state.reference, ray, si, sampler.next_2d(), proceed, weighted)

        # ---------------------- Emission ----------------------
        mis = dr.select(weighted, mis_weight(state.bsdf_pdf, met.pdf), 1)
        emitted = self.shown(state, si, state.throughput * mis * met.radiance)

        # ----------------------- Guide ------------------------
        bsdf = si.bsdf()
        guided = proceed & has_flag(bsdf.flags(), BSDFFlags.Smooth)
        guide = self.guide.at(si.p, dr.mulsign(si.n, -dr.dot(si.n, ray.d)), guided)
        share = guide.share
        u, place = sampler.next_1d(), sampler.next_2d()
        follows = u < share
        # What the decision leaves of `u` is a uniform number again.
        u = dr.select(follows, u * dr.rcp(share), (u - share) * dr.rcp(1 - share))
        suggested = guide.sample(u, place, follows)

        # ------------ Light sampling, BSDF sampling -----------
        ds = light.ds
        to_light, to_suggested = si.to_local(ds.d), si.to_local(suggested)

        def method(bsdf: BSDF) -> tuple[Any, ...]:
            context = BSDFContext()
            result = bsdf.eval_pdf_sample(context, si, to_light, u, place, proceed)
            return *result, *bsdf.eval_pdf(context, si, to_suggested, proceed)

        value, pdf, bs, weight, suggested_value, suggested_pdf = bsdf.visit(method, proceed)
        pdf = dr.fma(share, guide.heading(ds.d, share > 0).pdf - pdf, pdf)
        mis = dr.select(ds.delta, 1, dr.rcp(1 + dr.square(pdf * ds.weight)))
        reflected = dr.select(proceed, state.throughput * (value * light.weight * mis), 0)

        # ------------------- Next direction -------------------
        delta = ~follows & has_flag(bs.sampled_type, BSDFFlags.Delta)
        d = dr.select(follows, suggested, si.to_world(bs.wo))
        heading = guide.heading(d, share > 0)
        value = dr.select(follows, suggested_value, weight * bs.pdf)
        pdf = dr.select(follows, suggested_pdf, bs.pdf)
        alone = dr.select(follows, minimum(dr.max(value) * dr.rcp(pdf), 1.0), dr.max(weight))
        pdf = dr.fma(share, heading.pdf - pdf, pdf)
        by_both = dr.select(pdf > 0, value * dr.rcp(pdf), 0)
        weight = dr.select(delta, weight * dr.rcp(1 - share), by_both)
        bs.sampled_type = dr.select(follows, int(BSDFFlags.GlossyReflection), bs.sampled_type)
        bs.eta = dr.select(follows, 1, bs.eta)
        bs.pdf = dr.select(delta, bs.pdf, pdf)

        # ------------------ Russian roulette ------------------
        eta = None if state.eta is None else state.eta * bs.eta
        reach = state.reach * alone
        left, survives = roulette(sampler, Color3f(reach), eta, state.depth + 1 >= self.roulette_from)
        throughput = state.throughput * weight * dr.select(reach > 0, left.x * dr.rcp(reach), 0)
        onward = self.next_state(scene, state, si, bs, throughput)
        assert isinstance(onward, GuidedState)
        onward.reach = left.x

        # ---------------------- Next vertex -------------------
        return GuidedVertex(
            emitted=emitted,
            reflected=reflected,
            shadow_ray=scene.shadow_ray(si, ds),
            weight=weight,
            ray=si.spawn_ray(d),
            state=onward,
            active=proceed & survives & (dr.max(throughput) > 0),
            valid=self.counts(scene, state, si, bs),
            cell=guide.cell,
            square=heading.square,
            density=dr.select(delta, 0, pdf * heading.spread),
        )


def passes(count: int) -> Iterator[tuple[int, int]]:
    """The passes (begin, end) of training with `count` paths: a first one, then each as long as all before it."""
    begin, end = 0, FIRST
    while begin < count:
        # What would be left for a last pass of less than half of the usual length is joined to this one.
        end = count if 3 * end > 2 * count else end
        yield begin, end
        begin, end = end, 2 * end


def confidence(leaves: Leaves, visits: NDArray[np.uint32]) -> NDArray[np.float64]:
    """The reliability of each leaf's guide, from 0 to 1: the result of few visits is mostly chance."""
    of_leaf = np.bincount(leaves.of_cell, visits, leaves.count)
    result: NDArray[np.float64] = of_leaf / (of_leaf + DOUBT)
    return result


def divided(guide: Guide, visits: NDArray[np.uint32]) -> Guide:
    """A guide with smaller leaves where there were many visits; they begin with what is known of the larger ones."""
    leaves = Leaves.by_visits(guide.cells, visits, VISITS)
    parent = np.zeros(leaves.count, np.intp)
    parent[leaves.of_cell] = guide.leaves.of_cell
    return Guide(guide.cells, leaves, guide.weights[parent], guide.share[parent])


def blurred(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights (leaves, SQUARES), of which each square has given a fraction to its neighbours on the map."""
    maps = weights.reshape(-1, SIDE, SIDE)
    for axis in (1, 2):
        padded = np.pad(maps, [(0, 0), *((1, 1) if axis == a else (0, 0) for a in (1, 2))], mode="edge")
        before, after = (np.take(padded, range(first, first + SIDE), axis) for first in (0, 2))
        maps = (1 - 2 * BLUR) * maps + BLUR * (before + after)
    return maps.reshape(weights.shape)


register_integrator("guided", GuidedPath)

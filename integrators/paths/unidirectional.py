"""The base of all path tracers from the camera: what a vertex shows, and the way to the next one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import BSDFFlags, BSDFSample3f, Ray3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.integrators.base import PathIntegrator, PathState, trace_path
from djpt.integrators.termination import Terminating
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point3f, UInt32
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["MonteCarloIntegrator", "UnidirectionalPath"]

MAX_BOUNCES = 32
"""The largest number of images by bounces that one render gives."""


class UnidirectionalPath(Terminating, PathIntegrator):
    """Walks from the camera, one BSDF sample per vertex; subclasses say what a vertex contributes.

    Parameters: `max_depth` (edges of the longest path, -1 = unbounded, that is 2^16, default -1; 1 shows
    only lights, 0 nothing), `hide_emitters`, `bounces` (default false).

    With `bounces` there is one image more for each term of the Neumann series L = E + K E + K^2 E + ..: light that was
    scattered k times, in the channels `bounce<k>.R` and so on, k = 0 .. max_depth - 1. Their sum is the image.
    """

    follows_overlaps = True
    default_max_depth = -1
    covers_sky = True
    """True if an environment counts as covered (alpha 1)."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", self.default_max_depth, low=-1)
        self.bounces = props.boolean("bounces", False)
        if self.bounces and not 0 < self.max_depth <= MAX_BOUNCES:
            raise props.error("bounces", f"needs a 'max_depth' from 1 to {MAX_BOUNCES}, found {self.max_depth}")
        # Only `wave` has a sum for each bounce, and path replay has none.
        self.differentiable = not self.bounces
        if self.bounces:
            self.schedules = ("wave",)

    def aov_names(self) -> Sequence[str]:
        return [f"bounce{k}.{c}" for k in range(self.max_depth) for c in "RGB"] if self.bounces else []

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        if not self.bounces:
            return super().sample(scene, sampler, ray, medium, active)
        parts, valid = trace_path(self, scene, sampler, ray, active, bounces=self.max_depth)
        color = parts[0]
        for part in parts[1:]:
            color = color + part
        return color, valid, [component for part in parts for component in (part.x, part.y, part.z)]

    @property
    def longest_path(self) -> int:
        return self.max_depth

    def start(self, scene: Scene) -> PathState:
        return PathState(
            p=Point3f(0),
            throughput=Color3f(1),
            bsdf_pdf=Float(0),
            eta=Float(1) if scene.bsdfs.refract else None,
            depth=UInt32(0),
            n=Normal3f(0) if scene.lights.choice.uses_normal else None,
            covered=Bool(False) if scene.bsdfs.have_null else None,
        )

    # ---- pieces of a vertex ------------------------------------------------------------

    def shown(self, state: PathState, si: SurfaceInteraction3f, emitted: Color3f) -> Color3f:
        """The light of a vertex, without what `hide_emitters` and `max_depth` 0 take away."""
        if self.hide_emitters:
            # Openings don't bring the sky back.
            straight = state.depth == 0 if state.covered is None else ~state.covered
            emitted = dr.select(straight & ~si.is_valid(), 0, emitted)
        return Color3f(0) if self.max_depth == 0 else emitted

    def proceeds(self, state: PathState, si: SurfaceInteraction3f) -> Bool:
        """True where there is a surface, and an edge left to reach one more vertex."""
        return si.is_valid() & (state.depth + 1 < self.longest)

    def next_state(
        self, scene: Scene, state: PathState, si: SurfaceInteraction3f, bs: BSDFSample3f, throughput: Color3f
    ) -> PathState:
        """The state of a path that leaves `si` by the BSDF sample `bs`."""
        passes = has_flag(bs.sampled_type, BSDFFlags.Null)
        return replace(
            state,
            p=si.p,
            throughput=throughput,
            bsdf_pdf=dr.select(has_flag(bs.sampled_type, BSDFFlags.Delta), 0, bs.pdf),
            eta=None if state.eta is None else state.eta * bs.eta,
            depth=state.depth + 1,
            n=None if state.n is None else si.n,
            covered=None if state.covered is None else self.covered(state, si, passes),
        )

    def covered(self, state: PathState, si: SurfaceInteraction3f, passes: Bool) -> Bool:
        """True where the path has hit, here or before, a surface other than null interfaces."""
        if state.covered is None:
            return (state.depth > 0) | si.is_valid()
        return state.covered | (si.is_valid() & ~passes)

    def counts(self, scene: Scene, state: PathState, si: SurfaceInteraction3f, bs: BSDFSample3f) -> Bool:
        """True where the sample counts as covered, if the path ends here."""
        sky = self.covers_sky and not self.hide_emitters and scene.covered_by_sky(si)
        covered = self.covered(state, si, has_flag(bs.sampled_type, BSDFFlags.Null))
        return (covered | sky) & Bool(self.max_depth != 0)


MonteCarloIntegrator = UnidirectionalPath
"""Mitsuba's name."""

"""Volumetric path tracing whose paths end where a cache knows the light of the medium."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import drjit as dr

from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.integrators.guiding.light_cache import LightCache, LightCells, ScatteringVertex, learned
from djpt.integrators.guiding.training import LearningIntegrator, TrainingPaths
from djpt.integrators.volpath import VolumetricPathState
from djpt.integrators.volpathmis import VolumetricPathMIS
from djpt.jit.types import UInt32, Vector3f
from djpt.media.flight import Flight
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["CachedVolumetricPath"]

TRAINING_PATHS = 2**13, 2**20
"""The least and the most training paths."""


@dataclass
class CachedState(VolumetricPathState):
    """The state of a path that a cache may end."""

    stay: UInt32 = field(default_factory=lambda: UInt32(0))
    """How often light was scattered in the medium since the path entered it."""


class CachedVolumetricPath(VolumetricPathMIS, LearningIntegrator):
    """`volpathmis` for dense, bright bodies such as milk, wax and skin, with paths that end in a cache of light.

    Light is scattered hundreds of times in such a body, and comes out far from where it went in: following each path
    to its end takes most of the time, and brings most of the noise. Here some training paths are followed to their
    ends and leave in the cells of a grid the mean of the light that is scattered there. Paths of the image end at
    scattering number `after` in a body, and take the cell's light in place of what they would have found:

        L = T_1 S_1 + .. + T_(after - 1) S_(after - 1) + b S_cell,

    with the throughput b. The image is an approximation. S_cell is the mean over a cell, about a free path wide; over
    directions, which matters where the phase function isn't `isotropic` (see `asymmetry` of the
    medium); over lengths, so `max_depth` should be too large to be felt; and, if something moves, over time. The larger
    `after`, the less of that is seen. The noise of the cache, which neighbouring pixels share, decreases like that of
    the image.

    Only media that are the `interior` of a shape have cells, and only if it is at most 32 free paths wide: see
    `djpt.integrators.guiding.light_cache.LightCells`. All other light, that of surfaces included, is as in
    `volpathmis`. There are no derivatives.

    Parameters: those of `volpathmis` but `bounces`; `after` (default 2, at least 1), `practice` (training paths, as
    a fraction of the image's samples, default 0.125; at least 2^13, at most 2^20).

    G. Ward, F. Rubinstein and R. Clear, "A Ray Tracing Solution for Diffuse Interreflection", 1988; W. Jarosz,
    C. Donner, M. Zwicker and H. W. Jensen, "Radiance Caching for Participating Media", 2008.
    """

    pure = True
    schedules: tuple[str, ...] = ("learning",)
    follows_camera = False
    in_any_frame = True

    cells: LightCells
    opaque_after: UInt32
    """`after`, 1-wide: one kernel is that of all values."""
    cache: LightCache | None = None
    """The light that was learned; None in training, and if no medium has cells."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if self.bounces:
            raise props.error("bounces", "can't be told apart in a cache; possible: 'volpathmis'")
        self.after = props.integer("after", 2, low=1)
        self.practice = props.float("practice", 0.125, low=0.0, high=16.0)
        self.schedules, self.differentiable = CachedVolumetricPath.schedules, False

    def prepare_scene(self, scene: Scene) -> None:
        super().prepare_scene(scene)
        scene.lights.brightness  # noqa: B018

    # ---- training ----------------------------------------------------------------------

    def trained(self, training_paths: TrainingPaths) -> CachedVolumetricPath:
        scene = training_paths.scene
        trained = copy.copy(self)
        trained.schedules, trained.cells = VolumetricPathMIS.schedules, LightCells(scene)
        trained.opaque_after = dr.opaque(UInt32, self.after)
        if not trained.cells.any:
            return trained
        least, most = TRAINING_PATHS
        sampler, ray = training_paths.begin(0, int(min(max(self.practice * training_paths.samples, least), most)))
        trained.cache = learned(trained, scene, trained.cells, sampler, ray, scene.lights.brightness or 1.0)
        return trained

    # ---- paths -------------------------------------------------------------------------

    def start(self, scene: Scene) -> CachedState:
        return CachedState(**vars(super().start(scene)))

    def arrive(
        self,
        scene: Scene,
        sampler: SampleStream,
        state: VolumetricPathState,
        ray: Ray3f,
        si: SurfaceInteraction3f,
        flight: Flight,
    ) -> ScatteringVertex:
        assert isinstance(state, CachedState)
        v = super().arrive(scene, sampler, state, ray, si, flight)
        medium = UInt32(scene.media.vacuum) if ray.medium is None else scene.media.filling(ray.medium)
        onward = medium if v.ray.medium is None else scene.media.filling(v.ray.medium)
        stay = dr.select(flight.scattered, state.stay + 1, state.stay)

        # ---------------- A cell, and its light ---------------
        p = ray(flight.t)
        throughput = state.throughput_after(flight)
        cell, in_cell = self.cells.at(medium, p, Vector3f(0), flight.scattered)
        found = ScatteringVertex(**vars(v), cell=cell, in_cell=in_cell, throughput=throughput)
        assert isinstance(v.state, CachedState)
        found.state = replace(v.state, stay=dr.select(onward == medium, stay, 0))
        if self.cache is None:
            return found
        ends = in_cell & (stay >= self.opaque_after)
        offset = sampler.next_2d(ends)
        light, known = self.cache.scattered(medium, p, Vector3f(offset.x, offset.y, sampler.next_1d(ends)), ends)
        found.emitted = dr.select(known, v.emitted + throughput * light, v.emitted)
        found.reflected = dr.select(known, 0, v.reflected)
        found.active = v.active & ~known
        return found


register_integrator("volpathcache", CachedVolumetricPath)

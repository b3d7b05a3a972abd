"""The progressive schedule: passes over the whole image, with state that is carried from one to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.integrators.paths.passes import LightPath, PassIntegrator
from djpt.jit.types import Bool, Point2f, TensorXf
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.light_walk import walk_light
from djpt.rendering.schedules.passes import Pace, ends_here, one_ahead, report
from djpt.rendering.schedules.reconstruction import picture
from djpt.rendering.schedules.wave import Wave
from djpt.samplers import SampleStream

__all__ = ["Progressive"]

PASS_PATHS = 2**24
"""The number of paths of one pass: about a second on two cores."""


class Progressive(Schedule):
    """Runs a `PassIntegrator` pass by pass, and adds the image of its `from_camera`."""

    name = "progressive"
    in_bands = False

    def image(self, job: Job) -> TensorXf:
        integrator, walks = job.integrator, JobWalks(job)
        assert isinstance(integrator, PassIntegrator)
        width, height = job.film.crop_size()
        state = integrator.begin(walks)
        for begin, end in one_ahead(Pace(job, max(1, PASS_PATHS // (width * height))).passes(width * height)):
            state = integrator.add_pass(walks, state, begin, end)
            report(job, end * width * height)
            if ends_here(job):
                walks.spp = end
                break
        channels = job.channels(integrator.color(walks, state), Bool(False), [])
        dr.eval(channels)
        image = picture(channels, width, height)
        if integrator.from_camera is None:
            return image
        spp = job.sampler.round_count(walks.spp)
        seen = replace(job, integrator=integrator.from_camera, spp=spp, progress=None, interruption=None)
        return Wave().image(seen) + image


class JobWalks:
    """A job as a `PassIntegrator` sees it: see `djpt.integrators.paths.passes.Walks`."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self.scene, self.camera, self.film, self.spp = job.scene, job.camera, job.film, job.spp
        self.seed = job.seed_value

    def ray_at(self, place: Point2f, stream: SampleStream) -> Ray3f:
        """A camera ray through a place in [0, 1)^2 on the crop window, by the next numbers of a stream."""
        return self._job.ray_at(place, stream)

    def light(
        self,
        start: Callable[[SampleStream], LightPath],
        vertex: Callable[[SampleStream, LightPath, SurfaceInteraction3f], tuple[LightPath, Bool]],
        sinks: Any,
        begin: int,
        end: int,
    ) -> None:
        """Follow `begin` <= k < `end` light paths per pixel: see `djpt.rendering.schedules.light_walk.walk_light`."""
        walk_light(self._job, start, vertex, sinks, begin, end)

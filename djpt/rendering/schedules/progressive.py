"""The progressive schedule: passes over the whole image, with state that is carried from one to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from djpt.core.records import SurfaceInteraction3f
from djpt.integrators.paths.passes import LightPath, PassIntegrator
from djpt.jit.kernels import while_loop, wide
from djpt.jit.types import Bool, TensorXf, UInt32
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.passes import Pace, ends_here, one_ahead, report
from djpt.rendering.schedules.reconstruction import picture
from djpt.rendering.schedules.wave import Wave
from djpt.samplers import SampleStream

__all__ = ["Lane", "Progressive", "follow", "lanes"]

LANES = 2**16


@dataclass
class Lane:
    """Loop state."""

    path: Any
    sampler: Any
    number: UInt32
    """The number of the path, among all that are followed."""


def lanes(count: int) -> UInt32:
    """The lanes that follow `count` light paths, by the numbers of their first paths: 0, 1, .."""
    return dr.arange(UInt32, min(LANES, count))


def follow(
    numbers: UInt32,
    end: int,
    fresh: Callable[[UInt32], tuple[Any, Any]],
    step: Callable[[Lane], tuple[Any, Bool]],
    sinks: Any,
    label: str,
) -> None:
    """Follow light paths with consecutive numbers, from the first of each of the `lanes` up to `end`, exclusive.

    `fresh` gives a path's random numbers and its state as it leaves a light, any PyTree; `step` traces the next edge,
    and returns the path that goes on and whether it does. Kernels write to `sinks` (any PyTree of Dr.Jit arrays),
    which are evaluated.
    """
    width = dr.width(numbers)
    stop, stride = dr.opaque(UInt32, end), dr.opaque(UInt32, width)
    sampler, path = fresh(numbers)

    def body(lane: Lane) -> tuple[Lane]:
        path, goes_on = step(lane)
        number = dr.select(goes_on, lane.number, lane.number + stride)
        sampler, new = fresh(number)
        return (Lane(dr.select(goes_on, path, new), dr.select(goes_on, lane.sampler, sampler), number),)

    state = Lane(wide(path, width), sampler, numbers)
    (done,) = while_loop((state,), lambda lane: lane.number < stop, body, label=label)
    dr.eval(done.number, sinks)


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
        self.seed, self.ray_at = job.seed_value, job.ray_at

    def light(
        self,
        start: Callable[[SampleStream], LightPath],
        vertex: Callable[[SampleStream, LightPath, SurfaceInteraction3f], tuple[LightPath, Bool]],
        sinks: Any,
        begin: int,
        end: int,
    ) -> None:
        """Follow `begin` <= k < `end` light paths for each pixel of the crop window, see `Walks.light`."""
        job, scene = self._job, self.scene
        width, height = job.film.crop_size()

        def fresh(number: UInt32) -> tuple[SampleStream, LightPath]:
            sampler = job.light_stream(number)
            return sampler, start(sampler)

        def step(lane: Lane) -> tuple[LightPath, Bool]:
            ray = lane.path.ray
            si = scene.surface_interaction(ray, scene.closest_hit(ray), scene.surface_detail)
            arriving = replace(lane.path, flux=lane.path.flux * scene.media.transmittance(ray, si.t))
            return vertex(lane.sampler, arriving, si)

        begin, end = begin * width * height, end * width * height
        follow(lanes(end - begin) + dr.opaque(UInt32, begin), end, fresh, step, sinks, "light")

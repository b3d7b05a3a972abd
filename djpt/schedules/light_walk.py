"""Light walks: a lane follows one light path after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from djpt.integrators.passes import LightPath
from djpt.kernels import while_loop, wide
from djpt.records import SurfaceInteraction3f
from djpt.samplers import SampleStream
from djpt.schedules.job import Job
from djpt.types import Bool, UInt32

__all__ = ["walk_light"]

LANES = 2**16


@dataclass
class Lane:
    """Loop state."""

    path: LightPath
    sampler: Any
    number: UInt32
    """The number of the path, among all paths of the image."""


def walk_light(
    job: Job,
    start: Callable[[SampleStream], LightPath],
    vertex: Callable[[SampleStream, LightPath, SurfaceInteraction3f], tuple[LightPath, Bool]],
    sinks: Any,
    begin: int,
    end: int,
) -> None:
    """Follow `begin` <= k < `end` light paths for each pixel of the crop window.

    `start` gives a path that leaves a light; `vertex` processes a hit (or miss) of its ray, adds what there is to
    add to the `sinks`, and returns the path that goes on and whether it does. Absorption by media is included in the
    flux that arrives at a vertex. Kernels write to `sinks` (any PyTree of Dr.Jit arrays), which are evaluated.
    """
    scene = job.scene
    width, height = job.film.crop_size()
    begin, end = begin * width * height, end * width * height
    lanes = min(LANES, end - begin)
    first, stop, stride = dr.opaque(UInt32, begin), dr.opaque(UInt32, end), dr.opaque(UInt32, lanes)

    def fresh(number: UInt32) -> tuple[SampleStream, LightPath]:
        sampler = job.stream(number // job.spp_value, number % job.spp_value)
        return sampler, start(sampler)

    number = dr.arange(UInt32, lanes) + first
    sampler, path = fresh(number)

    def body(lane: Lane) -> tuple[Lane]:
        ray = lane.path.ray
        si = scene.surface_interaction(ray, scene.closest_hit(ray), full=scene.needs_uv)
        arriving = replace(lane.path, flux=lane.path.flux * scene.transmittance(ray, si.t))
        path, goes_on = vertex(lane.sampler, arriving, si)

        number = dr.select(goes_on, lane.number, lane.number + stride)
        sampler, new = fresh(number)
        return (Lane(dr.select(goes_on, path, new), dr.select(goes_on, lane.sampler, sampler), number),)

    state = Lane(wide(path, lanes), sampler, number)
    (done,) = while_loop((state,), lambda lane: lane.number < stop, body, label="light")
    dr.eval(done.number, sinks)

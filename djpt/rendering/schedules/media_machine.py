"""The machine schedule for scenes with media: a lane is a state machine that tracks one ray after the other.

In smoke a ray meets some collisions, most of which are not real, and how many differs from ray to ray. In loops of
their own, flights and shadow rays wait for the longest of their packet: few lanes are at work. Here a lane makes
tracking steps for whatever ray it has, the next flight of its path or a shadow ray, and when that has come to its end
the lane does what comes next: process a path vertex, send the shadow ray through a null surface, add the light that
arrives, or begin the next sample.

The estimator is that of `VolumetricPath`, and the random numbers of each sample are those of the flat schedule, in the
same order. Searching for surfaces is no step: that is done where a ray begins. docs/performance.md, "Media in the
machine", has the measurements.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import BSDFFlags, PreliminaryIntersection3f, Ray3f, SurfaceInteraction3f, has_flag
from djpt.integrators.base import PathState
from djpt.integrators.paths.transmittance import Aim, null_surfaces
from djpt.integrators.volpath import VolumetricPath, VolumetricPathState
from djpt.jit.kernels import if_stmt, while_loop, wide
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.media.tracking import Track
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.flat import Flat
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import TiledLanes
from djpt.rendering.schedules.machine import aligned_frame, store
from djpt.rendering.schedules.reconstruction import Summed
from djpt.rendering.schedules.sinks import Write, sample_buffers
from djpt.scene.media_placement import Trackers

__all__ = ["MediaMachine"]

STEPS = 4
"""Tracking steps between two vertices of a lane."""


class MediaMachine(Flat):
    """Lanes are state machines, each with a ray that it tracks at its own pace.

    Derivatives are those of the flat schedule, which follows the same paths.
    """

    name = "machine"

    def rows(self, job: Job) -> Iterator[Summed]:
        return Schedule.rows(self, job)

    def samples(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        buffers, write = sample_buffers(job, band, end - begin)
        finished = Walk(job, TiledLanes(job, band, begin, end), write).run()
        dr.eval(finished, buffers)
        return buffers


@dataclass
class Hit:
    """The end of a ray."""

    t: Float
    face: UInt32
    near: Any


@dataclass
class Lane:
    """Loop state."""

    ray: Ray3f
    """The ray that is being tracked."""
    hit: Hit
    track: Track
    """The progress along that ray; its random numbers are those of the lane."""
    end: Float
    """The distance at which the track ends."""
    shadow: Bool
    """True where the ray is a shadow ray."""
    aim: Aim
    """The light of the shadow ray."""
    pending: Color3f
    """The light that arrives if nothing takes any from now on."""
    next_ray: Ray3f
    """The ray on which the path continues after the shadow ray."""
    active: Bool
    """True where the path continues."""
    valid: Bool
    """True where the sample counts as covered, if the path doesn't go on."""
    path: Any
    """A `VolumetricPathState`."""
    radiance: Color3f
    entry: UInt32
    """The number of the lane's sample in its packet's list: see `TiledLanes`."""
    frame: Any
    """Memory that keeps the kernel's stack aligned: see `aligned_frame`."""


class Walk:
    """The walks of all lanes through their samples."""

    def __init__(self, job: Job, lanes: TiledLanes, write: Write) -> None:
        integrator = job.integrator.path_tracer
        assert isinstance(integrator, VolumetricPath)
        self._job, self._lanes, self._write = job, lanes, write
        self._scene, self._integrator, self._derived = job.scene, integrator, job.integrator.sample_channels
        self._trackers = Trackers(job.scene.media)
        self._surfaces = null_surfaces(job.scene)

    def run(self) -> UInt32:
        """Advance all lanes until their samples are written; returns a number to evaluate."""
        lanes = self._lanes
        (end,) = while_loop((self._start(),), lambda lane: lanes.left(lane.entry), self._turn, label="media machine")
        return end.entry + end.frame.read(end.entry & 1)

    def _start(self) -> Lane:
        job, lanes, width = self._job, self._lanes, self._lanes.count
        first = lanes.at(lanes.first)
        sampler, ray, _ = job.begin(first.pixel, first.k, first.x, first.y)
        path = self._integrator.begin(self._scene, sampler)
        hit = self._closest(ray, path, Bool(False))
        track, end = self._trackers.begun(ray, length_of(ray, hit), sampler, first.left)
        return Lane(
            ray=wide(ray, width),
            hit=wide(hit, width),
            track=wide(track, width),
            end=wide(end, width),
            shadow=dr.full(Bool, False, width),
            aim=wide(Aim.of(ray), width),
            pending=dr.zeros(Color3f, width),
            next_ray=wide(ray, width),
            active=dr.full(Bool, True, width),
            valid=dr.full(Bool, False, width),
            path=wide(path, width),
            radiance=dr.zeros(Color3f, width),
            entry=wide(lanes.first, width),
            frame=aligned_frame(width),
        )

    def _turn(self, lane: Lane) -> tuple[Lane]:
        """Make some tracking steps, and process the rays that have ended."""
        if self._scene.media:
            (track,) = if_stmt(
                (lane.track,), lane.track.active, lambda track: (self._tracked(lane, track),), lambda track: (track,)
            )
            lane.track = track
        (lane,) = if_stmt((lane,), ~lane.track.active, lambda lane: (self._advance(lane),), lambda lane: (lane,))
        return (lane,)

    def _tracked(self, lane: Lane, track: Track) -> Track:
        ray, length = lane.ray, length_of(lane.ray, lane.hit)
        return self._trackers.advance(track, ray, length, lane.end, lane.shadow, lane.path.throughput, STEPS)

    def _advance(self, lane: Lane) -> Lane:
        """Process the end of a ray: a vertex, a null surface, or the light of a shadow ray; then begin the next ray."""
        scene, integrator, job, lanes = self._scene, self._integrator, self._job, self._lanes
        shadow, ray, path = lane.shadow, lane.ray, lane.path
        stream = lane.track.stream.clone()
        length = length_of(ray, lane.hit)
        si = scene.surface_interaction(ray, self._found(lane.hit), scene.surface_detail)

        # ----------------- A vertex of the path ---------------
        assert isinstance(path, VolumetricPathState)
        flight = self._trackers.landing(ray, length, path.channel, path.throughput, lane.track, stream, ~shadow)
        v = integrator.arrive(scene, stream, path, ray, unless(shadow, si), flight)
        lit = ~shadow & (dr.max(v.reflected) > 0)

        # ------------ A null surface on the way to a light ----
        left = dr.select(shadow, lane.pending * self._trackers.left(ray, length, lane.track), 0)
        crosses = si.is_valid() & (dr.max(left) > 0)
        beyond = si.spawn_ray(ray.d)
        pending = dr.select(crosses, left * si.bsdf().eval_null_transmission(si, crosses), left)
        aim = dr.select(shadow, lane.aim, Aim.of(v.shadow_ray))
        crosses &= aim.lies_ahead(beyond, ray.d)

        # ----------------- The shadow ray ---------------------
        leaves = dr.select(crosses, beyond, v.shadow_ray)
        way = aim.ray_from(leaves.o, leaves.medium)
        way.times = ray.times
        if self._surfaces.are_apart:
            lit &= ~self._surfaces.blocked(way, lit)
        pending, on = dr.select(lit, v.reflected, pending), lit | crosses
        ahead = None
        if self._surfaces.are_apart:
            ahead = self._surfaces.closest(way)
            # Where no surface and no steps are ahead, the light is known.
            arrives = on & ~ahead.is_valid() & ~self._trackers.tracked(way.medium)
            at_once = self._trackers.left(way, way.maxt, lane.track)
            pending, on = dr.select(arrives, pending * at_once, pending), on & ~arrives
        known = lit | shadow
        radiance = lane.radiance + dr.select(shadow, 0, v.emitted) + dr.select(known & ~on, pending, 0)

        # ----------------- The next sample --------------------
        active, valid = dr.select(shadow, lane.active, v.active), dr.select(shadow, lane.valid, v.valid)
        next_ray = dr.select(shadow, lane.next_ray, v.ray)
        state = dr.select(shadow, path, v.state)
        ended = ~on & ~active
        here = lanes.at(lane.entry)
        channels = job.channels(radiance, valid, self._derived(radiance, valid))
        store(self._write, here.slot, channels, ended & here.exists)
        entry = lanes.next(lane.entry, ended)
        sample = lanes.at(entry)
        fresh, camera_ray, _ = job.begin(sample.pixel, sample.k, sample.x, sample.y)
        begun = integrator.begin(scene, fresh)

        # ----------------- The next ray -----------------------
        sampler = dr.select(ended, fresh, dr.select(shadow, lane.track.stream, stream))
        path = state.restarted(ended, begun)
        new_ray = dr.select(on, way, dr.select(ended, camera_ray, next_ray))
        hit = self._closest(new_ray, path, on)
        stopped = Bool(False)
        if ahead is not None:
            hit.t, hit.face = dr.select(on, ahead.t, hit.t), dr.select(on, ahead.face, hit.face)
        else:
            opaque = ~has_flag(scene.bsdfs.at(hit.face).flags(), BSDFFlags.Null)
            stopped = on & (hit.t < dr.inf) & opaque
            pending = dr.select(stopped, 0, pending)
        track, end = self._trackers.begun(new_ray, length_of(new_ray, hit), sampler, sample.left & ~stopped)
        return Lane(
            ray=new_ray,
            hit=hit,
            track=track,
            end=end,
            shadow=on,
            aim=aim,
            pending=pending,
            next_ray=next_ray,
            active=active,
            valid=valid,
            path=path,
            radiance=dr.select(ended, 0, radiance),
            entry=entry,
            frame=lane.frame,
        )

    def _closest(self, ray: Ray3f, path: PathState, shadow: Bool) -> Hit:
        """The end of a ray."""
        pi = self._scene.closest_hit(ray, through_lights=self._integrator.path_passes_lights(path, shadow))
        return Hit(pi.t, pi.face, pi.near)

    def _found(self, hit: Hit) -> PreliminaryIntersection3f:
        return PreliminaryIntersection3f.found(hit.t, hit.face, self._scene.geometry.shape_of(hit.face), hit.near)


def length_of(ray: Ray3f, hit: Hit) -> Float:
    """The length of a ray up to its hit, or to its end."""
    length: Float = dr.select(hit.t < dr.inf, hit.t, ray.maxt)
    return length


def unless(missed: Bool, si: SurfaceInteraction3f) -> SurfaceInteraction3f:
    """A surface point that isn't there where `missed`: packets without any skip the code of the BSDFs."""
    here: SurfaceInteraction3f = si.replaced()
    here.found_at(dr.select(missed, dr.inf, si.t), si.is_valid() & ~missed)
    return here

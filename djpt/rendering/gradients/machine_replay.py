"""Path replay in the machine schedule.

As in `djpt.rendering.gradients.replay` every sample is walked twice. The first walk notes which of its shadow
rays were free, a bit per vertex. The second traces none: it must know the visibility of a light when it
processes the vertex, not some turns later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.dispatch.ensemble import Detached
from djpt.geometry.query import Query
from djpt.integrators.base import PathIntegrator, PathState
from djpt.jit.kernels import if_stmt, while_loop, wide
from djpt.jit.types import Bool, Color3f, Float, UInt32, UInt64
from djpt.rendering.gradients.leaves import Numbering
from djpt.rendering.gradients.modes import Mode
from djpt.rendering.gradients.zero_weights import begun, blank, collected
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.lanes import TiledLanes
from djpt.scene.scene import Scene

__all__ = ["run"]

NOTED = 64
"""The number of vertices with a bit, a power of two; beyond them the second walk traces shadow rays again."""


@dataclass
class Lane:
    """Loop state; see `djpt.rendering.schedules.machine` and `djpt.rendering.gradients.replay`."""

    query: Query
    medium: UInt32 | None
    shadow: Bool
    pending: Color3f
    pending_behind: Color3f | None
    """The part of the pending light that is `behind`, without the factor set aside."""
    next_ray: Ray3f
    active: Bool
    sampler: Any
    path: PathState
    free: UInt64
    """Bit i: set if the shadow ray of vertex i was free."""
    radiance: Color3f
    behind: Color3f | None
    """See `djpt.rendering.gradients.zero_weights`."""
    again: Bool
    entry: UInt32
    slot: UInt32
    delta: Color3f
    sums: list[Float]


def run(job: Job, values: Detached, numbering: Numbering, lanes: TiledLanes, mode: Mode) -> tuple[list[Float], UInt32]:
    """Walk all samples twice; returns the sums, and a number to evaluate if there are none."""
    integrator, scene, width = job.integrator, job.scene, lanes.count
    assert isinstance(integrator, PathIntegrator)
    geometry = scene.geometry
    first = lanes.at(lanes.first)
    sampler, ray, _ = job.begin(first.pixel, first.k, first.x, first.y)
    _, attached = mode.view(scene, values, numbering)
    path, usable = begun(integrator.start(scene), attached), first.left
    start = Lane(
        query=wide(geometry.begin(ray, usable, through_lights=integrator.passes_lights(path)), width),
        medium=wide(ray.medium, width),
        shadow=dr.full(Bool, False, width),
        pending=dr.zeros(Color3f, width),
        pending_behind=blank(attached, width),
        next_ray=wide(Ray3f(medium=ray.medium), width),
        active=dr.full(Bool, True, width),
        sampler=sampler,
        path=wide(path, width),
        free=dr.zeros(UInt64, width),
        radiance=dr.zeros(Color3f, width),
        behind=blank(attached, width),
        again=dr.full(Bool, False, width),
        entry=wide(lanes.first, width),
        slot=wide(first.slot, width),
        delta=wide(mode.delta_of(first.slot, usable & first.exists), width),
        sums=mode.start(),
    )

    def advance(lane: Lane) -> Lane:
        shadow = lane.shadow
        ray, hit = geometry.end(lane.query)
        ray.medium = lane.medium
        stream = lane.sampler.clone()
        leaves, view = mode.view(scene, values, numbering)
        si = scene.surface_interaction(ray, hit, scene.surface_detail)
        si.scene = view
        with dr.resume_grad():
            v = integrator.advance(view, stream, lane.path, ray, si)
            reflected = v.reflected * view.media.transmittance(v.shadow_ray)
            visible = lane.again & known_free(scene, integrator, lane, v.shadow_ray)
            shines = dr.max(dr.detach(reflected)) > 0
            if v.lit is not None and dr.grad_enabled(reflected):
                shines |= v.lit
            light = dr.select(visible, reflected, 0)
        vertex_ray, vertex_state = dr.detach(v.ray), dr.detach(v.state)
        radiance, behind, delta, sums = mode.visit(lane, leaves, v, light, lane.again & ~shadow)

        # A shadow ray has ended: its vertex was processed before, and `path.depth` counts it already.
        arrived = shadow & ~hit.is_valid()
        lane.radiance = dr.select(shadow, lane.radiance + dr.select(arrived, lane.pending, 0), radiance)
        if lane.behind is not None and lane.pending_behind is not None:
            late = lane.behind + dr.select(arrived, lane.pending_behind, 0)
            lane.behind = dr.select(shadow, late, behind)
        lane.delta, lane.sums = delta, sums
        free = lane.free | dr.select(arrived, bit(lane.path.depth - 1), 0)

        reflected = dr.detach(reflected)
        pending, pending_behind = collected(lane.path.zero_weight, blank(attached, 1), reflected)
        lit = ~shadow & ~lane.again & shines
        active = dr.select(shadow, lane.active, v.active)
        next_ray = dr.select(shadow, lane.next_ray, vertex_ray)
        state = dr.select(shadow, lane.path, vertex_state)
        ended = ~lit & ~active
        finished = ended & lane.again

        entry, here = lanes.next(lane.entry, finished), lanes.at(lane.entry)
        sample = lanes.at(entry)
        more = finished & sample.left & sample.exists
        delta, sums = mode.hand_over(job, lane, finished, sample.slot, more, here.exists)
        fresh, camera_ray, _ = job.begin(sample.pixel, sample.k, sample.x, sample.y)
        path = state.restarted(ended, begun(integrator.start(scene), attached))
        new_ray = dr.select(lit, v.shadow_ray, dr.select(ended, camera_ray, next_ray))
        return Lane(
            query=geometry.begin(new_ray, sample.left, lit, integrator.path_passes_lights(path, lit)),
            medium=new_ray.medium,
            shadow=lit,
            pending=pending,
            pending_behind=pending_behind,
            next_ray=next_ray,
            active=active,
            sampler=dr.select(ended, fresh, dr.select(shadow, lane.sampler, stream)),
            path=path,
            free=dr.select(finished, 0, free),
            radiance=dr.select(finished, 0, lane.radiance),
            behind=None if lane.behind is None else dr.select(finished, 0, lane.behind),
            again=lane.again ^ ended,
            entry=entry,
            slot=dr.select(finished, sample.slot, lane.slot),
            delta=delta,
            sums=sums,
        )

    def turn(lane: Lane) -> tuple[Lane]:
        through = integrator.path_passes_lights(lane.path, lane.shadow)
        lane.query.cursor = geometry.turn(lane.query, lane.shadow, through)
        ended = lane.query.cursor.ended
        (lane,) = if_stmt((lane,), ended, lambda lane: (advance(lane),), lambda lane: (lane,))
        return (lane,)

    (end,) = while_loop((start,), lambda lane: lanes.left(lane.entry), turn, label=mode.label + ", machine")
    return end.sums, end.entry


def bit(depth: UInt32) -> UInt64:
    """A word in which the bit of a vertex is set; 0 for vertices beyond NOTED."""
    return dr.select(depth < NOTED, UInt64(1) << UInt64(depth & (NOTED - 1)), 0)


def known_free(scene: Scene, integrator: PathIntegrator, lane: Lane, shadow_ray: Ray3f) -> Bool:
    """True where the shadow ray of this vertex was free on the first walk."""
    depth = lane.path.depth
    noted = (lane.free & bit(depth)) != 0
    if 0 <= integrator.longest_path <= NOTED:
        return noted
    beyond = lane.again & ~lane.shadow & (depth >= NOTED)
    return if_stmt(
        (noted, shadow_ray), beyond, lambda noted, ray: ~scene.geometry.blocked(ray), lambda noted, ray: noted
    )

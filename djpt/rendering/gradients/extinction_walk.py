"""Path replay through media whose extinction is tracked: a third walk finds what more matter would scatter.

The second walk of `djpt.rendering.gradients.replay` differentiates what a path has met. That isn't all where the
extinction has derivatives: more matter scatters more light, also where there is none, and no path has a vertex there.
So the second walk takes one point of its whole way at which light might be scattered, in proportion to what would come
from there to the camera by what the walk knows (`djpt.media.differentials`). The third walk, the extinction walk,
begins at this point: with its radiance S the derivative of the sample is S weight d(sigma_t).

As in `djpt.rendering.gradients.replay`, first walks have a loop of their own if long code differentiates vertices.

M. Nimier-David, T. Mueller, A. Keller and W. Jakob, "Unbiased Inverse Volume Rendering with Differential Trackers",
SIGGRAPH 2022.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.core.records.interactions import MediumInteraction3f
from djpt.dispatch.ensemble import Detached
from djpt.errors import RenderError
from djpt.integrators.base import PathIntegrator, PathState
from djpt.integrators.volpath import VolumetricPathState
from djpt.jit.kernels import wide
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.gradients.leaves import Numbering
from djpt.rendering.gradients.modes import Mode
from djpt.rendering.gradients.replay import MOST, first_walks
from djpt.rendering.gradients.zero_weights import begun, blank
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.lanes import Lanes
from djpt.rendering.schedules.unmasked_loop import run_free
from djpt.samplers.base import SampleStream
from djpt.scene.scene import Scene

__all__ = [
    "ExtinctionWalk",
    "attached_extinction",
    "needed",
    "next_extinction_walk",
    "no_extinction_walk",
    "observed",
    "run",
    "scattered",
    "turned_off",
]

FIRST, AGAIN, EXTINCTION = 0, 1, 2
"""The walks of a sample."""

TAKEN = 0.3
"""The fraction of samples with an extinction walk: beginning in the medium, it takes longer than a camera path.

The fraction of least variance times time lies between 0.2 and 1, depending on how dense a cloud is."""


def needed(scene: Scene, numbering: Numbering) -> bool:
    """Whether the extinction of a tracked medium of the scene has derivatives."""
    wanted = scene.media.of_extinction()
    return any(id(owner) in wanted for leaf in numbering.leaves for owner in leaf.owners)


def attached_extinction(scene: Scene) -> bool:
    """Whether the extinction of a tracked medium has derivatives as the scene reads its values."""
    wanted = scene.media.of_extinction()
    leaves = (leaf for ensemble in scene.media.ensembles for leaf in ensemble.leaves())
    return any(scene.lookup.attaches(leaf) and any(id(o) in wanted for o in leaf.owners) for leaf in leaves)


@dataclass
class ExtinctionWalk:
    """The beginning of a third walk: loop state."""

    ray: Ray3f
    """The ray that comes to the point, from which it begins."""
    path: Any
    """The state of the path on that ray."""
    shade: Color3f
    """What comes from the point to the camera, over its largest component; the albedo is included."""
    total: Float
    """The sum of the largest components for all points that might have been taken."""


def no_extinction_walk(ray: Ray3f, path: VolumetricPathState) -> ExtinctionWalk:
    """The extinction walk of a path that has met no medium yet."""
    return ExtinctionWalk(Ray3f(ray), replace(path), Color3f(0), Float(0))


def next_extinction_walk(
    scene: Scene,
    known: ExtinctionWalk,
    path: VolumetricPathState,
    ray: Ray3f,
    flown: Float,
    length: Float,
    active: Bool,
) -> ExtinctionWalk:
    """The extinction walk of a path after a segment: from there, or the one that is `known`."""
    point, weight = scene.media.scattering_point(ray, flown, length, active)
    # A factor that is set aside, see `djpt.rendering.gradients.zero_weights`, belongs to what comes to the camera, too.
    assert path.zero_weight is not None
    weight = dr.select(active, path.throughput * path.zero_weight * weight, 0)
    mass = dr.max(weight)
    total = known.total + mass
    takes = (mass > 0) & (point.choice * total < mass)
    onward = ray.replaced(o=ray(point.t))
    return ExtinctionWalk(
        ray=dr.select(takes, onward, known.ray),
        path=dr.select(takes, path, known.path),
        shade=dr.select(takes, weight * dr.rcp(mass), known.shade),
        total=total,
    )


def observed(path: PathState) -> VolumetricPathState:
    """The state of a path that begins, and of which extinction walks need to know how far it gets."""
    assert isinstance(path, VolumetricPathState)
    return replace(path, scatters=Bool(False), flown=Float(0))


def turned_off(extinction_walk: ExtinctionWalk) -> VolumetricPathState:
    """The state of a path at the beginning of an extinction walk."""
    return replace(extinction_walk.path, throughput=Color3f(1), zero_weight=Color3f(1), scatters=Bool(True))


@dataclass
class Lane:
    """Loop state."""

    ray: Ray3f
    sampler: SampleStream
    path: Any
    radiance: Color3f
    """First and third walk: radiance so far. Second walk: radiance still to come."""
    behind: Color3f | None
    """See `djpt.rendering.gradients.zero_weights`."""
    walk: UInt32
    """`FIRST`, `AGAIN` or `EXTINCTION`."""
    extinction_walk: ExtinctionWalk
    k: UInt32
    slot: UInt32
    delta: Color3f
    """Reverse mode: derivative of the loss with respect to the sample. Forward mode: derivative of the sample."""
    sums: list[Float]

    @property
    def again(self) -> Bool:
        """True on the second walk."""
        return self.walk == AGAIN


def run(
    job: Job, values: Detached, numbering: Numbering, lanes: Lanes, slots: UInt32, slot_stride: UInt32, mode: Mode
) -> tuple[list[Float], UInt32]:
    """Walk all samples three times; return the sums, and a number to evaluate if there are none."""
    integrator, scene, count = job.integrator, job.scene, dr.width(lanes.pixel)
    assert isinstance(integrator, PathIntegrator)
    if scene.geometry.overlaps:
        raise RenderError(
            "there are no derivatives with respect to an extinction that varies where bodies overlap: shapes of the "
            "scene have a 'priority'"
        )
    x, y = job.coordinates(lanes.pixel)
    _, attached = mode.view(scene, values, numbering)

    def begin(k: UInt32) -> tuple[Any, Ray3f, VolumetricPathState]:
        sampler, ray, _ = job.begin(lanes.pixel, k, x, y)
        return sampler, ray, observed(begun(integrator.begin(scene, sampler), attached))

    sampler, ray, path = begin(lanes.first)
    known = None
    if mode.takes_long and job.samples <= MOST:
        known = first_walks(job, attached, lanes, slots, slot_stride, lambda path: observed(begun(path, attached)))
    radiance, behind = (dr.zeros(Color3f, count), blank(attached, count)) if known is None else known.at(slots, True)
    first = FIRST if known is None else AGAIN
    start = Lane(
        ray=wide(ray, count),
        sampler=sampler,
        path=wide(path, count),
        radiance=wide(radiance, count),
        behind=None if behind is None else wide(behind, count),
        walk=dr.full(UInt32, first, count),
        extinction_walk=wide(no_extinction_walk(ray, path), count),
        k=wide(lanes.first, count),
        slot=wide(slots, count),
        delta=wide(mode.delta_of(slots, Bool(True)), count),
        sums=mode.start(),
    )

    def body(lane: Lane) -> Lane:
        leaves, view = mode.view(scene, values, numbering)
        si = integrator.trace(scene, lane.path, lane.ray)
        si.scene = view
        with dr.resume_grad():
            v = integrator.advance(view, lane.sampler, lane.path, lane.ray, si)
            arrived = integrator.transmittance(view, lane.sampler, v)
        assert isinstance(v.state, VolumetricPathState)
        assert v.state.flown is not None
        ended, runs = ~v.active, lane.k < lanes.end
        second, third = runs & lane.again, runs & (lane.walk == EXTINCTION)
        radiance, behind, outgoing = mode.outgoing(lane, v, arrived)
        with dr.resume_grad():
            light = scattered(view, lane.extinction_walk, radiance * (1 / TAKEN), third & ended)
            outgoing = dr.select(second, outgoing, 0) + dr.select(third & ended, light, 0)
            lane.delta, lane.sums = mode.differentiate(lane, leaves, outgoing, second | (third & ended))

        length = dr.select(si.is_valid(), si.t, lane.ray.maxt)
        extinction_walk = next_extinction_walk(
            scene, lane.extinction_walk, lane.path, lane.ray, v.state.flown, length, second
        )
        # First walks don't draw a number here.
        onward = lane.sampler.clone()
        turns = second & ended & (extinction_walk.total > 0) & (onward.next_1d() < TAKEN)
        finished = ended & ((second & ~turns) | third)
        k = dr.select(finished, lane.k + lanes.stride, lane.k)
        next_slot = dr.select(finished, lane.slot + slot_stride, lane.slot)
        more = finished & (k < lanes.end)
        delta, sums = mode.hand_over(job, lane, finished, next_slot, more)
        found, there = (Color3f(0), Color3f(0)) if known is None else known.at(next_slot, more)
        fresh, camera_ray, restart = begin(k)
        after = dr.select(turns, extinction_walk.ray, dr.select(ended, camera_ray, dr.detach(v.ray)))
        walk = dr.select(finished, UInt32(first), dr.select(ended, lane.walk + 1, lane.walk))
        extinction_walk.total = dr.select(ended & ~turns, 0, extinction_walk.total)
        return Lane(
            ray=after,
            sampler=dr.select(turns, onward, dr.select(ended, fresh, lane.sampler)),
            path=dr.select(turns, turned_off(extinction_walk), dr.select(ended, restart, dr.detach(v.state))),
            radiance=dr.select(finished, found, dr.select(turns, 0, radiance)),
            behind=None if behind is None else dr.select(finished, there, dr.select(turns, 0, behind)),
            walk=walk,
            extinction_walk=extinction_walk,
            k=k,
            slot=next_slot,
            delta=delta,
            sums=sums,
        )

    end = run_free(start, lambda lane: lane.k < lanes.end, body, count, mode.label)
    return end.sums, end.k


def scattered(scene: Scene, extinction_walk: ExtinctionWalk, radiance: Color3f, active: Bool) -> Color3f:
    """The light scattered to the camera where an extinction walk begins, given the radiance that the walk found."""
    ray = extinction_walk.ray
    assert ray.medium is not None
    mei = MediumInteraction3f.on(ray, Float(0))
    sigma_t = scene.media.extinction(ray.medium, mei, active)
    return sigma_t * (extinction_walk.shade * (extinction_walk.total * radiance))

"""Path replay in the flat schedule: gradients with the memory of a picture, not of its paths.

Every lane computes each of its samples twice with the same random numbers. The first walk
gives the sample's radiance L. The second subtracts each vertex' contribution, so that at a
vertex L holds what is still to come through it, and differentiates

    Lo = emitted + reflected + L weight / detach(weight),

the only expression that depends on the parameters there (D. Vicini, S. Speierer and W. Jakob,
"Path Replay Backpropagation", SIGGRAPH 2021). Reverse mode adds delta . dLo to the parameters,
delta being the derivative of the loss by the sample; forward mode adds dLo to the sample's
derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.dispatch.ensemble import Detached
from djpt.gradients import machine_replay
from djpt.gradients.leaves import Accumulator, Numbering, Parameter, Tangents
from djpt.gradients.modes import Forward, Mode, Reverse
from djpt.integrators.base import PathIntegrator, PathState
from djpt.kernels import wide
from djpt.records import Ray3f
from djpt.schedules.flat import restart
from djpt.schedules.job import Band, Job
from djpt.schedules.lanes import Lanes, TiledLanes, interleaved, layered
from djpt.schedules.sinks import blank_sums, sample_buffers
from djpt.types import Bool, Color3f, Float, UInt32

__all__ = ["backward_constant", "backward_samples", "forward_samples", "forward_sums"]


@dataclass
class Lane:
    """Loop state."""

    ray: Ray3f
    sampler: Any
    path: PathState
    radiance: Color3f
    """First walk: radiance so far. Second walk: radiance still to come."""
    again: Bool
    """Is this the second walk?"""
    k: UInt32
    slot: UInt32
    delta: Color3f
    """Reverse mode: derivative of the loss by the sample. Forward mode: derivative of the sample."""
    sums: list[Float]


def run(
    job: Job, values: Detached, numbering: Numbering, lanes: Lanes, slots: UInt32, slot_stride: UInt32, mode: Mode
) -> tuple[list[Float], UInt32]:
    """Walk all samples twice; returns the sums, and a number to evaluate if there are none.

    The rest of the state is dropped before anything is evaluated, and so never written to memory.
    """
    integrator, scene, count = job.integrator, job.scene, dr.width(lanes.pixel)
    assert isinstance(integrator, PathIntegrator)
    x, y = job.coordinates(lanes.pixel)
    sampler, ray, _ = job.begin(lanes.pixel, lanes.first, x, y)
    start = Lane(
        ray=wide(ray, count),
        sampler=sampler,
        path=wide(integrator.start(scene), count),
        radiance=dr.zeros(Color3f, count),
        again=dr.full(Bool, False, count),
        k=wide(lanes.first, count),
        slot=wide(slots, count),
        delta=wide(mode.delta_of(slots, Bool(True)), count),
        sums=mode.start(),
    )

    def body(lane: Lane) -> tuple[Lane]:
        leaves, view = mode.view(scene, values, numbering)
        si = integrator.trace(scene, lane.path, lane.ray)
        si.scene = view
        with dr.resume_grad():
            v = integrator.vertex(view, lane.sampler, lane.path, lane.ray, si)
        visible = scene.unoccluded(v.shadow_ray)
        lane.radiance, lane.delta, lane.sums = mode.visit(lane, leaves, v, visible, lane.again)

        ended = ~v.active
        finished = ended & lane.again
        k = dr.select(finished, lane.k + lanes.stride, lane.k)
        next_slot = dr.select(finished, lane.slot + slot_stride, lane.slot)
        delta, sums = mode.hand_over(job, lane, finished, next_slot, finished & (k < lanes.end))
        fresh, camera_ray, _ = job.begin(lanes.pixel, k, x, y)
        return (
            Lane(
                ray=dr.select(ended, camera_ray, dr.detach(v.ray)),
                sampler=dr.select(ended, fresh, lane.sampler),
                path=restart(ended, integrator.start(scene), dr.detach(v.state)),
                radiance=dr.select(finished, 0, lane.radiance),
                again=lane.again ^ ended,
                k=k,
                slot=next_slot,
                delta=delta,
                sums=sums,
            ),
        )

    (end,) = dr.while_loop((start,), lambda lane: lane.k < lanes.end, body, label=mode.label)
    return end.sums, end.k


def numbering_of(job: Job, parameters: list[Parameter]) -> Numbering:
    """Where the parameters show up in the values that a vertex looks up."""
    return Numbering(parameters, job.scene.bsdfs.leaves() + job.scene.lights.leaves())


def in_order(lanes: Lanes) -> tuple[Lanes, UInt32, UInt32]:
    """Lanes, where each stores its first sample, and how far apart its samples lie: [sample][lane]."""
    count = dr.width(lanes.pixel)
    # Plus an opaque zero: Dr.Jit turns a gather of all entries in order into a plain load, which
    # would give images of one sample per pixel a kernel of their own.
    return lanes, dr.arange(UInt32, count) + dr.opaque(UInt32, 0), dr.opaque(UInt32, count)


def backward_constant(
    job: Job, values: Detached, parameters: list[Parameter], adjoints: list[Float], begin: int, end: int
) -> list[Any]:
    """Gradients of the parameters where all samples of a pixel have the same adjoint; in the flat schedule."""
    lanes = interleaved(job, Band(0, job.height), begin, end)
    numbering = numbering_of(job, parameters)
    accumulator = Accumulator(parameters, numbering, values, dr.width(lanes.pixel))
    delta = job.color_adjoint([dr.gather(Float, a, lanes.pixel) for a in adjoints])
    sums, k = run(job, values, numbering, *in_order(lanes), Reverse(accumulator, delta, None))
    dr.eval(sums, k)
    return accumulator.gradients(sums)


def backward_samples(
    job: Job,
    values: Detached,
    parameters: list[Parameter],
    adjoints: list[Float],
    band: Band,
    begin: int,
    end: int,
    machine: bool,
) -> list[Any]:
    """Gradients of the parameters from one adjoint per sample of a band, [k - begin][pixel] per channel."""

    def adjoint(slot: UInt32, active: Bool) -> Color3f:
        return job.color_adjoint([dr.gather(Float, a, slot, active) for a in adjoints])

    numbering = numbering_of(job, parameters)
    if machine:
        tiles = TiledLanes(job, band, begin, end)
        accumulator = Accumulator(parameters, numbering, values, tiles.count)
        sums, k = machine_replay.run(job, values, numbering, tiles, Reverse(accumulator, None, adjoint))
    else:
        lanes = layered(job, band, begin, end)
        accumulator = Accumulator(parameters, numbering, values, dr.width(lanes.pixel))
        sums, k = run(job, values, numbering, *in_order(lanes), Reverse(accumulator, None, adjoint))
    dr.eval(sums, k)
    return accumulator.gradients(sums)


def forward_sums(
    job: Job, values: Detached, parameters: list[Parameter], tangents: list[Any], begin: int, end: int, sums: Any
) -> list[Float]:
    """Like `flat.radiance_sums`, of the samples' derivatives."""
    lanes = interleaved(job, Band(0, job.height), begin, end)
    if sums is None:
        sums = blank_sums(dr.width(lanes.pixel), job.channel_count())
    numbering = numbering_of(job, parameters)
    mode = Forward(Tangents(numbering, tangents), None, sums)
    result = run(job, values, numbering, *in_order(lanes), mode)[0]
    dr.eval(result)
    return result


def forward_samples(
    job: Job,
    values: Detached,
    parameters: list[Parameter],
    tangents: list[Any],
    band: Band,
    begin: int,
    end: int,
    machine: bool,
) -> list[Float]:
    """Like `flat.radiance_samples`, of the samples' derivatives."""
    buffers, write = sample_buffers(job, band, end - begin)
    numbering = numbering_of(job, parameters)
    mode = Forward(Tangents(numbering, tangents), write, [])
    if machine:
        finished = machine_replay.run(job, values, numbering, TiledLanes(job, band, begin, end), mode)[1]
    else:
        finished = run(job, values, numbering, *in_order(layered(job, band, begin, end)), mode)[1]
    dr.eval(finished, buffers)
    return buffers

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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.dispatch import Detached
from djpt.integrators.base import PathIntegrator, PathState, wide
from djpt.records import Ray3f
from djpt.replay import Accumulator, Leaves, Numbering, Parameter, Tangents
from djpt.schedules.flat import restart
from djpt.schedules.job import Band, Job
from djpt.schedules.lanes import Lanes, interleaved, layered
from djpt.schedules.sinks import Write, blank_sums, sample_buffers
from djpt.types import Bool, Color3f, Float, UInt32

__all__ = ["backward_constant", "backward_samples", "forward_samples", "forward_sums"]

Adjoint = Callable[[UInt32, Bool], Color3f]
"""Gives the derivative of the loss by the sample stored at a slot, for active lanes."""


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


@dataclass
class Reverse:
    """Reverse mode: sum the parameters' gradients, given the samples' adjoints.

    The adjoints are `delta` for all samples of a lane, or what `adjoint` reads for each.
    """

    accumulator: Accumulator
    delta: Color3f | None
    adjoint: Adjoint | None


@dataclass
class Forward:
    """Forward mode: tangents in, one derivative per sample out, to sums or to ``store``."""

    tangents: Tangents
    store: Write | None
    sums: list[Float]


def run(
    job: Job, values: Detached, numbering: Numbering, lanes: Lanes, mode: Reverse | Forward
) -> tuple[list[Float], UInt32]:
    """Walk all samples twice; returns the sums, and a number to evaluate if there are none.

    The rest of the state is dropped before anything is evaluated, and so never written to memory.
    """
    integrator, scene, count = job.integrator, job.scene, dr.width(lanes.pixel)
    assert isinstance(integrator, PathIntegrator)
    reverse = isinstance(mode, Reverse)
    x, y = job.coordinates(lanes.pixel)
    sampler, ray, _ = job.begin(lanes.pixel, lanes.first, x, y)
    # Plus an opaque zero: Dr.Jit turns a gather of all entries in order into a plain load, which
    # would give images of one sample per pixel a kernel of their own.
    slot = dr.arange(UInt32, count) + dr.opaque(UInt32, 0)
    slot_stride = dr.opaque(UInt32, count)
    delta: Any = dr.zeros(Color3f, count)
    if isinstance(mode, Reverse):
        delta = mode.delta if mode.adjoint is None else mode.adjoint(slot, Bool(True))
    start = Lane(
        ray=wide(ray, count),
        sampler=sampler,
        path=wide(integrator.start(scene), count),
        radiance=dr.zeros(Color3f, count),
        again=dr.full(Bool, False, count),
        k=wide(lanes.first, count),
        slot=slot,
        delta=wide(delta, count),
        sums=mode.accumulator.start() if isinstance(mode, Reverse) else mode.sums,
    )

    def body(lane: Lane) -> tuple[Lane]:
        leaves = Leaves(values, numbering, mode.tangents if isinstance(mode, Forward) else None)
        view = scene.with_lookup(leaves)
        si = integrator.trace(scene, lane.path, lane.ray)
        si.scene = view
        with dr.resume_grad():
            v = integrator.vertex(view, lane.sampler, lane.path, lane.ray, si)
            visible = scene.unoccluded(v.shadow_ray)
            here = v.emitted + dr.select(visible, v.reflected, 0)
            passed = dr.detach(here)
            radiance = dr.select(lane.again, lane.radiance - passed, lane.radiance + passed)
            weight = dr.detach(v.weight)
            scattered = v.weight * dr.select(weight != 0, radiance * dr.rcp(weight), 0)
            outgoing = here + dr.select(v.active, scattered, 0)
            if isinstance(mode, Reverse):
                adjoint: Any = dr.select(lane.again, lane.delta, 0)
                dr.backward(dr.dot(outgoing, adjoint))
                delta, sums = lane.delta, mode.accumulator.add(lane.sums, leaves, lane.again)
            else:
                change = dr.forward_to(outgoing) if dr.grad_enabled(outgoing) else Color3f(0)
                delta = lane.delta + dr.select(lane.again, change, 0)
                sums = lane.sums

        ended = ~v.active
        finished = ended & lane.again
        k = dr.select(finished, lane.k + lanes.stride, lane.k)
        next_slot = dr.select(finished, lane.slot + slot_stride, lane.slot)
        if isinstance(mode, Reverse):
            if mode.adjoint is not None:
                delta = dr.select(finished, mode.adjoint(next_slot, finished & (k < lanes.end)), delta)
        else:
            channels = job.film.tangent_channels(delta)
            if mode.store is None:
                sums = [s + dr.select(finished, c, 0) for s, c in zip(sums, channels, strict=True)]
            else:
                mode.store(lane.slot, channels, finished)
            delta = dr.select(finished, 0, delta)

        fresh, camera_ray, _ = job.begin(lanes.pixel, k, x, y)
        return (
            Lane(
                ray=dr.select(ended, camera_ray, dr.detach(v.ray)),
                sampler=dr.select(ended, fresh, lane.sampler),
                path=restart(ended, integrator.start(scene), dr.detach(v.state)),
                radiance=dr.select(finished, 0, radiance),
                again=lane.again ^ ended,
                k=k,
                slot=next_slot,
                delta=delta,
                sums=sums,
            ),
        )

    label = "replay backward" if reverse else "replay forward"
    (end,) = dr.while_loop((start,), lambda lane: lane.k < lanes.end, body, label=label)
    return end.sums, end.k


def numbering_of(job: Job, parameters: list[Parameter]) -> Numbering:
    """Where the parameters show up in the values that a vertex looks up."""
    return Numbering(parameters, job.scene.bsdfs.leaves() + job.scene.lights.leaves())


def backward_constant(
    job: Job, values: Detached, parameters: list[Parameter], adjoints: list[Float], begin: int, end: int
) -> list[Any]:
    """Gradients of the parameters where all samples of a pixel have the same adjoint."""
    lanes = interleaved(job, Band(0, job.height), begin, end)
    delta = job.film.color_adjoint([dr.gather(Float, a, lanes.pixel) for a in adjoints])
    return gradients(job, values, parameters, lanes, delta, None)


def backward_samples(
    job: Job,
    values: Detached,
    parameters: list[Parameter],
    adjoints: list[Float],
    band: Band,
    begin: int,
    end: int,
) -> list[Any]:
    """Gradients of the parameters from one adjoint per sample of a band, [k - begin][pixel] per channel."""

    def adjoint(slot: UInt32, active: Bool) -> Color3f:
        return job.film.color_adjoint([dr.gather(Float, a, slot, active) for a in adjoints])

    return gradients(job, values, parameters, layered(job, band, begin, end), None, adjoint)


def gradients(
    job: Job,
    values: Detached,
    parameters: list[Parameter],
    lanes: Lanes,
    delta: Color3f | None,
    adjoint: Adjoint | None,
) -> list[Any]:
    """Run the replay in reverse mode and add up the lanes."""
    numbering = numbering_of(job, parameters)
    accumulator = Accumulator(parameters, numbering, dr.width(lanes.pixel))
    sums, k = run(job, values, numbering, lanes, Reverse(accumulator, delta, adjoint))
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
    result = run(job, values, numbering, lanes, Forward(Tangents(numbering, tangents), None, sums))[0]
    dr.eval(result)
    return result


def forward_samples(
    job: Job, values: Detached, parameters: list[Parameter], tangents: list[Any], band: Band, begin: int, end: int
) -> list[Float]:
    """Like `flat.radiance_samples`, of the samples' derivatives."""
    buffers, write = sample_buffers(job, band, end - begin)
    numbering = numbering_of(job, parameters)
    run(job, values, numbering, layered(job, band, begin, end), Forward(Tangents(numbering, tangents), write, []))
    dr.eval(buffers)
    return buffers

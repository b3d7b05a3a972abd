"""Path replay in one walk, where the derivatives of a path's factors fit into registers.

A sample is the sum over its vertices i of what they add, h_i = T_i e_i, with the product T_i of the weights w_j before.
So its derivative is

    sum over i of (T_i d e_i + h_i S_i),    S_i = sum over j < i of d w_j / w_j.

Path replay computes the light behind each weight in a walk of its own, since S has an entry for each parameter and
channel. In forward mode, or with a few parameters, a lane can carry it, and walks once: the same sum in another order.

A factor s that is set aside (`djpt.rendering.gradients.zero_weights`), and so left out of h, isn't divided by. With
s = 1 as long as there is none, a lane carries D = s S + d s: what vertices add has the derivative s d h + h D. A weight
w adds s d w / w to D, and one that is set aside itself turns it into w D + d w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.dispatch.ensemble import Detached
from djpt.integrators.base import PathIntegrator, PathState, Vertex
from djpt.jit.kernels import wide
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.gradients.leaves import Leaves, Numbering, components
from djpt.rendering.gradients.modes import Forward, Mode, Reverse
from djpt.rendering.gradients.zero_weights import TINY, begun
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.lanes import Lanes
from djpt.rendering.schedules.unmasked_loop import run_free

__all__ = ["possible", "run"]

MOST = 12
"""The most sums of gradients in reverse mode. A lane carries three factors for each, one per channel."""


def possible(mode: Mode) -> bool:
    """Whether one walk is enough."""
    if isinstance(mode, Reverse):
        sums = mode.accumulator
        return sums.in_registers and not sums.has_tables and sums.size <= MOST
    return isinstance(mode, Forward)


@dataclass
class Lane:
    """Loop state."""

    ray: Ray3f
    sampler: Any
    path: PathState
    k: UInt32
    slot: UInt32
    delta: Color3f
    """Reverse mode: derivative of the loss with respect to the sample. Forward mode: derivative of the sample."""
    sums: list[Float]
    factors: list[Float]
    """The sums D: [channel] in forward mode, [sum of gradients][channel] in reverse mode."""


def run(
    job: Job, values: Detached, numbering: Numbering, lanes: Lanes, slots: UInt32, slot_stride: UInt32, mode: Mode
) -> tuple[list[Float], UInt32]:
    """Walk all samples once; return the sums, and a number to evaluate if there are none."""
    integrator, scene, count = job.integrator, job.scene, dr.width(lanes.pixel)
    assert isinstance(integrator, PathIntegrator)
    x, y = job.coordinates(lanes.pixel)
    _, attached = mode.view(scene, values, numbering)
    sampler, ray, _ = job.begin(lanes.pixel, lanes.first, x, y)
    number = 3 * (mode.accumulator.size if isinstance(mode, Reverse) else 1)
    start = Lane(
        ray=wide(ray, count),
        sampler=sampler,
        path=wide(begun(integrator.begin(scene, sampler), attached), count),
        k=wide(lanes.first, count),
        slot=wide(slots, count),
        delta=wide(mode.delta_of(slots, Bool(True)), count),
        sums=mode.start(),
        factors=[dr.zeros(Float, count) for _ in range(number)],
    )

    def body(lane: Lane) -> Lane:
        leaves, view = mode.view(scene, values, numbering)
        si = integrator.trace(scene, lane.path, lane.ray)
        si.scene = view
        runs = lane.k < lanes.end
        with dr.resume_grad():
            v = integrator.advance(view, lane.sampler, lane.path, lane.ray, si)
            here = v.emitted + integrator.transmittance(view, lane.sampler, v)
            if isinstance(mode, Reverse):
                factors = in_reverse(mode, lane, leaves, v, here, runs)
            else:
                factors = in_forward(lane, v, here, runs)
        ended = ~v.active
        finished = ended & runs
        k = dr.select(finished, lane.k + lanes.stride, lane.k)
        next_slot = dr.select(finished, lane.slot + slot_stride, lane.slot)
        delta, sums = mode.hand_over(job, lane, finished, next_slot, finished & (k < lanes.end))
        fresh, camera_ray, _ = job.begin(lanes.pixel, k, x, y)
        # It may draw numbers.
        restart = begun(integrator.begin(scene, fresh), attached)
        return Lane(
            ray=dr.select(ended, camera_ray, dr.detach(v.ray)),
            sampler=dr.select(ended, fresh, lane.sampler),
            path=dr.detach(v.state).restarted(ended, restart),
            k=k,
            slot=next_slot,
            delta=delta,
            sums=sums,
            factors=[dr.select(ended, 0, factor) for factor in factors],
        )

    end = run_free(start, lambda lane: lane.k < lanes.end, body, count, f"{mode.label} once")
    return end.sums, end.k


def in_reverse(mode: Reverse, lane: Lane, leaves: Leaves, v: Vertex, here: Color3f, runs: Bool) -> list[Float]:
    """Add the gradients of what a vertex adds to the lane's sums, and return the factors after it."""
    adjoint: Any = dr.select(runs, lane.delta, 0)
    if dr.grad_enabled(here):
        attached = adjoint if lane.path.zero_weight is None else adjoint * lane.path.zero_weight
        dr.backward(dr.dot(here, attached), flags=dr.ADFlag.ClearVertices)
    lane.sums, gained = mode.accumulator.add(lane.sums, leaves, runs), dr.detach(here) * adjoint
    for i, factor in enumerate(lane.factors):
        # Lanes that have done their samples walk on, and may have factors that are NaN.
        lane.sums[i // 3] = dr.select(runs, dr.fma(gained[i % 3], factor, lane.sums[i // 3]), lane.sums[i // 3])
    kept, scale = after_weight(lane.path, v)
    factors = [kept[i % 3] * factor for i, factor in enumerate(lane.factors)]
    for channel in range(3):
        weight: Any = v.weight[channel]
        if not dr.grad_enabled(weight):
            continue
        dr.clear_grad([value for _, _, value in leaves.taken])
        dr.backward(weight, flags=dr.ADFlag.ClearVertices)
        for leaf, slot, value in leaves.taken:
            slopes = components(dr.grad(value))
            for first, mine in mode.accumulator.places(leaf, slot):
                for c, slope in enumerate(slopes):
                    at = 3 * (first + c) + channel
                    factors[at] = factors[at] + dr.select(mine, slope * scale[channel], 0)
    return factors


def in_forward(lane: Lane, v: Vertex, here: Color3f, runs: Bool) -> list[Float]:
    """Add the derivative of what a vertex adds to that of the sample, and return the factors after it."""
    change = dr.forward_to(here, flags=dr.ADFlag.ClearInterior) if dr.grad_enabled(here) else Color3f(0)
    if lane.path.zero_weight is not None:
        change = change * lane.path.zero_weight
    factors = Color3f(*lane.factors)
    lane.delta = lane.delta + dr.select(runs, dr.fma(dr.detach(here), factors, change), 0)
    kept, scale = after_weight(lane.path, v)
    factors = kept * factors
    if dr.grad_enabled(v.weight):
        factors = dr.fma(dr.forward_to(v.weight, flags=dr.ADFlag.ClearInterior), scale, factors)
    return list(factors)


def after_weight(path: PathState, v: Vertex) -> tuple[Color3f, Color3f]:
    """Per channel, the numbers by which the factors so far and the derivative of a vertex's weight are multiplied."""
    weight = dr.detach(v.weight)
    if path.zero_weight is None or v.state.zero_weight is None:
        return Color3f(1), dr.select(weight != 0, dr.rcp(weight), 0)
    new = [before != after for before, after in zip(path.zero_weight, dr.detach(v.state.zero_weight), strict=True)]
    quotient = dr.select(dr.abs(weight) > TINY, path.zero_weight * dr.rcp(weight), 0)
    kept = Color3f(*(dr.select(n, w, 1) for n, w in zip(new, weight, strict=True)))
    return kept, Color3f(*(dr.select(n, 1, q) for n, q in zip(new, quotient, strict=True)))

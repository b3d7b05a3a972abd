"""Path replay with one path per lane: the second walk of a wavefront whose first one gave the radiance.

What a vertex contributes is that of `djpt.rendering.gradients.replay`. Here values are not leaves made anew at each
vertex but attached to the scene, which gathers them from buffers (`djpt.dispatch.ensemble.Attached`), and the random
numbers may be those of any sampler that a loop of Dr.Jit can carry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.integrators.base import PathIntegrator, trace_path
from djpt.integrators.volpath import VolumetricPathState
from djpt.jit.kernels import loop_traced_once, wide
from djpt.jit.types import Bool, Color3f, Point3f, UInt32, Vector3f
from djpt.rendering.gradients.extinction_walk import (
    ExtinctionWalk,
    attached_extinction,
    next_extinction_walk,
    no_extinction_walk,
    observed,
    scattered,
    turned_off,
)
from djpt.rendering.gradients.zero_weights import begun, blank, collected, outgoing_radiance
from djpt.samplers.base import SampleStream
from djpt.scene.scene import Scene

__all__ = ["Measured", "measured", "replayed"]


@dataclass
class Measured:
    """What the first walk finds of each path."""

    radiance: Color3f
    """Its radiance."""
    behind: Color3f | None
    """The light behind the factor that is set aside, without it; None if nothing is: see
    `djpt.rendering.gradients.zero_weights`."""


@dataclass
class FirstLoop:
    """Loop state of the first walk."""

    o: Point3f
    d: Vector3f
    medium: UInt32 | None
    sampler: SampleStream
    state: Any
    found: Measured
    active: Bool


@dataclass
class ReplayLoop:
    """Loop state of one path per lane."""

    o: Point3f
    d: Vector3f
    medium: UInt32 | None
    sampler: SampleStream
    state: Any
    """A `PathState`; the type is `Any`, because Dr.Jit would look for the name in this module."""
    radiance: Color3f
    """The radiance still to come."""
    behind: Color3f | None
    delta: Color3f
    """Reverse mode: derivative of the loss with respect to the sample. Forward mode: derivative of the sample."""
    active: Bool
    extinction_walk: ExtinctionWalk | None
    """Where a third walk is to begin; None if no extinction of tracked media has derivatives."""


def measured(
    integrator: PathIntegrator, scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool | bool = True
) -> Measured:
    """Follow one path per lane to its end, and return what `replayed` needs to know of it.

    Unlike the paths of `trace_path` these go on behind black surfaces, where there are
    derivatives.
    """
    lanes = dr.width(ray, sampler)
    start = FirstLoop(
        o=wide(ray.o, lanes),
        d=wide(ray.d, lanes),
        medium=wide(ray.medium, lanes),
        sampler=sampler,
        state=wide(begun(integrator.begin(scene, sampler), scene), lanes),
        found=Measured(dr.zeros(Color3f, lanes), blank(scene, lanes)),
        active=Bool(active) & dr.full(Bool, True, lanes),
    )

    def body(lane: FirstLoop) -> tuple[FirstLoop]:
        way = Ray3f(lane.o, lane.d, maxt=dr.select(lane.state.depth == 0, ray.maxt, dr.inf), medium=lane.medium)
        si = integrator.trace(scene, lane.state, way)
        # What has derivatives decides where paths go on, and so which numbers are drawn.
        with dr.resume_grad():
            v = integrator.advance(scene, lane.sampler, lane.state, way, si)
            here = dr.detach(v.emitted + integrator.transmittance(scene, lane.sampler, v))
        gained, behind = collected(lane.state.zero_weight, lane.found.behind, here)
        onward, state, found = dr.detach(v.ray), dr.detach(v.state), Measured(lane.found.radiance + gained, behind)
        return (FirstLoop(onward.o, onward.d, onward.medium, lane.sampler, state, found, v.active),)

    with dr.suspend_grad():
        (end,) = loop_traced_once(start, lambda lane: lane.active, body, f"{type(integrator).__name__} measured")
    return end.found


def replayed(
    integrator: PathIntegrator,
    mode: dr.ADMode,
    scene: Scene,
    sampler: SampleStream,
    ray: Ray3f,
    found: Measured,
    delta: Color3f | None = None,
    active: Bool | bool = True,
) -> Color3f:
    """Follow again the paths of which `found` is known, with the same random numbers, and differentiate it.

    Args:
        integrator: Says what happens at a vertex.
        mode: ``dr.ADMode.Backward``: propagate the adjoint `delta` of each path to what the scene reads; ``Forward``:
            propagate from there.
        scene: A view whose lookups are attached.
        sampler: In the state that the first walk began with.
        ray: The camera rays.
        found: What `measured` returned.
        delta: The derivative of the loss with respect to the radiance; in reverse mode only.
        active: Lanes that have a path.

    Returns:
        `delta`, or in forward mode the derivative of the radiance.
    """
    lanes = dr.width(ray, found.radiance)
    first, extinction_walk = begun(integrator.begin(scene, sampler), scene), None
    if attached_extinction(scene):
        first = observed(first)
        extinction_walk = wide(no_extinction_walk(ray, first), lanes)
    start = ReplayLoop(
        o=wide(ray.o, lanes),
        d=wide(ray.d, lanes),
        medium=wide(ray.medium, lanes),
        sampler=sampler,
        state=wide(first, lanes),
        radiance=wide(found.radiance, lanes),
        behind=wide(found.behind, lanes),
        delta=wide(Color3f(0) if delta is None else delta, lanes),
        active=Bool(active) & dr.full(Bool, True, lanes),
        extinction_walk=extinction_walk,
    )

    def body(lane: ReplayLoop) -> tuple[ReplayLoop]:
        way = Ray3f(lane.o, lane.d, maxt=dr.select(lane.state.depth == 0, ray.maxt, dr.inf), medium=lane.medium)
        si = integrator.trace(scene, lane.state, way)
        with dr.resume_grad():
            v = integrator.advance(scene, lane.sampler, lane.state, way, si)
            here = v.emitted + integrator.transmittance(scene, lane.sampler, v)
            left = lane.radiance - dr.detach(here)
            outgoing, left = outgoing_radiance(v, lane.state, here, left, lane.behind)
            delta = differentiated(mode, outgoing, lane.delta)
        onward, state = dr.detach(v.ray), dr.detach(v.state)
        past = lane.extinction_walk
        if past is not None:
            assert isinstance(state, VolumetricPathState) and state.flown is not None
            length = dr.select(si.is_valid(), si.t, way.maxt)
            past = next_extinction_walk(scene, past, lane.state, way, state.flown, length, lane.active)
        o, d, medium = onward.o, onward.d, onward.medium
        return (ReplayLoop(o, d, medium, lane.sampler, state, left, lane.behind, delta, v.active, past),)

    with dr.suspend_grad():
        (end,) = loop_traced_once(start, lambda lane: lane.active, body, f"{type(integrator).__name__} again")
        if end.extinction_walk is None:
            return end.delta
        goes = end.extinction_walk.total > 0
        (light,), _ = trace_path(
            integrator, scene, end.sampler, end.extinction_walk.ray, goes, state=turned_off(end.extinction_walk)
        )
        with dr.resume_grad():
            there = scattered(scene, end.extinction_walk, dr.detach(light), goes)
            return differentiated(mode, dr.select(goes, there, 0), end.delta)


def differentiated(mode: dr.ADMode, outgoing: Color3f, delta: Color3f) -> Color3f:
    """Delta after a vertex with the attached radiance `outgoing`; in reverse mode gradients are propagated."""
    # A parameter may have no effect at all.
    if not dr.grad_enabled(outgoing):
        return delta
    if mode == dr.ADMode.Backward:
        loss: Any = outgoing * delta
        dr.backward_from(loss)
        return delta
    return delta + dr.forward_to(outgoing)

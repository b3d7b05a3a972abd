"""Replay of light paths, one per lane: how their light changes with what the scene reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr

from djpt.films.footprint import in_window
from djpt.integrators.base import SMALL
from djpt.integrators.bidirectional.subpath import with_derivative
from djpt.jit.kernels import loop_traced_once, wide
from djpt.jit.types import Bool, Color3f, Point2f, UInt32
from djpt.rendering.gradients.gradient_sums import Carried, Found, GradientSums, Joined
from djpt.rendering.gradients.zero_weights import has_zero_weights
from djpt.samplers.base import SampleStream
from djpt.scene.scene import Scene

__all__ = ["Joints", "LightPaths", "LightWalk", "Step", "begun", "nothing", "vanishes", "walk_light_paths"]


@dataclass
class Step:
    """A vertex of a light path; its colours are attached where the scene's values are."""

    arrived: Color3f
    """The throughput with which the path arrives."""
    position: Point2f
    """The place on the film that shows the vertex, in [0, 1)^2 of the crop window."""
    light: Color3f
    """The light that the film receives there, with its weight."""
    shows: Bool
    """Where the light counts."""
    onward: Color3f
    """The throughput of the path that goes on."""
    zero_weight: Color3f | None
    """What is set aside of it, or 1; None if nothing is set aside."""
    state: Any
    """The state of the path that goes on."""
    active: Bool
    """True where it does."""
    joins: Bool
    """Where the vertex is kept for connections."""
    vertex: Any = None
    """What is kept of it."""


class LightPaths(Protocol):
    """The light paths of an estimator."""

    def begin(self, sampler: SampleStream) -> tuple[Any, Color3f, Color3f | None]:
        """The state of a path that leaves a light, its throughput, attached, and what is set aside of that."""

    def step(self, state: Any, sampler: SampleStream, active: Bool) -> Step:
        """The next vertex of a path."""


@dataclass
class Joints:
    """What is kept of the vertices of a light path, in local memory."""

    vertices: Any
    beside: Any
    """A colour for each vertex: see `djpt.rendering.gradients.gradient_sums`."""
    zero_weight: Any
    """What the path has set aside before each vertex, or 1; None if nothing is set aside."""


@dataclass
class LightWalk:
    """Loop state. Types are `Any` where Dr.Jit would look for their names in this module."""

    state: Any
    zero_weight: Color3f | None
    sampler: Any
    active: Bool
    carried: Any
    """What is `Carried`."""
    count: UInt32
    """The number of vertices so far that are kept."""
    joints: Any
    """`Joints`, or None."""


def vanishes(scene: Scene) -> bool:
    """Whether AD leaves may make factors of light paths vanish: see `djpt.rendering.gradients.zero_weights`."""
    return has_zero_weights(scene) or bool(scene.lights.ensemble.vanishing(scene.lookup))


def nothing(scene: Scene, lanes: int) -> Carried:
    """What walks carry before they have found anything."""
    return Carried(dr.zeros(Color3f, lanes), dr.zeros(Color3f, lanes) if vanishes(scene) else None)


def begun(scene: Scene, throughput: Color3f, share: Color3f) -> tuple[Color3f, Color3f | None]:
    """The attached throughput of a path that leaves a light, and what is set aside of it, or 1.

    Channels are set aside that are small by their `share`, in relation to the brightest one. None: nothing ever is.
    """
    if not vanishes(scene):
        return throughput, None
    plain, small = dr.detach(throughput), dr.abs(dr.detach(share)) < SMALL
    return with_derivative(dr.select(small, 1, plain), throughput), dr.select(small, plain, 1)


def walk_light_paths(
    paths: LightPaths,
    gradient_sums: GradientSums,
    sampler: SampleStream,
    lanes: int,
    carried: Carried,
    begins: bool = True,
    joints: Joints | None = None,
) -> LightWalk:
    """Follow one light path per lane to its end.

    Args:
        paths: The estimator's.
        gradient_sums: The mode.
        sampler: The random numbers; of a second walk those of the first.
        lanes: Their number.
        carried: What paths begin with.
        begins: False if there are no light paths at all.
        joints: Room for vertices; on a second walk, what the first one and connections have left there.
    """
    with dr.resume_grad():
        state, throughput, zero_weight = paths.begin(sampler)
        carried = gradient_sums.begin(throughput, zero_weight, carried)
    start = LightWalk(
        state=wide(dr.detach(state), lanes),
        zero_weight=wide(zero_weight, lanes),
        sampler=sampler,
        active=dr.full(Bool, begins, lanes),
        carried=wide(dr.detach(carried), lanes),
        count=dr.zeros(UInt32, lanes),
        joints=joints,
    )

    def body(lane: LightWalk) -> tuple[LightWalk]:
        joints: Joints | None = lane.joints
        with dr.resume_grad():
            step = paths.step(lane.state, lane.sampler, lane.active)
            others = Color3f(0)
            if joints is not None and gradient_sums.again:
                others = dr.select(step.joins, joints.beside.read(lane.count, step.joins), 0)
            shows = step.shows & in_window(step.position)
            found = Found(
                light=step.light,
                adjoint=gradient_sums.adjoint(step.position, shows),
                arrived=step.arrived,
                joined=Joined(others, None, None, Color3f(0)),
                onward=step.onward,
                active=step.active,
                before=lane.zero_weight,
                after=step.zero_weight,
            )
            lane.carried, here, change = gradient_sums.visit(lane.carried, found)
        gradient_sums.shown(step.position, change, shows)
        if joints is not None:
            if not gradient_sums.again:
                joints.vertices.write(step.vertex, lane.count, step.joins)
                joints.beside.write(here, lane.count, step.joins)
                if joints.zero_weight is not None:
                    joints.zero_weight.write(lane.zero_weight, lane.count, step.joins)
            lane.count = dr.select(step.joins, lane.count + 1, lane.count)
        lane.state, lane.zero_weight, lane.active = dr.detach(step.state), step.zero_weight, step.active
        return (lane,)

    (end,) = loop_traced_once(start, lambda lane: lane.active, body, f"light path, {gradient_sums.label}")
    return end

"""The two modes of path replay: what it does at a vertex in reverse and in forward mode.

The loops in `djpt.rendering.gradients.replay` and `djpt.rendering.gradients.machine_replay` call them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import drjit as dr

from djpt.dispatch.ensemble import Detached
from djpt.integrators.base import PathState, Vertex
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.gradients.leaves import Accumulator, Leaves, Numbering, Tangents
from djpt.rendering.gradients.zero_weights import collected, outgoing_radiance
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.sinks import Write
from djpt.scene.scene import Scene

__all__ = ["Adjoint", "Forward", "Mode", "Reverse", "Sample"]

Adjoint = Callable[[UInt32, Bool], Color3f]
"""Gives the derivative of the loss with respect to the sample stored at a slot, for active lanes."""


class Sample(Protocol):
    """The state of a lane as far as a mode reads it where a sample ends."""

    slot: UInt32
    delta: Color3f
    """Reverse mode: derivative of the loss with respect to the sample. Forward mode: derivative of the sample."""
    sums: list[Float]


class Walk(Sample, Protocol):
    """The state of a lane as far as a mode reads it."""

    radiance: Color3f
    """First walk: radiance so far. Second walk: radiance still to come."""
    behind: Color3f | None
    """Of what is set aside, the light that comes along it, without the factor; None if nothing is set aside."""
    path: PathState

    @property
    def again(self) -> Bool:
        """True on the second walk."""


class Mode:
    """The parts that differ between the modes."""

    label: ClassVar[str]
    takes_long: ClassVar[bool] = False
    """Whether `differentiate` takes longer than the rest of a vertex."""

    def start(self) -> list[Float]:
        """The sums at the start of the loop."""
        raise NotImplementedError

    def delta_of(self, slot: UInt32, active: Bool) -> Color3f:
        """The `delta` of a lane that begins the sample stored at `slot`."""
        raise NotImplementedError

    def view(self, scene: Scene, values: Detached, numbering: Numbering) -> tuple[Leaves, Scene]:
        """Fresh leaves for one vertex, and the scene that reads them."""
        leaves = Leaves(values, numbering, None)
        return leaves, scene.replace(lookup=leaves)

    def visit(
        self, walk: Walk, leaves: Leaves, v: Vertex, arrived: Color3f, differentiate: Bool
    ) -> tuple[Color3f, Color3f | None, Color3f, list[Float]]:
        """Radiance, light `behind`, delta and sums after a vertex; `arrived` is the light of its light sample.

        Lanes that `differentiate` are on their second walk.
        """
        radiance, behind, outgoing = self.outgoing(walk, v, arrived)
        with dr.resume_grad():
            return radiance, behind, *self.differentiate(walk, leaves, outgoing, differentiate)

    def outgoing(self, walk: Walk, v: Vertex, arrived: Color3f) -> tuple[Color3f, Color3f | None, Color3f]:
        """Radiance and light `behind` after a vertex, and on the second walk all that depends on parameters there.

        That is Lo = emitted + arrived + L weight / detach(weight), where L is the radiance still to come.
        """
        with dr.resume_grad():
            here = v.emitted + arrived
            passed = dr.detach(here)
            gained, behind = collected(walk.path.zero_weight, walk.behind, passed)
            radiance = dr.select(walk.again, walk.radiance - passed, walk.radiance + gained)
            outgoing, to_come = outgoing_radiance(v, walk.path, here, radiance, walk.behind)
            if behind is not None:
                behind = dr.select(walk.again, walk.behind, behind)
                radiance = dr.select(walk.again, to_come, radiance)
            return radiance, behind, outgoing

    def differentiate(self, walk: Walk, leaves: Leaves, outgoing: Color3f, active: Bool) -> tuple[Color3f, list[Float]]:
        """Delta and sums after a vertex with the attached radiance `outgoing`; gradients must not be suspended."""
        raise NotImplementedError

    def hand_over(
        self, job: Job, walk: Sample, finished: Bool, next_slot: UInt32, more: Bool, counts: Bool | bool = True
    ) -> tuple[Color3f, list[Float]]:
        """Delta and sums after the second walk of the lanes that have `finished`.

        `more` is true where another sample follows, `counts` where the one that has ended is part of the image.
        """
        raise NotImplementedError


@dataclass
class Reverse(Mode):
    """Sum the parameters' gradients, given the samples' adjoints.

    The adjoints are `delta` for all samples of a lane, or what `adjoint` reads for each.
    """

    label = "replay backward"
    accumulator: Accumulator
    delta: Color3f | None
    adjoint: Adjoint | None

    def start(self) -> list[Float]:
        return self.accumulator.start()

    def delta_of(self, slot: UInt32, active: Bool) -> Color3f:
        if self.adjoint is not None:
            return self.adjoint(slot, active)
        assert self.delta is not None
        return self.delta

    def differentiate(self, walk: Walk, leaves: Leaves, outgoing: Color3f, active: Bool) -> tuple[Color3f, list[Float]]:
        adjoint: Any = dr.select(active, walk.delta, 0)
        # A parameter may have no effect at all.
        if dr.grad_enabled(outgoing):
            dr.backward(dr.dot(outgoing, adjoint))
        return walk.delta, self.accumulator.add(walk.sums, leaves, active)

    def hand_over(
        self, job: Job, walk: Sample, finished: Bool, next_slot: UInt32, more: Bool, counts: Bool | bool = True
    ) -> tuple[Color3f, list[Float]]:
        if self.adjoint is None:
            return walk.delta, walk.sums
        return dr.select(finished, self.adjoint(next_slot, more), walk.delta), walk.sums


@dataclass
class Forward(Mode):
    """Compute the derivative of each sample from the parameters' tangents, for sums or for ``store``."""

    label = "replay forward"
    tangents: Tangents
    store: Write | None
    sums: list[Float]

    def start(self) -> list[Float]:
        return self.sums

    def delta_of(self, slot: UInt32, active: Bool) -> Color3f:
        return Color3f(0)

    def view(self, scene: Scene, values: Detached, numbering: Numbering) -> tuple[Leaves, Scene]:
        leaves = Leaves(values, numbering, self.tangents)
        return leaves, scene.replace(lookup=leaves)

    def differentiate(self, walk: Walk, leaves: Leaves, outgoing: Color3f, active: Bool) -> tuple[Color3f, list[Float]]:
        change = dr.forward_to(outgoing) if dr.grad_enabled(outgoing) else Color3f(0)
        return walk.delta + dr.select(active, change, 0), walk.sums

    def hand_over(
        self, job: Job, walk: Sample, finished: Bool, next_slot: UInt32, more: Bool, counts: Bool | bool = True
    ) -> tuple[Color3f, list[Float]]:
        channels, sums = job.tangent_channels(walk.delta), walk.sums
        if self.store is None:
            sums = [s + dr.select(finished & counts, c, 0) for s, c in zip(sums, channels, strict=True)]
        else:
            self.store(walk.slot, channels, finished & counts)
        return dr.select(finished, 0, walk.delta), sums

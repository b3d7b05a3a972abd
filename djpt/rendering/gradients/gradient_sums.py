"""What a walk makes of the light that paths of both ends find, when an image is differentiated by replay.

A path adds light c to one pixel or to many, and each c is a product of factors, one for each vertex, times a weight
that has no derivative. Let w be the factor of a vertex. Its derivative counts for all light that is found behind it,

    sum over c behind of a c (dw / w),    a = derivative of the loss by the pixel that c is added to.

* Reverse mode: a first walk adds up a c (`Measure`), a second one subtracts what it passes, so that at each vertex the
  sum of what is found behind it is known (`Reverse`).
* Forward mode: one walk carries the sum of dw / w over the factors behind it (`Forward`).

A vertex of a light path may be connected to many camera vertices: what they find is kept beside it, in local memory.
Factors too small to divide by are set aside, as `djpt.rendering.gradients.zero_weights` explains: light is found as if
such a factor s were 1, and what is found behind it is added up for itself, without s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import drjit as dr

from djpt.films.footprint import ChangeSplats, SpreadReader
from djpt.jit.types import Bool, Color3f, Point2f, UInt32
from djpt.rendering.gradients.zero_weights import TINY

__all__ = ["Carried", "Forward", "Found", "GradientSums", "Joined", "Joint", "Measure", "Reverse", "added"]


@dataclass
class Carried:
    """What a walk carries from vertex to vertex."""

    light: Color3f
    """First walk: the light so far, times its adjoints. Second walk: what is still to come. Forward mode: the change of
    the path's throughput over the throughput, without what is set aside of either."""
    behind: Color3f | None
    """The light behind the factor that is set aside, without it; None if nothing is set aside."""


@dataclass
class Joined:
    """What connections find."""

    light: Color3f
    """Their light, without derivatives: in reverse mode times its adjoint, in forward mode without what is set aside of
    the path that is connected."""
    behind: Color3f | None
    """The part behind what that path sets aside, without it; None if nothing is set aside."""
    behind_other: Color3f | None
    """The same of the other path."""
    change: Color3f
    """Forward mode: their change by factors of the connections and of the other paths."""


@dataclass
class Found:
    """What a path finds at a vertex; colours are attached to what is differentiated, except for `joined`."""

    light: Color3f
    """The light that it adds there, with its weight, without what is set aside."""
    adjoint: Color3f
    """The derivative of the loss by that light; 0 in forward mode."""
    arrived: Color3f
    """The throughput with which the path arrives."""
    joined: Joined
    onward: Color3f
    """The throughput of the path that goes on."""
    active: Bool
    """True where it does."""
    before: Color3f | None
    """What was set aside before, or 1; None if nothing is set aside."""
    after: Color3f | None
    """The same with this vertex."""

    @property
    def zero_weight(self) -> Color3f:
        """What was set aside before, or 1."""
        return Color3f(1) if self.before is None else self.before

    @property
    def leaving(self) -> Color3f:
        """The relative throughput of the path that goes on; 0 where its last factor is too small to divide by."""
        return relative(self.onward, None if self.before is None else TINY * dr.detach(self.arrived))

    def chosen(self, new: Color3f | None, old: Color3f) -> Color3f:
        """The channels of `new` where this vertex is set aside, and of `old` elsewhere."""
        if self.before is None or self.after is None or new is None:
            return old
        return where(self.before, self.after, new, old)


@dataclass
class Joint:
    """A connection to a vertex of a light path."""

    light: Color3f
    """What it adds, attached, with its weight and without what is set aside."""
    adjoint: Color3f
    """The derivative of the loss by that light; 0 in forward mode."""
    here: Color3f | None
    """What the camera path has set aside, or 1; None if nothing is set aside."""
    there: Color3f | None
    """The same of the light path."""
    beside: Any
    """What is kept beside the vertices of the light path."""
    i: UInt32
    """The number of the vertex."""

    @property
    def zero_weight(self) -> Color3f:
        """What both paths have set aside."""
        return Color3f(1) if self.here is None or self.there is None else self.here * self.there


class GradientSums:
    """The part of a walk that differs between the modes."""

    label: ClassVar[str]
    again: ClassVar[bool] = False
    """Whether the walk is the second one."""

    def begin(self, throughput: Color3f, zero_weight: Color3f | None, carried: Carried) -> Carried:
        """What is carried to the first vertex of a path that begins with an attached throughput."""
        return carried

    def adjoint(self, position: Point2f, active: Bool) -> Color3f:
        """The derivative of the loss by light at a position in [0, 1)^2 of the crop window."""
        return Color3f(0)

    def visit(self, carried: Carried, found: Found) -> tuple[Carried, Color3f, Color3f]:
        """What is carried on from a vertex, what is kept beside it, and the change of what is found there."""
        raise NotImplementedError

    def connect(self, joined: Joined, joint: Joint) -> Joined:
        """`joined` with one connection more."""
        raise NotImplementedError

    def shown(self, position: Point2f, change: Color3f, active: Bool) -> None:
        """Add the change of the light at a position."""


@dataclass
class Measure(GradientSums):
    """Add up the light times the adjoint of its pixel."""

    label = "measured"
    pixels: SpreadReader

    def adjoint(self, position: Point2f, active: Bool) -> Color3f:
        return self.pixels.at(position, active)

    def visit(self, carried: Carried, found: Found) -> tuple[Carried, Color3f, Color3f]:
        light, joined = found.adjoint * dr.detach(found.light), found.joined
        total = carried.light + found.zero_weight * light + joined.light
        behind = added(added(carried.behind, found.before, light), None, joined.behind)
        return Carried(total, behind), Color3f(0), Color3f(0)

    def connect(self, joined: Joined, joint: Joint) -> Joined:
        light = joint.adjoint * dr.detach(joint.light)
        whole = joint.zero_weight * light
        joint.beside.write(joint.beside.read(joint.i) + whole, joint.i)
        if joint.here is None or joint.there is None:
            return replace(joined, light=joined.light + whole)
        behind = added(joined.behind, joint.here, light * joint.there)
        return Joined(
            joined.light + whole, behind, added(joined.behind_other, joint.there, light * joint.here), Color3f(0)
        )


@dataclass
class Reverse(Measure):
    """Differentiate the factors of a vertex times what is found behind them, in reverse mode."""

    label = "replay backward"
    again = True

    def begin(self, throughput: Color3f, zero_weight: Color3f | None, carried: Carried) -> Carried:
        light = carried.light
        if zero_weight is not None and carried.behind is not None:
            light = where(Color3f(1), zero_weight, carried.behind, light)
        propagate(relative(throughput), light)
        return carried

    def visit(self, carried: Carried, found: Found) -> tuple[Carried, Color3f, Color3f]:
        adjoint = found.zero_weight * found.adjoint
        left = carried.light - adjoint * dr.detach(found.light) - found.joined.light
        onward = dr.select(found.active, found.chosen(carried.behind, left), 0)
        propagate(
            *(found.light, adjoint),
            *(relative(found.arrived), found.joined.light),
            *(found.leaving, onward),
        )
        return replace(carried, light=left), Color3f(0), Color3f(0)

    def connect(self, joined: Joined, joint: Joint) -> Joined:
        adjoint = joint.zero_weight * joint.adjoint
        propagate(joint.light, adjoint)
        return replace(joined, light=joined.light + adjoint * dr.detach(joint.light))


@dataclass
class Forward(GradientSums):
    """Carry the relative change of a path's throughput, and add the changes of light."""

    label = "replay forward"
    changes: ChangeSplats

    def begin(self, throughput: Color3f, zero_weight: Color3f | None, carried: Carried) -> Carried:
        (change,) = changes(relative(throughput))
        return replace(carried, light=carried.light + change)

    def visit(self, carried: Carried, found: Found) -> tuple[Carried, Color3f, Color3f]:
        of_light, arriving, leaving = changes(found.light, relative(found.arrived), found.leaving)
        before = carried.light
        here = before + found.zero_weight * arriving
        joined = found.joined
        change = found.zero_weight * of_light + dr.detach(found.light) * before + joined.light * here + joined.change
        new = None if found.after is None else found.after * before + leaving
        onward = found.chosen(new, before + found.zero_weight * leaving)
        return replace(carried, light=dr.select(found.active, onward, 0)), here, change

    def connect(self, joined: Joined, joint: Joint) -> Joined:
        (change,) = changes(joint.light)
        light, kept = dr.detach(joint.light), joint.beside.read(joint.i)
        of_other = light * kept if joint.here is None else joint.here * light * kept
        light = light if joint.there is None else light * joint.there
        return replace(joined, light=joined.light + light, change=joined.change + joint.zero_weight * change + of_other)

    def shown(self, position: Point2f, change: Color3f, active: Bool) -> None:
        self.changes.add(position, change, active)


# ---- colours -------------------------------------------------------------------------------


def where(before: Color3f, after: Color3f, new: Color3f, old: Color3f) -> Color3f:
    """The channels of `new` where what is set aside has changed, and of `old` elsewhere."""
    channels = zip(before, after, new, old, strict=True)
    return Color3f(*(dr.select(b != a, n, o) for b, a, n, o in channels))


def added(behind: Color3f | None, zero_weight: Color3f | None, light: Color3f | None) -> Color3f | None:
    """The light behind the `zero_weight` with some more, or with all of it without a `zero_weight`; None stays."""
    if behind is None or light is None:
        return behind
    return behind + (light if zero_weight is None else where(Color3f(1), zero_weight, light, Color3f(0)))


def relative(throughput: Color3f, least: Color3f | None = None) -> Color3f:
    """An attached throughput over its value; 0 where that is 0, or not above `least`."""
    value = dr.detach(throughput)
    return throughput * dr.select(value != 0 if least is None else dr.abs(value) > least, dr.rcp(value), 0)


def propagate(*pairs: Color3f) -> None:
    """Propagate gradients to what attached colours depend on, which stand in turn with their adjoints."""
    loss: Any = None
    for value, adjoint in zip(pairs[::2], pairs[1::2], strict=True):
        if dr.grad_enabled(value):
            part = dr.dot(value, adjoint)
            loss = part if loss is None else loss + part
    # A parameter may have no effect at all.
    if loss is not None:
        dr.backward_from(loss)


def changes(*values: Color3f) -> list[Color3f]:
    """The derivatives of attached colours, propagated to them; 0 for others."""
    attached = [value for value in values if dr.grad_enabled(value)]
    if not attached:
        return [Color3f(0) for _ in values]
    # What was read from keeps its gradient, for the next walk.
    found: Any = dr.forward_to(*attached, flags=dr.ADFlag.ClearEdges | dr.ADFlag.ClearInterior)
    of = iter(found if len(attached) > 1 else (found,))
    return [next(of) if dr.grad_enabled(value) else Color3f(0) for value in values]

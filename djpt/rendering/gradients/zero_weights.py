"""Factors too small to divide by: how path replay finds the light behind them.

At a vertex of weight w the light L that is still to come is known with the weight in it, and its derivative is that of
w L / w: useless where w is tiny, and undefined where it is 0 (a black albedo, say). There the light without the factor
must be known. So the first such factor of each channel is *set aside* (`PathState.weighted`): the path goes on as if it
were 1, and the first walk adds up the light behind it for itself. If s is the factor, and 1 as long as there is none,
the first walk computes

    radiance = sum of s c        behind = sum of c over the vertices behind the factor

where c is what a vertex adds by its throughput, s left out. In the second walk all light before the factor is
`radiance`, at its vertex the derivative is that of w times `behind`, and from there on `behind` is the light still to
come, and all derivatives are scaled by s. Nothing is divided by s. A product of two zeros has no derivative, so one
factor is enough; a second small one, of which a fraction s counts, is divided by, unless it is smaller than `TINY`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import drjit as dr

from djpt.integrators.base import PathState, Vertex
from djpt.jit.types import Color3f
from djpt.scene.scene import Scene

__all__ = ["TINY", "begun", "blank", "collected", "has_zero_weights", "outgoing_radiance"]

TINY = 1e-6
"""Smaller factors aren't divided by: rounding errors would be all that remains."""

State = TypeVar("State", bound=PathState)


def has_zero_weights(scene: Scene) -> bool:
    """Whether AD leaves may make factors vanish: those of media, and values of materials that are nearly 0 or 1."""
    return bool(scene.bsdfs.ensemble.vanishing(scene.lookup)) or scene.media.are_attached()


def begun(state: State, scene: Scene) -> State:
    """The state of a path that begins, ready to set factors aside if that is needed."""
    return replace(state, zero_weight=Color3f(1)) if has_zero_weights(scene) else state


def blank(scene: Scene, lanes: int) -> Color3f | None:
    """The light behind factors at the start of a path; None if none is set aside."""
    return dr.zeros(Color3f, lanes) if has_zero_weights(scene) else None


def collected(zero_weight: Color3f | None, behind: Color3f | None, light: Color3f) -> tuple[Color3f, Color3f | None]:
    """What `light` adds to the radiance of the first walk, and the light `behind` with it."""
    if zero_weight is None or behind is None:
        return light, None
    return zero_weight * light, behind + dr.select(zero_weight == 1, 0, light)


def outgoing_radiance(
    v: Vertex, path: PathState, here: Color3f, left: Color3f, behind: Color3f | None
) -> tuple[Color3f, Color3f]:
    """The attached radiance that leaves a vertex on the second walk, and the radiance that is still to come after it.

    Args:
        v: The vertex, attached.
        path: The state of the path that arrived there.
        here: What the vertex adds, attached.
        left: The radiance after it, which has the weight of the vertex in it.
        behind: The light behind the factor that is set aside.
    """
    weight = dr.detach(v.weight)
    if path.zero_weight is None or behind is None or v.state.zero_weight is None:
        incoming = dr.select(weight != 0, left * dr.rcp(weight), 0)
        return here + dr.select(v.active, v.weight * incoming, 0), left
    new = [before != after for before, after in zip(path.zero_weight, dr.detach(v.state.zero_weight), strict=True)]
    divided = dr.select(dr.abs(weight) > TINY, left * dr.rcp(weight), 0)
    incoming = Color3f(*(dr.select(n, b, d) for n, b, d in zip(new, behind, divided, strict=True)))
    to_come = Color3f(*(dr.select(n, b, r) for n, b, r in zip(new, behind, left, strict=True)))
    return path.zero_weight * (here + dr.select(v.active, v.weight * incoming, 0)), to_come

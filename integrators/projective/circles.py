"""The boundary term of image circles: where what a lens shows ends on the film, and darkness begins."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.integrators.projective.detail import detached
from djpt.integrators.projective.kept import keep
from djpt.integrators.projective.spread import spread
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32

__all__ = ["edge_of_circle"]

INSET = 1e-4
"""How far within the circle its edge is looked at, as a fraction of the radius."""


def edge_of_circle(integrator: Any, scene: Any, sensor: Any, sampler: Any) -> tuple[Color3f, Point2f, Bool]:
    """The derivative of the image by random points of the edge, attached, their places, and where they are on the film.

    With p(u) the edge on the film, a unit square, at the fraction u of a turn, and L the radiance just inside,

        dI = L (dp/du x dp/dtheta) du,

    with the sign of p turning about the middle.
    """
    window = Point2f(sensor.film().crop_size())
    with dr.suspend_grad():
        u, still = spread(sampler).x, detached(sensor)
        with dr.resume_grad():
            turn = Float(u)
            dr.enable_grad(turn)
            place = still.edge_of_view(turn)
            dr.set_grad(turn, 1)
            tangent = Point2f(dr.forward_to(place, flags=dr.ADFlag.ClearEdges))
        place = Point2f(dr.detach(place))
        outward = place - still.middle()
        side = dr.mulsign(Float(1), outward.x * tangent.y - outward.y * tangent.x)
        active = (place.x >= 0) & (place.x < 1) & (place.y >= 0) & (place.y < 1)
        ray = still.ray_through(place - outward * INSET, Point2f(0), active)
        light = integrator.shade(scene, sampler, ray, UInt32(0), None, active)
        keep(u, place, tangent, side, light, active)
    moved = sensor.edge_of_view(u)
    change = moved - dr.detach(moved)
    swept = (change.x * tangent.y - change.y * tangent.x) * side
    return Color3f(light) * dr.select(active, swept, 0), place * window, active

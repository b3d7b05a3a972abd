"""The boundary term of shadows in the light of points, and of parallel light: see `docs/theory/moving-geometry.md`."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import EmitterFlags, Interaction3f, has_flag
from djpt.integrators.projective.detail import FAR, seen_through
from djpt.integrators.projective.outlines import Outlines
from djpt.integrators.projective.receivers import lit_receivers
from djpt.jit.types import Color3f, Point2f, Point3f, UInt32

__all__ = ["ShadowEdges"]


class ShadowEdges:
    """The edges of the shadows that shapes throw in one such light.

    Of the directions in which a silhouette is looked at one is left, that of the light. With y on the outline, n its
    normal, t its tangent, d the direction to the light, which arrives at y with the irradiance E, x the point in shadow
    behind, from which the importance W arrives, s the fraction of the way from x to the light that y lies at, and z the
    place of the light,

        dI = -W E <y' - (1 - s) x' - s z', n> length(t x d) dl,    s = 0 and s z' = abs(x - y) d' in parallel light.
    """

    def __init__(self, scene: Any, light: Any) -> None:
        """Look at the shapes from the place of the light."""
        self._scene, self._moves = scene, light.is_moving()
        # As the view of the scene reads it, whose values may be attached.
        self._light = scene.lights.at(UInt32(scene.emitters().index(light)))
        with dr.suspend_grad():
            infinite = has_flag(light.flags(), EmitterFlags.Infinite)
            self._outlines = Outlines(scene.silhouettes.outlined(), seen_from(scene, self._light, infinite))

    def estimate(self, integrator: Any, sensor: Any, sampler: Any) -> tuple[Color3f, Point2f]:
        """The derivative of the image by random points of the outlines, attached, and their places on the film."""
        scene, sensor = self._scene, seen_through(sensor, sampler)
        with dr.suspend_grad():
            ss = self._outlines.sample(sampler.next_2d())
            active = ss.is_valid() & (ss.pdf > 0)
            it = dr.zeros(Interaction3f)
            it.p = ss.p
            ds, arriving = self._light.sample_direction(it, Point2f(0), active)
            ss.d = ds.d
        receiver, weight, place, active = lit_receivers(integrator, scene, sensor, sampler, ss, ds, arriving, active)
        speed = receiver.speed_at_edge(ds.dist) - dr.dot(self._outlines.follow(ss, active) - ss.p, ss.n)
        if self._moves:
            speed += receiver.speed_by_turn(self._light.sample_direction(it, Point2f(0), active)[0].d, ds.dist)
        return weight * dr.select(active, speed, 0), place


def seen_from(scene: Any, light: Any, infinite: bool) -> Point3f:
    """The place of a light; of one at infinity a point far away."""
    center, radius = scene.bounding_sphere()
    it = dr.zeros(Interaction3f)
    it.p = Point3f(*(float(c) for c in center))
    ds, _ = light.sample_direction(it, Point2f(0))
    return Point3f(it.p + ds.d * (FAR * float(radius))) if infinite else Point3f(ds.p)

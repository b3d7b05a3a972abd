"""The boundary term of shadows in the light of points, of lamps, and in parallel light.

See `docs/theory/moving-geometry.md`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from djpt.core.records import DirectionSample3f, EmitterFlags, Interaction3f, has_flag
from djpt.integrators.projective.detail import seen_through
from djpt.integrators.projective.film_geometry import FAR
from djpt.integrators.projective.outlines import Outlines
from djpt.integrators.projective.receivers import lit_receivers
from djpt.integrators.projective.spread import spread
from djpt.jit.types import Bool, Color3f, Point2f, Point3f, UInt32
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["LampShadows", "ShadowEdges"]


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
            ss, ds, arriving, active = self._lit_outlines(sampler)
            ss.d = ds.d
            active = self._outlines.stops(ss, active)
        receiver, weight, place, active = lit_receivers(integrator, scene, sensor, sampler, ss, ds, arriving, active)
        speed = receiver.speed_at_edge(ds.dist) - dr.dot(self._outlines.follow(ss, active) - ss.p, ss.n)
        if self._moves:
            speed += receiver.speed_by_turn(self._toward_light(ss.p, active)[0].d, ds.dist)
        return weight * dr.select(active, speed, 0), place

    def _lit_outlines(self, sampler: Any) -> tuple[SilhouetteSample3f, DirectionSample3f, Color3f, Bool]:
        """Random points of the outlines, the ways from there to the light, the irradiance, and which of them count."""
        ss = self._outlines.sample(spread(sampler))
        active = ss.is_valid() & (ss.pdf > 0)
        return ss, *self._toward_light(ss.p, active), active

    def _toward_light(self, p: Point3f, active: Bool) -> tuple[DirectionSample3f, Color3f]:
        """The way from points to the light, and the irradiance that arrives there."""
        it = dr.zeros(Interaction3f)
        it.p = p
        found: tuple[DirectionSample3f, Color3f] = self._light.sample_direction(it, Point2f(0), active)
        return found


class LampShadows(ShadowEdges):
    """The edges of the shadows in the light of a lamp: of each of its points z, as of the light of a point.

    With L the radiance that leaves z towards y, theta the angle to the normal there, and the names above,

        dI = -W L cos(theta) / abs(z - y)^2 <y' - (1 - s) x', n> length(t x d) dl dA.

    Points z stay where they are: what x looks at does, whether or not the lamp moves.

    Args:
        scene: the scene; those of its shapes throw shadows whose silhouettes are followed.
        lamp: the lamp, one of `djpt.integrators.projective.receivers.shadowed_lamps`.
    """

    def __init__(self, scene: Any, lamp: Any) -> None:
        self._scene, self._lamp, self._moves = scene, lamp, False
        low, high = lamp.world_box()
        with dr.suspend_grad():
            middle, reach = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
            others = [shape for shape in scene.silhouette_shapes() if shape is not lamp]
            self._outlines = Outlines(others, Point3f(*(float(c) for c in middle)), within=reach)

    def _lit_outlines(self, sampler: Any) -> tuple[SilhouetteSample3f, DirectionSample3f, Color3f, Bool]:
        ps = self._lamp.draw_point(sampler.next_2d())
        ss = self._outlines.sample(spread(sampler), places=Point3f(ps.p))
        active = ss.is_valid() & (ss.pdf > 0)
        ds = dr.zeros(DirectionSample3f)
        way = ps.p - ss.p
        ds.dist = dr.norm(way)
        ds.d = way / ds.dist
        cosine = -dr.dot(ds.d, ps.n)
        active &= cosine > 0
        radiance = self._lamp.emitter().radiance.eval(ps, active)
        return ss, ds, dr.select(active, radiance * (cosine / (dr.square(ds.dist) * ps.pdf)), 0), active


def seen_from(scene: Any, light: Any, infinite: bool) -> Point3f:
    """The place of a light; of one at infinity a point far away."""
    center, radius = scene.bounding_sphere()
    it = dr.zeros(Interaction3f)
    it.p = Point3f(*(float(c) for c in center))
    ds, _ = light.sample_direction(it, Point2f(0))
    return Point3f(it.p + ds.d * (FAR * float(radius))) if infinite else Point3f(ds.p)

"""The boundary term of the sides of a projector's beam, where its light ends: see `docs/theory/moving-geometry.md`."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import DiscontinuityFlags, Interaction3f
from djpt.integrators.projective.detail import seen_through
from djpt.integrators.projective.receivers import lit_receivers
from djpt.integrators.projective.spread import spread
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["BeamSides", "has_sides"]

NEAR = 1e-2
"""The distance from the light of the screen whose edges the sides are sampled by, in radii of the scene."""

INSET = 1e-3
"""How far within the image its edges are looked at, as a fraction of its size: more than rounding moves them."""


def has_sides(light: Any) -> bool:
    """Whether the beam of a light is a pyramid, outside of which there is no light."""
    return hasattr(light, "reach_x")


class BeamSides:
    """The four sides of the beam of a projector: planes through the light.

    A screen close to the light has four edges, which are sampled by length. With y on an edge, t along it, d the
    direction to the light, which arrives at y with the irradiance E, x the point behind, from which the importance W
    arrives, s the fraction of the way from x to the light that y lies at, n the normal of the side towards the beam,
    and u the coordinate on the image that is constant on the side,

        dI = W E (1 - s) (du(x) / dtheta) / (du / dn) length(t x d) dl.

    u is a function of x and of the place of the light, both attached: a surface that slides through the side counts, a
    light that moves, and a camera, whose hits move.
    """

    def __init__(self, scene: Any, light: Any) -> None:
        self._scene, self._plugin = scene, light
        # As the view of the scene reads it, whose values may be attached.
        self._light = scene.lights.at(UInt32(scene.emitters().index(light)))
        self._distance = NEAR * float(scene.bounding_sphere()[1])

    def estimate(self, integrator: Any, sensor: Any, sampler: Any) -> tuple[Color3f, Point2f]:
        """The derivative of the image by random points of the sides, attached, and their places on the film."""
        scene, sensor = self._scene, seen_through(sensor, sampler)
        with dr.suspend_grad():
            ss, upright, sign = self._sample(spread(sampler))
            it = dr.zeros(Interaction3f)
            it.p = ss.p
            ds, arriving = self._light.sample_direction(it, Point2f(0), True)
        receiver, weight, place, active = lit_receivers(integrator, scene, sensor, sampler, ss, ds, arriving, True)
        it.p = receiver.p
        uv = self._light.sample_direction(it, Point2f(0), active)[0].uv
        u = dr.select(upright, uv.x, uv.y)
        _, _, ahead, o, half_x, half_y = self._screen()
        way, reach = dr.detach(it.p) - o, dr.select(upright, half_x, half_y)
        inverse_slope = 2 * reach * dr.dot(way, ahead) * dr.rsqrt(dr.fma(reach, reach, 1)) * sign
        rest = ds.dist * dr.rcp(dr.norm(way))
        speed = dr.select(active, (u - dr.detach(u)) * inverse_slope * rest, 0)
        return weight * speed, place

    def _screen(self) -> tuple[Vector3f, Vector3f, Vector3f, Point3f, Float, Float]:
        """The axes of the light, its place, and half of the sides of its image at the distance 1."""
        light = self._plugin
        values = (light.left, light.up, light.forward, light.position, light.reach_x, light.reach_y)
        left, up, ahead, o, half_x, half_y = (dr.detach(value) for value in values)
        return left, up, ahead, Point3f(o), half_x, half_y

    def _sample(self, sample: Point2f) -> tuple[SilhouetteSample3f, Bool, Float]:
        """A point of an edge of the screen; whether the edge is upright; and on which side of the axis it is."""
        left, up, ahead, o, half_x, half_y = self._screen()
        chance = dr.rcp(1 + half_x * dr.rcp(half_y))
        upright = sample.x < chance
        first = dr.select(upright, sample.x < 0.5 * chance, sample.x < 0.5 * (1 + chance))
        sign = dr.select(first, Float(1), -1)
        along = dr.fma(2, sample.y, -1)
        x = (1 - INSET) * half_x * dr.select(upright, sign, along)
        y = (1 - INSET) * half_y * dr.select(upright, along, sign)
        way = Vector3f(left * x + up * y + ahead)
        length = 4 * (half_x + half_y) * self._distance
        return (
            SilhouetteSample3f(
                p=Point3f(o + way * self._distance),
                d=-dr.normalize(way),
                # Rays start on the edge, not beside it.
                n=Normal3f(0),
                silhouette_d=Vector3f(dr.select(upright, up, left)),
                pdf=Float(dr.rcp(length)),
                discontinuity_type=UInt32(int(DiscontinuityFlags.PerimeterType)),
            ),
            upright,
            sign,
        )

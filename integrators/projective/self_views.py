"""What a shape that moves sees of itself.

The ray from one point of such a shape to another is taken along by the first: its direction stays, and it begins where
that point moves. If the second point stayed instead, as those of other shapes do, the first would pass it at all
distances down to none, at dents and corners, and the change of the solid angle would have no finite variance; so it
would if the second one stuck to the shape. After `MOST_FOLLOWED` such rays in a row, the next one stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.lookup import is_one_of
from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.dispatch.family import NONE
from djpt.jit.types import Bool, Point3f, UInt32, Vector3f
from djpt.shapes.silhouettes.base import with_gradient

__all__ = ["MOST_FOLLOWED", "Approach", "following", "no_rays", "noted", "sees_itself", "self_viewer", "self_viewers"]

MOST_FOLLOWED = 6
"""The longest row of rays that are taken along."""


def self_viewers(scene: Any) -> list[int]:
    """The numbers of the shapes that move, and aren't flat."""
    return [number for number, shape in scene.differentiated if shape.plane() is None]


def self_viewer(scene: Any, number: UInt32, active: Bool | bool) -> UInt32:
    """The numbers of shapes that take such rays along; of others, and on lanes that aren't `active`, `NONE`."""
    still = dr.detach(number)
    return dr.select(Bool(active) & is_one_of(still, self_viewers(scene)), still, UInt32(NONE))


def sees_itself(scene: Any, viewer: UInt32, seen: UInt32, active: Bool | bool) -> Bool:
    """Whether the shapes of two numbers are one and the same, which takes such rays along."""
    still = dr.detach(viewer)
    return Bool(active) & (still == dr.detach(seen)) & is_one_of(still, self_viewers(scene))


def following(ray: Ray3f, p: Point3f, where: Bool) -> Ray3f:
    """A ray whose start moves as a point does, on the lanes `where` it does."""
    o = with_gradient(ray.o, dr.select(where, p, ray.o))
    return Ray3f(o, ray.d, maxt=ray.maxt)


def no_rays(count: int, lanes: int) -> list[tuple[Point3f, Vector3f]]:
    """Places for a number of rays, in arrays."""
    return [(dr.zeros(Point3f, lanes), dr.full(Vector3f, 1, lanes)) for _ in range(count)]


def noted(
    rays: list[tuple[Point3f, Vector3f]], place: UInt32, ray: Ray3f, active: Bool
) -> list[tuple[Point3f, Vector3f]]:
    """The rays, with one more at a place, if it is among them."""
    return [
        (dr.select(active & (place == k), ray.o, o), dr.select(active & (place == k), ray.d, d))
        for k, (o, d) in enumerate(rays)
    ]


@dataclass
class Approach:
    """The last rays of a path from the sensor to a point on a surface."""

    rays: list[tuple[Point3f, Vector3f]]
    """The last one, that before, and so on."""
    count: UInt32
    """How many of them are taken along."""
    from_sensor: Bool
    """Whether the ray before those is the sensor's."""

    def last(self, integrator: Any, scene: Any, shown: Ray3f, active: Bool) -> Ray3f:
        """The last ray, attached to the rays before as far as they are taken along.

        Args:
            integrator: the integrator, which may hide emitters from the sensor.
            scene: the scene.
            shown: the sensor's ray, attached to the sensor.
            active: the lanes that matter.
        """
        first = self.from_sensor
        ray = Ray3f(shown.o, shown.d)
        for number, (o, d) in enumerate(self.rays):
            here = ~first & (self.count == number)
            ray = Ray3f(dr.select(here, o, ray.o), dr.select(here, d, ray.d))
        longest = min(len(self.rays), MOST_FOLLOWED) if self_viewers(scene) else 0
        for number in reversed(range(longest)):
            goes_on = active & (self.count > number)
            si: SurfaceInteraction3f = integrator.first_hit(scene, ray, goes_on, first & (self.count == number + 1))
            onward = following(Ray3f(*self.rays[number]), si.p, goes_on & si.is_valid())
            ray = Ray3f(dr.select(goes_on, onward.o, ray.o), dr.select(goes_on, onward.d, ray.d))
        return ray

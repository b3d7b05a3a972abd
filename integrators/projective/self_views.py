"""What a body that moves, or that the points of a moving camera slide over, sees of itself.

The ray from one point of such a body to another is taken along by the first: its direction stays, and it begins where
that point moves. If the second point stayed instead, as those of other bodies do, the first would pass it at all
distances down to none, at dents and corners, and the change of the solid angle would have no finite variance; so it
would if the second one stuck to the body. After `MOST_FOLLOWED` such rays in a row, the next one stays.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.lookup import is_one_of
from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.dispatch.family import NONE
from djpt.jit.frozen import recording
from djpt.jit.types import Bool, Point3f, UInt32, Vector3f
from djpt.scene.touching_shapes import Bodies, in_touch
from djpt.shapes.silhouettes.base import with_gradient

__all__ = [
    *("MOST_FOLLOWED", "Approach", "body_of", "following", "has_bodies", "no_rays", "noted", "sees_itself"),
    "with_bodies",
]

MOST_FOLLOWED = 6
"""The longest row of rays that are taken along."""


def with_bodies(scene: Any, everywhere: bool) -> Any:
    """A view of the scene in which shapes that touch each other are bodies; but for lamps.

    Any shapes may be taken for one body, so where they can't be asked for their places, all are. Kernels don't depend
    on who touches whom.

    Args:
        scene: the scene.
        everywhere: whether points of paths slide over all shapes, as those that a camera sees, or a mirror shows; else
            over those that move.
    """
    shapes = scene.geometry.contents.shapes
    among = [number for number, shape in enumerate(shapes) if shape.emitter() is None]
    first = [0] * len(among) if recording() else in_touch([shapes[number] for number in among])
    body = dict(zip(among, first, strict=True))
    in_motion = set(first) if everywhere else {body[number] for number, _ in scene.differentiated if number in body}
    sizes = Counter(first)
    alone = {number for number in among if sizes[body[number]] == 1 and shapes[number].plane() is not None}
    numbers = [NONE] * len(shapes)
    for number in {*own_bodies(scene), *among} - alone:
        numbers[number] = among[body[number]] if number in body else number
    slid_over = tuple(number for number in among if number not in alone and body[number] in in_motion)
    return scene.replace(bodies=Bodies(UInt32(numbers), slid_over))


def own_bodies(scene: Any) -> list[int]:
    """The numbers of the shapes that move, and aren't flat: bodies by themselves."""
    return [number for number, shape in scene.differentiated if shape.plane() is None]


def has_bodies(scene: Any) -> bool:
    """Whether rays are taken along at all."""
    return scene.bodies is not None or bool(own_bodies(scene))


def body_of(scene: Any, number: UInt32, active: Bool | bool) -> UInt32:
    """The numbers of the bodies of shapes; `NONE` where they belong to none, and on lanes that aren't `active`."""
    still = dr.detach(number)
    if scene.bodies is None:
        return dr.select(Bool(active) & is_one_of(still, own_bodies(scene)), still, UInt32(NONE))
    return dr.select(active, dr.gather(UInt32, scene.bodies.of_shape, still, active), UInt32(NONE))


def sees_itself(scene: Any, viewer: UInt32, seen: UInt32, active: Bool | bool) -> Bool:
    """Whether the shapes of two numbers belong to one body."""
    body = body_of(scene, viewer, active)
    return (body != NONE) & (body == body_of(scene, seen, active))


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
        longest = min(len(self.rays), MOST_FOLLOWED) if has_bodies(scene) else 0
        for number in reversed(range(longest)):
            goes_on = active & (self.count > number)
            si: SurfaceInteraction3f = integrator.first_hit(scene, ray, goes_on, first & (self.count == number + 1))
            onward = following(Ray3f(*self.rays[number]), si.p, goes_on & si.is_valid())
            ray = Ray3f(dr.select(goes_on, onward.o, ray.o), dr.select(goes_on, onward.d, ray.d))
        return ray

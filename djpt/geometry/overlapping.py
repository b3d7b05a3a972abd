"""Bodies that overlap: the one of the highest priority fills the space that several share.

Two surfaces can't coincide, so water in a glass is modelled as a body that reaches into the wall. The bodies of a
scene are numbered from 1 on by rising priority, and a ray carries a bit mask of those that it is in. A surface counts
as there unless a body with a higher number is around it; where it isn't there it is hidden, and rays pass through it.
That changes the mask and nothing else: the same body fills the space on both sides.

C. Schmidt and B. Budge, "Simple Nested Dielectrics in Ray Traced Images", Journal of Graphics Tools 7, 2002.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from djpt.core.records import RAY_EPSILON, PreliminaryIntersection3f, Ray3f
from djpt.errors import SceneError
from djpt.geometry.aggregate import Geometry, unseen
from djpt.jit.kernels import while_loop, wide
from djpt.jit.types import Bool, Float, UInt32
from djpt.shapes.base import Shape

__all__ = ["MOST_BODIES", "OUTSIDE", "OverlappingGeometry", "bit_of", "highest_body"]

FREE_BITS = 8
"""The number of the lowest bits of a mask, which hold a medium: see `djpt.scene.overlapping_media`."""

OUTSIDE = 2**FREE_BITS - 1
"""The mask of these bits."""

MOST_BODIES = 32 - FREE_BITS
"""The most bodies of a scene."""


def bit_of(number: UInt32) -> UInt32:
    """The bit that stands for a body, given by its number from 1 on; 0 for the number 0, which is none."""
    return (UInt32(1) << (number + (FREE_BITS - 1))) & ~UInt32(OUTSIDE)


def highest_body(mask: UInt32) -> UInt32:
    """The highest number among the bodies of a mask; 0 if there is none."""
    return 32 - dr.lzcnt(mask >> FREE_BITS)


def is_body(shape: Shape) -> bool:
    """Whether a shape is one of the bodies: it has a priority, or bounds a medium."""
    if unseen(shape):
        return False
    return shape.priority is not None or shape.is_medium_transition() or bool(shape.bsdf().absorbs)


Passes = Callable[[UInt32, UInt32], Bool]
"""Whether a ray passes through a surface, from the mask of its bodies and the number of the surface's body."""


STEP = 2.0**-21
"""The least step past a hidden surface, relative to its distance: a few units in the last place."""


@dataclass
class Search:
    """Loop state of a ray on its way to the first surface that isn't hidden."""

    t: Float
    """The distance of the surface that was found last, from the ray's origin; infinite if there is none."""
    face: UInt32
    near: Any
    medium: UInt32
    """The mask of the bodies that the ray is in before that surface."""
    passes: Bool
    """True if the ray goes on through the surface."""


class OverlappingGeometry(Geometry):
    """The shapes of a scene with priorities. Rays that carry a mask of bodies pass through hidden surfaces.

    The mask is the `medium` of a ray; rays without one hit all surfaces. Bodies are the shapes that have a priority or
    bound a medium, whose priority is 0 by default; of those with the same priority the one that comes first in the
    scene wins.

    Raises:
        SceneError: A body isn't closed, is in a `shapegroup`, has an exterior medium, or a BSDF other than
            `dielectric`, `glass`, `roughdielectric` or `null`; or there are more than `MOST_BODIES`.
    """

    overlaps: ClassVar[bool] = True

    def _number(self) -> None:
        super()._number()
        self._number_bodies()

    def follow_bsdfs(self) -> None:
        super().follow_bsdfs()
        self._number_bodies()

    def _number_bodies(self) -> None:
        shapes = self.contents.shapes
        bodies = [i for i, shape in enumerate(shapes) if is_body(shape)]
        check_bodies([shapes[i] for i in bodies])
        self.bodies = sorted(bodies, key=lambda i: (shapes[i].priority or 0.0, -i))
        """The indices of the bodies' shapes by rising priority; the first has the number 1."""
        numbers = [0] * len(shapes)
        for number, index in enumerate(self.bodies):
            numbers[index] = number + 1
        self.number_of_face = self.per_face(numbers)
        """The number of the body that a face belongs to, or 0."""

    # ---- ray queries -----------------------------------------------------------------

    def closest(self, ray: Ray3f, through_lights: Bool | None = None) -> PreliminaryIntersection3f:
        if ray.medium is None:
            return super().closest(ray, through_lights)
        end = self._search(ray, through_lights)
        hit = PreliminaryIntersection3f.found(end.t, end.face, self.shape_of(end.face), end.near)
        hit.media = (end.medium,)
        return hit

    def any_hit(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        if ray.medium is None:
            return super().any_hit(ray, active)
        return self.closest(only_where(ray, active)).is_valid()

    def blocked(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        return self.any_hit(ray, active)

    def bodies_at(self, ray: Ray3f, t: Float, active: Bool) -> UInt32:
        """The mask of the bodies that a ray is in at a distance t, up to which it meets hidden surfaces only."""
        return self._search(only_where(ray.replaced(maxt=t), active), None).medium

    def bodies_around(self, ray: Ray3f) -> UInt32:
        """The mask of the bodies around a ray's origin: those whose surfaces the ray crosses an odd number of times."""

        def all_pass(medium: UInt32, number: UInt32) -> Bool:
            return Bool(True)

        return self._search(ray.replaced(media=(UInt32(0),)), None, all_pass).medium

    @property
    def searches_pairs(self) -> bool:
        return False

    @property
    def stepwise(self) -> bool:
        return False

    def _search(self, ray: Ray3f, through_lights: Bool | None, passes: Passes | None = None) -> Search:
        """The first surface that a ray doesn't pass, by default the first that isn't hidden."""
        passes = is_hidden if passes is None else passes

        def found(start: Float, medium: UInt32) -> Search:
            # Shapes compare the bits of distances: no end may be negative.
            onwards = ray.replaced(o=ray(start), maxt=dr.maximum(ray.maxt - start, 0))
            hit = Geometry.closest(self, onwards, through_lights)
            valid = hit.is_valid()
            hidden = valid & passes(medium, self.number_of_face.at(hit.face))
            return Search(dr.select(valid, hit.t + start, dr.inf), hit.face, hit.near, medium, hidden)

        def go_on(search: Search) -> tuple[Search]:
            t = dr.select(search.passes, search.t, 0)
            step = RAY_EPSILON * (1 + dr.max(dr.abs(ray(t)))) * dr.rsqrt(dr.squared_norm(ray.d))
            # Where a ray comes from afar, that may be less than a distance can tell apart.
            step = dr.maximum(step, t * STEP)
            return (found(t + step, search.medium ^ bit_of(self.number_of_face.at(search.face))),)

        assert ray.medium is not None
        first = wide(found(Float(0), ray.medium), dr.width(ray))
        (end,) = while_loop((first,), lambda search: search.passes, go_on, label="hidden surfaces")
        return end


def is_hidden(mask: UInt32, number: UInt32) -> Bool:
    """True at surfaces of the body with this number if a ray is in one with a higher number; number 0 is no body."""
    return (number > 0) & (highest_body(mask) > number)


def only_where(ray: Ray3f, active: Bool | bool) -> Ray3f:
    """A ray that meets nothing where it isn't active."""
    return ray if active is True else ray.replaced(maxt=dr.select(active, ray.maxt, 0))


def check_bodies(bodies: Sequence[Shape]) -> None:
    """Raise `SceneError` unless shapes can be bodies that overlap."""
    if len(bodies) > MOST_BODIES:
        raise SceneError(
            f"found {len(bodies)} shapes that have a 'priority' or bound a medium; where bodies overlap, at most "
            f"{MOST_BODIES} are possible"
        )
    for shape in bodies:
        why = None
        if not shape.is_closed():
            why = "must be closed"
        elif shape.in_group:
            why = "can't be in a 'shapegroup'"
        elif shape.exterior_medium() is not None:
            why = "can't have an 'exterior': what is around it follows from the other bodies"
        elif not shape.bsdf().bounds_bodies:
            why = f"can't have the BSDF '{shape.bsdf().id()}': possible: dielectric, glass, roughdielectric, null"
        if why is not None:
            raise SceneError(f"{shape.id()}: where bodies overlap, a shape with a 'priority' or a medium {why}")

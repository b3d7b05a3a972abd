"""Bodies that overlap: where several claim the same space, the one of the highest priority fills it.

Water in a glass is modelled as a body that reaches into the wall: two surfaces can't coincide. The bodies of a scene
are numbered from 1 on by rising priority, and a ray carries the set of those that it is in, as the bits of a word. A
surface is there only where no body with a higher number is around it. Rays pass all others, which change the set and
nothing else: the body that fills the space before such a surface fills it behind.

C. Schmidt and B. Budge, "Simple Nested Dielectrics in Ray Traced Images", 2002.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from djpt.core.records import RAY_EPSILON, PreliminaryIntersection3f, Ray3f
from djpt.errors import SceneError
from djpt.geometry.aggregate import Geometry, unseen
from djpt.jit.kernels import while_loop, wide
from djpt.jit.types import Bool, Float, UInt32
from djpt.shapes.base import Shape

__all__ = ["MOST_BODIES", "OUTSIDE", "OverlappingGeometry", "bit_of", "first_of"]

DIGITS = 8
"""The lowest bits of a word, which are free for others: see `djpt.scene.overlapping_media`."""

OUTSIDE = 2**DIGITS - 1
"""These bits."""

MOST_BODIES = 32 - DIGITS
"""The most bodies of a scene."""


def bit_of(number: UInt32) -> UInt32:
    """The bit that stands for a body, given by its number from 1 on; 0 for the number 0, which is none."""
    return (UInt32(1) << (number + (DIGITS - 1))) & ~UInt32(OUTSIDE)


def first_of(word: UInt32) -> UInt32:
    """The highest number among the bodies of a word; 0 if there is none."""
    return 32 - dr.lzcnt(word >> DIGITS)


def belongs(shape: Shape) -> bool:
    """Whether a shape is one of the bodies: it has a priority, or bounds a medium."""
    if unseen(shape):
        return False
    return shape.priority is not None or shape.is_medium_transition() or bool(shape.bsdf().absorbs)


@dataclass
class Search:
    """A ray on its way to the first surface that is there: loop state."""

    t: Float
    """The distance of the surface at hand, from the ray's origin; infinite if there is none."""
    face: UInt32
    near: Any
    medium: UInt32
    """The word of the ray on its way there."""
    passes: Bool
    """True if the surface isn't there."""


class OverlappingGeometry(Geometry):
    """The shapes of a scene with priorities. Rays with the word of their bodies see what is there.

    The word is the `medium` of a ray; those without hit all surfaces. Bodies are the shapes that have a priority or
    bound a medium, whose priority is 0 by default; of those with the same priority the one that comes first in the
    scene wins.
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
        bodies = [i for i, shape in enumerate(shapes) if belongs(shape)]
        check([shapes[i] for i in bodies])
        self.bodies = sorted(bodies, key=lambda i: (shapes[i].priority or 0.0, -i))
        """The indices of the bodies' shapes; the first has the number 1."""
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
        return self.closest(where(ray, active)).is_valid()

    def blocked(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        return self.any_hit(ray, active)

    def word_at(self, ray: Ray3f, t: Float, active: Bool) -> UInt32:
        """The word of a ray at a distance, up to which no surface is there."""
        return self._search(where(ray.replaced(maxt=t), active), None).medium

    def crossed(self, ray: Ray3f) -> UInt32:
        """The bits of the bodies whose surfaces a ray without end crosses an odd number of times."""

        def all_pass(medium: UInt32, number: UInt32) -> Bool:
            return Bool(True)

        return self._search(ray.replaced(media=(UInt32(0),)), None, all_pass).medium

    @property
    def searches_pairs(self) -> bool:
        return False

    @property
    def stepwise(self) -> bool:
        return False

    def _search(self, ray: Ray3f, through_lights: Bool | None, passes: Any = None) -> Search:
        """The first surface that a ray doesn't pass, by default the first that is there."""
        passes = is_hidden if passes is None else passes

        def found(start: Float, medium: UInt32) -> Search:
            onwards = ray.replaced(o=ray(start), maxt=ray.maxt - start)
            hit = Geometry.closest(self, onwards, through_lights)
            valid = hit.is_valid()
            hidden = valid & passes(medium, self.number_of_face.at(hit.face))
            return Search(dr.select(valid, hit.t + start, dr.inf), hit.face, hit.near, medium, hidden)

        def go_on(search: Search) -> tuple[Search]:
            t = dr.select(search.passes, search.t, 0)
            step = RAY_EPSILON * (1 + dr.max(dr.abs(ray(t)))) * dr.rsqrt(dr.squared_norm(ray.d))
            return (found(t + step, search.medium ^ bit_of(self.number_of_face.at(search.face))),)

        assert ray.medium is not None
        first = wide(found(Float(0), ray.medium), dr.width(ray))
        (end,) = while_loop((first,), lambda search: search.passes, go_on, label="hidden surfaces")
        return end


def is_hidden(medium: UInt32, number: UInt32) -> Bool:
    """True at surfaces of a body, of this number, where one with a higher number is around them."""
    return (number > 0) & (first_of(medium) > number)


def where(ray: Ray3f, active: Bool | bool) -> Ray3f:
    """A ray that meets nothing where it isn't active."""
    return ray if active is True else ray.replaced(maxt=dr.select(active, ray.maxt, -1))


def check(bodies: Sequence[Shape]) -> None:
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

"""What arrives of light along a segment, past the surfaces and through the media of a scene."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import PreliminaryIntersection3f, Ray3f
from djpt.jit.types import Bool, Color3f
from djpt.scene.media_queries import MediaQueries

__all__ = ["VisibilityQueries"]


class VisibilityQueries(MediaQueries):
    """The part of a scene that follows light from one point to another."""

    def closest_hit(
        self, ray: Ray3f, active: Bool | bool = True, *, through_lights: Bool | None = None
    ) -> PreliminaryIntersection3f:
        """The face that a ray hits first, and the distance."""
        raise NotImplementedError

    def light_through(self, ray: Ray3f, light: Color3f | None = None, lit: Bool | None = None) -> Color3f:
        """The part of `light` (default 1) that arrives along the segment of a `shadow_ray`.

        It is 0 behind a surface, else the share that media leave. Faster than `ray_test`: shapes that can't shadow
        anything are left out. Only where there is light surfaces are looked for, and where `lit`: black light may have
        derivatives.
        """
        left = self.left_by_media(ray, Color3f(1) if light is None else light)
        shines = dr.max(left) > 0
        return dr.select(self.geometry.blocked(ray, shines if lit is None else shines | lit), 0, left)

    def light_between(
        self, ray: Ray3f, light: Color3f, through_lights: Bool | bool = False, lit: Bool | None = None
    ) -> Color3f:
        """The part of `light` that arrives along the segment of a ray between any two points.

        Unlike `light_through` it leaves out no shape, because the walls around a scene and a single lamp can hide a
        surface from a camera or from another surface. Where `through_lights` is true shapes that emit hide nothing.
        """
        shines = dr.max(light) > 0
        if through_lights is not False:
            free = ~self.closest_hit(ray, through_lights=Bool(through_lights)).is_valid()
        else:
            free = ~self.geometry.any_hit(ray, shines if lit is None else shines | lit)
        return dr.select(free, self.left_by_media(ray, light), 0)

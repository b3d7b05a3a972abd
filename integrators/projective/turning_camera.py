"""What becomes of an image as its pinhole camera turns or zooms: rays stay, and so does all that they meet.

What moves is their place on the film: see "Cameras that turn" in `docs/theory/moving-geometry.md`. No surface matters,
however smooth, and no outline: an image is moved and stretched as a whole, and changes at its border.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.integrators.projective.moving_camera import Samples, at_borders, within
from djpt.integrators.projective.reattach import relative
from djpt.jit.types import Color3f, Float, Point2f, Point3f, TensorXf, Vector3f

__all__ = ["StillRay", "StillRays"]

AHEAD = 2.0
"""The distance at which a direction's place on the film is asked for, in those of the near plane."""


@dataclass
class StillRay:
    """Rays that stay, and the light that they bring."""

    d: Vector3f
    radiance: Color3f

    def place(self, camera: Any) -> Point3f:
        """Points on the rays."""
        return Point3f(dr.detach(dr.fma(self.d, AHEAD * camera.near / dr.dot(self.d, camera.axis), camera.origin)))

    def attached(self, scene: Any, camera: Any, chance: Float) -> tuple[Color3f, Point2f]:
        """The radiance by the density of rays, and their place on the crop window, [0, 1)^2, attached to the camera."""
        ds, importance = camera.sample_wi(self.place(camera), Point2f(0))
        return self.radiance * relative(importance), ds.uv


class StillRays(Samples):
    """Such rays; the integrator is a projective one."""

    @staticmethod
    def terms() -> Sequence[Callable[[Samples], TensorXf]]:
        return within, at_borders

    def first_vertices(self, camera: Any, sampler: Any, place: Point2f) -> Sequence[StillRay]:
        with dr.suspend_grad():
            ray = dr.detach(camera.ray_through(place, Point2f(0)))
            found = StillRay(ray.d, self.integrator.shade(self.scene, sampler, ray, 0, None, True))
            dr.eval(found)
            return [found]

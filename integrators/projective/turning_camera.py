"""What becomes of an image as its pinhole camera turns or zooms: rays stay, and so does all that they meet.

What moves is their place on the film: see "Cameras that turn" in `docs/theory/moving-geometry.md`. No surface matters,
however smooth, and no outline: an image is moved and stretched as a whole, and changes at its border.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.integrators.projective.film_geometry import way_ahead
from djpt.integrators.projective.moving_camera import Samples, at_borders, within
from djpt.integrators.projective.reattach import relative
from djpt.jit.types import Color3f, Float, Point2f, Point3f, TensorXf, Vector3f
from djpt.sensors.moving import has_motion, shifting, still, turning

__all__ = ["StillRay", "StillRays", "turned_apart"]


@dataclass
class StillRay:
    """Rays that stay, and the light that they bring."""

    d: Vector3f
    radiance: Color3f

    def place(self, camera: Any) -> Point3f:
        """Points on the rays."""
        return Point3f(dr.detach(camera.origin) + way_ahead(camera, self.d))

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


def turned_apart(scene: Any, camera: Any, forward: bool) -> tuple[Any, Any]:
    """A view of a camera, or of a batch, that turns or zooms about its centre, or None; and one that moves by all else.

    Args:
        scene: the scene.
        camera: the camera.
        forward: whether gradients are propagated forward, so that those of 0 count as none.
    """
    if scene.in_time or not all(map(is_pinhole, camera.members())):
        return None, camera
    turned, rest = turning(camera), shifting(camera)
    if not has_motion(turned, forward):
        return None, camera
    return turned, rest if has_motion(rest, forward) else still(camera)


def is_pinhole(camera: Any) -> bool:
    """Whether all rays go through a centre that stays in time, and their density is attached to what places them."""
    pinhole: bool = camera.is_central and camera.density_moves and not (camera.uses_aperture or camera.moves)
    return pinhole and not camera.film().sample_border()

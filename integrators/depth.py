"""Distance to the first surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.description.registry import register_integrator
from djpt.integrators.base import Integrator
from djpt.jit.types import Bool, Color3f, Float
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Depth"]


class Depth(Integrator):
    """Distance along the camera ray from the near plane, as a grey colour; 0 on a miss.

    Mitsuba measures from the near plane too: add near_clip / cos for the distance from the camera.
    """

    pure = True
    in_any_frame = True

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        pi = scene.closest_hit(ray, active)
        valid = pi.is_valid()
        t = pi.t if scene.units is None else scene.units.length(pi.t)
        return Color3f(dr.select(valid, t, 0)), valid, []


register_integrator("depth", Depth)

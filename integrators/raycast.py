"""Ray casting: the first visible surface, shaded by its orientation."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import BSDFFlags, Ray3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.integrators.base import Integrator
from djpt.jit.kernels import minimum
from djpt.jit.types import Bool, Color3f, Float
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Raycast"]


def headlight(si: SurfaceInteraction3f) -> Color3f:
    """Light from a lamp at the eye that doesn't fade: albedo (at most 1) times cosine. Mirrors and panes are white."""
    bsdf = si.bsdf()
    albedo = dr.select(has_flag(bsdf.flags(), BSDFFlags.Smooth), bsdf.eval_diffuse_reflectance(si), 1)
    return Color3f(*(minimum(c, Float(1)) for c in albedo)) * dr.abs(si.wi.z)


def normal(si: SurfaceInteraction3f) -> Color3f:
    """The shading normal as a colour: (n + 1) / 2."""
    return Color3f(0.5 * (si.sh_frame.n + 1))


SHADINGS: dict[str, Callable[[SurfaceInteraction3f], Color3f]] = {"headlight": headlight, "normal": normal}


class Raycast(Integrator):
    """The first surface along each ray, shaded without any light.

    `headlight`: L = albedo abs(cos theta), theta between the normal and the direction to the eye. `normal`:
    L = (n + 1) / 2, n the shading normal in world space. Where nothing is met: the environment, else black.

    Leaves out lights, shadows, reflections and all indirect light; needs one ray per sample.

    Parameters: `shading` (`headlight` or `normal`, default `headlight`), `hide_emitters` (which hides the environment).

    A. Appel, "Some techniques for shading machine renderings of solids", AFIPS 1968.
    """

    pure = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.shading = props.string("shading", "headlight", choices=SHADINGS)

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        si = scene.ray_intersect(ray, active)
        hit = si.is_valid() & active
        sky = Color3f(0) if self.hide_emitters else si.emitter(scene).eval(si)
        return dr.select(hit, SHADINGS[self.shading](si), dr.select(active, sky, 0)), hit, []


register_integrator("raycast", Raycast)

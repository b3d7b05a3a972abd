"""The volumetric path tracer with the parameters of Mitsuba's differentiable one."""

from __future__ import annotations

from djpt.description.registry import register_integrator
from djpt.integrators.volpath import VolumetricPath

__all__ = ["PRBVolumetricPath"]


class PRBVolumetricPath(VolumetricPath):
    """`volpath` with the default `max_depth` 6.

    Its derivatives are those of `volpath`, by path replay: by albedos, phase functions, emission and materials, and by
    the extinction of media, texel by texel if it is a grid. Texels without density have derivatives, too.
    """

    pure = True
    in_any_frame = True

    default_max_depth = 6


register_integrator("prbvolpath", PRBVolumetricPath)

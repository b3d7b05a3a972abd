"""Circular polarisers."""

from __future__ import annotations

from djpt.core.records import SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.types import Bool, Color3f
from djpt.materials.filters import Filter

__all__ = ["Circular"]


class Circular(Filter):
    """A circular polariser: half of unpolarised light passes. See `Filter`.

    Parameters: `transmittance` (texture in [0, 1], default 1) and `left_handed` (default false), which has no effect
    on light without polarisation.
    """

    in_any_frame = True
    symmetric = True
    share = 0.5

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        props.boolean("left_handed", False)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The transmittance, as in Mitsuba."""
        return self.passed.eval(si, active)


register_bsdf("circular", Circular)

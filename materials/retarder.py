"""Linear retarders, such as quarter-wave plates."""

from __future__ import annotations

from djpt.core.records import BSDFFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.materials.filters import Filter

__all__ = ["Retarder"]


class Retarder(Filter):
    """A plate that delays one direction of oscillation: all unpolarised light passes. See `Filter`.

    Parameters: `transmittance` (texture in [0, 1], default 1), `theta` (degrees, default 0) and `delta` (degrees,
    default 90). The last two have no effect on light without polarisation.
    """

    in_any_frame = True
    symmetric = True
    children = ("theta", "delta", "passed")
    lobe = int(BSDFFlags.Null | BSDFFlags.FrontSide | BSDFFlags.BackSide | BSDFFlags.Anisotropic)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.theta = props.texture("theta", 0.0)
        self.delta = props.texture("delta", 90.0)


register_bsdf("retarder", Retarder)

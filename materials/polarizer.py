"""Linear polarisers."""

from __future__ import annotations

from djpt.core.records import BSDFFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.materials.filters import Filter

__all__ = ["Polarizer"]


class Polarizer(Filter):
    """A linear polariser: half of unpolarised light passes. See `Filter`.

    Parameters: `transmittance` (texture in [0, 1], default 1), `theta` (degrees, default 0) and `polarizing` (default
    true). The last two have no effect on light without polarisation.
    """

    in_any_frame = True
    symmetric = True
    children = ("theta", "passed")
    share = 0.5
    lobe = int(BSDFFlags.Null | BSDFFlags.FrontSide | BSDFFlags.BackSide | BSDFFlags.Anisotropic)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.theta = props.texture("theta", 0.0)
        props.boolean("polarizing", True)


register_bsdf("polarizer", Polarizer)

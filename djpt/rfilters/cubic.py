"""The cubic filters of Mitchell and Netravali, and Catmull-Rom's as a member of the family.

D. Mitchell and A. Netravali, "Reconstruction Filters in Computer Graphics", SIGGRAPH 1988.
"""

from __future__ import annotations

from typing import Any

from djpt.description.properties import Properties
from djpt.description.registry import register_rfilter
from djpt.jit.kernels import Arithmetic
from djpt.rfilters.base import ReconstructionFilter

__all__ = ["CatmullRom", "Mitchell"]


class Mitchell(ReconstructionFilter):
    """The piecewise cubic of radius 2 with the shape parameters B and C.

    Parameters: `B` (default 1/3), `C` (default 1/3). Has negative lobes, so pixels may overshoot.
    """

    reach = 2.0
    statics = ("b", "c")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.b = props.float("B", 1 / 3)
        self.c = props.float("C", 1 / 3)

    def formula(self, m: Arithmetic, x: Any) -> Any:
        b, c = self.b, self.c
        x = m.abs(x)
        near = ((12 - 9 * b - 6 * c) * x + (-18 + 12 * b + 6 * c)) * (x * x) + (6 - 2 * b)
        far = (((-b - 6 * c) * x + (6 * b + 30 * c)) * x + (-12 * b - 48 * c)) * x + (8 * b + 24 * c)
        return m.select(x < 1, near, m.select(x < 2, far, 0)) * (1 / 6)


class CatmullRom(Mitchell):
    """The cubic with B = 0, C = 1/2: it interpolates, is sharper than `mitchell`, and rings more. No parameters."""

    def __init__(self, props: Properties) -> None:
        ReconstructionFilter.__init__(self, props)
        self.b, self.c = 0.0, 0.5


register_rfilter("mitchell", Mitchell)
register_rfilter("catmullrom", CatmullRom)

"""The tent filter."""

from __future__ import annotations

import drjit as dr

from djpt.description.properties import Properties
from djpt.description.registry import register_rfilter
from djpt.rfilters.base import ReconstructionFilter
from djpt.types import Float

__all__ = ["Tent"]


class Tent(ReconstructionFilter):
    """max(0, 1 - abs(x) / radius).

    Parameters: `radius` (pixels, default 1).
    """

    statics = ("radius",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.radius = props.float("radius", 1.0, low=0.0, low_open=True, high=16.0)

    def eval(self, x: Float) -> Float:
        w = 1 - dr.abs(x) * (1 / self.radius)
        return dr.select(w > 0, w, 0)


register_rfilter("tent", Tent)

"""The box filter."""

from __future__ import annotations

import drjit as dr

from djpt.description.properties import Properties
from djpt.description.registry import register_rfilter
from djpt.jit.types import Bool, Float
from djpt.rfilters.base import ReconstructionFilter

__all__ = ["Box"]


class Box(ReconstructionFilter):
    """The constant 1 within half a pixel: the pixel is the mean of its own samples.

    Films treat it specially (no sample reaches a neighbour), so it is also the fastest.
    """

    reach = 0.5
    has_lobes = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)

    def eval(self, x: Float, active: Bool | bool = True) -> Float:
        return dr.select((x >= -0.5) & (x < 0.5), Float(1), 0)


register_rfilter("box", Box)

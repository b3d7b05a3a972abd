"""The tent filter."""

from __future__ import annotations

from typing import Any

from djpt.description.properties import Properties
from djpt.description.registry import register_rfilter
from djpt.jit.kernels import Arithmetic
from djpt.rfilters.base import ReconstructionFilter

__all__ = ["Tent"]


class Tent(ReconstructionFilter):
    """max(0, 1 - abs(x) / radius).

    Parameters: `radius` (pixels, default 1).
    """

    statics = ("reach",)
    has_lobes = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.reach = props.float("radius", 1.0, low=0.0, low_open=True, high=16.0)

    def formula(self, m: Arithmetic, x: Any) -> Any:
        w = 1 - m.abs(x) * (1 / self.reach)
        return m.select(w > 0, w, 0)


register_rfilter("tent", Tent)

"""The place where scripts look for differentiable integrators, to use or to derive from."""

from __future__ import annotations

from djpt.ad.integrators import common as common
from djpt.ad.integrators import prb as prb
from djpt.ad.integrators import prb_basic as prb_basic

__all__ = ["common", "prb", "prb_basic"]

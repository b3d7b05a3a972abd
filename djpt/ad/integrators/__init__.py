"""The place where scripts look for base classes of differentiable integrators."""

from __future__ import annotations

from djpt.ad.integrators import common as common

__all__ = ["common"]

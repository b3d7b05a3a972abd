"""Mitsuba's place of the base classes in `djpt.scripting.ad_integrators`, and of what their samples are weighted by."""

from __future__ import annotations

from djpt.integrators.base import mis_weight
from djpt.scripting.ad_integrators import ADIntegrator, RBIntegrator

__all__ = ["ADIntegrator", "RBIntegrator", "mis_weight"]

"""Mitsuba's place of the base classes in `djpt.scripting.ad_integrators`."""

from __future__ import annotations

from djpt.scripting.ad_integrators import ADIntegrator, RBIntegrator

__all__ = ["ADIntegrator", "RBIntegrator"]

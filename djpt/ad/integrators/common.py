"""Mitsuba's place of the base classes of differentiable integrators, and of what they compute with."""

from __future__ import annotations

from djpt.ad.integrators.projective_sampling import PSIntegrator
from djpt.ad.integrators.weights import mis_weight, solid_angle_to_area_jacobian
from djpt.scripting.ad_integrators import ADIntegrator, RBIntegrator

__all__ = ["ADIntegrator", "PSIntegrator", "RBIntegrator", "mis_weight", "solid_angle_to_area_jacobian"]

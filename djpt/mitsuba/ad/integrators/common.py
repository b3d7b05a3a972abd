"""Mitsuba's module of base classes of differentiable integrators, and of functions that these use."""

from __future__ import annotations

from djpt.integrators.ad_integrator import ADIntegrator, RBIntegrator
from djpt.integrators.projective.projective_sampling import PSIntegrator
from djpt.integrators.projective.weights import mis_weight, solid_angle_to_area_jacobian

__all__ = ["ADIntegrator", "PSIntegrator", "RBIntegrator", "mis_weight", "solid_angle_to_area_jacobian"]

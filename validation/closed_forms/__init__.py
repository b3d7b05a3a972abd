"""Scenes whose radiance is known by formula, and the comparison of integrators with it."""

from djpt.validation.closed_forms.cases import CASES, ClosedForm
from djpt.validation.closed_forms.run import Outcome, validate

__all__ = ["CASES", "ClosedForm", "Outcome", "validate"]

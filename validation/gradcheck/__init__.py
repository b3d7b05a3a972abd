"""The check of gradients: reverse mode against forward mode, finite differences and Mitsuba."""

from djpt.validation.gradcheck.check import GradientCheck, Verdict, check_gradient

__all__ = ["GradientCheck", "Verdict", "check_gradient"]

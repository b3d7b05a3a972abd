"""The check of gradients: reverse mode against forward mode, finite differences and Mitsuba."""

from djpt.validation.gradcheck.check import GradientCheck, check_gradient
from djpt.validation.gradcheck.verdicts import Verdict

__all__ = ["GradientCheck", "Verdict", "check_gradient"]

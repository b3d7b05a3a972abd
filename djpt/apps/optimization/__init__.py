"""Parameters of scenes from pictures: `optimize`, a thin layer over `drjit.opt`, and the uncertainty of its results."""

from djpt.apps.optimization.confidence import Confidence, confidence
from djpt.apps.optimization.frameworks import jax_function, torch_module
from djpt.apps.optimization.gauss_newton import GaussNewton
from djpt.apps.optimization.least_squares import LeastSquares, least_squares
from djpt.apps.optimization.live import Progressed
from djpt.apps.optimization.loop import Optimization, optimize

__all__ = [
    "Confidence",
    "GaussNewton",
    "LeastSquares",
    "Optimization",
    "Progressed",
    "confidence",
    "jax_function",
    "least_squares",
    "optimize",
    "torch_module",
]

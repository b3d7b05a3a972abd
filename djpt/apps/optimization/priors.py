"""Priors: assumptions about a texture that don't come from the pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.errors import ParameterError, near_miss

__all__ = ["PRIORS", "Prior", "curvature_of", "prior_of"]

Doubles = npt.NDArray[np.float64]
Prior = Callable[[Any], Any]
"""A function of a parameter that returns one number, which is added to the loss."""

SMALL = 1e-3
"""The difference of texels below which total variation is smoothed."""


def smoothness(texture: Any) -> Any:
    """The mean squared difference of neighbouring texels: edges become soft."""
    return sum(dr.mean(dr.square(d), axis=None) for d in differences(texture))


def total_variation(texture: Any) -> Any:
    """The mean absolute difference of neighbouring texels: flat areas with sharp edges (Rudin, Osher and Fatemi 1992).

    It is sqrt(d^2 + 1e-6) rather than |d|, so that it has derivatives everywhere.
    """
    return sum(dr.mean(dr.sqrt(dr.square(d) + SMALL**2), axis=None) for d in differences(texture))


def differences(texture: Any) -> tuple[Any, Any]:
    """The differences of neighbours along the rows and along the columns of a texture (H, W, C)."""
    if not dr.is_tensor_v(texture) or len(texture.shape) != 3:
        raise ParameterError("priors on neighbours apply to textures only (height, width, channels)")
    return texture[1:, :, :] - texture[:-1, :, :], texture[:, 1:, :] - texture[:, :-1, :]


def curvature(texels: Doubles, bend: Callable[[Doubles], Doubles]) -> Doubles:
    """A diagonal that bounds the curvature of a mean of functions of the differences of neighbours.

    A difference that has the curvature c gives 2 c to both of its texels, since (x - y)^2 <= 2 x^2 + 2 y^2.
    """
    total = np.zeros_like(texels)
    for axis in (0, 1):
        change = np.diff(texels, axis=axis)
        bent = 2 * bend(change) / max(change.size, 1)
        ahead, behind = [(0, 0)] * 3, [(0, 0)] * 3
        ahead[axis], behind[axis] = (1, 0), (0, 1)
        total += np.pad(bent, ahead) + np.pad(bent, behind)
    return total


def smooth_bend(change: Doubles) -> Doubles:
    """The curvature of d^2."""
    return np.full_like(change, 2.0)


def tv_bend(change: Doubles) -> Doubles:
    """The curvature of the parabola that lies above sqrt(d^2 + s^2) and touches it at d."""
    return 1 / np.sqrt(np.square(change) + SMALL**2)


PRIORS: dict[str, Prior] = {"smooth": smoothness, "tv": total_variation}
"""The priors by name."""

BENDS = {"smooth": smooth_bend, "tv": tv_bend}
"""Bounds on the curvature of the priors as functions of one difference."""


def prior_of(prior: str | Prior) -> Prior:
    """A prior by its name, or the function itself.

    Raises:
        ParameterError: The name is unknown.
    """
    if callable(prior):
        return prior
    if prior not in PRIORS:
        raise ParameterError(f"unknown prior '{prior}'{near_miss(str(prior), PRIORS)}")
    return PRIORS[prior]


def curvature_of(prior: str | Prior) -> Callable[[Doubles], Doubles]:
    """The bound on the curvature of a prior: texels (H, W, C) to as many numbers.

    Raises:
        ParameterError: The prior is a function, whose curvature is unknown.
    """
    if callable(prior):
        raise ParameterError("'gauss_newton' supports only the priors 'smooth' and 'tv', found a function")
    prior_of(prior)
    bend = BENDS[prior]
    return lambda texels: curvature(texels, bend)

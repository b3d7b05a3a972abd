"""Priors: what is thought of a texture before any picture is seen."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.errors import ParameterError, near_miss

__all__ = ["PRIORS", "Prior", "prior_of"]

Prior = Callable[[Any], Any]
"""Called with a parameter; gives one number that is added to the loss."""

SMALL = 1e-3
"""The difference of texels below which total variation is smooth."""


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
        raise ParameterError("priors of neighbours are for textures (height, width, channels)")
    return texture[1:, :, :] - texture[:-1, :, :], texture[:, 1:, :] - texture[:, :-1, :]


PRIORS: dict[str, Prior] = {"smooth": smoothness, "tv": total_variation}
"""The priors by name."""


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

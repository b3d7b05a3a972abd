"""Losses: the distance of an image from its target."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.errors import RenderError, near_miss

__all__ = ["LOSSES", "RESIDUALS", "Loss", "loss_of", "residual_of"]

Loss = Callable[[Any, Any], Any]
"""A function of an image and its target, (H, W, C) each, that returns one Dr.Jit number."""

DARK = 1e-2
"""The offset that keeps dark pixels from dominating relative losses."""


def difference(image: Any, target: Any) -> Any:
    """The residuals of L2."""
    return image - target


def share(image: Any, target: Any) -> Any:
    """The residuals of relative L2."""
    return (image - target) * dr.rsqrt(dr.square(target) + DARK)


def ratio(image: Any, target: Any) -> Any:
    """The residuals of L2 of logarithms."""
    return dr.log((dr.maximum(image, 0) + DARK) / (target + DARK))


def absolute(image: Any, target: Any) -> Any:
    """L1: mean |a - b|; outliers count little."""
    return dr.mean(dr.abs(image - target), axis=None)


def squared(image: Any, target: Any) -> Any:
    """L2: mean (a - b)^2.

    Its derivative is unbiased, though the loss itself contains the variance of the pixels: images and derivatives are
    estimated from different samples, so that the derivative 2 (a - b) da has the right mean.
    """
    return dr.mean(dr.square(difference(image, target)), axis=None)


def relative(image: Any, target: Any) -> Any:
    """Relative L2: mean (a - b)^2 / (b^2 + 0.01), to which all pixels contribute alike; unbiased as L2 is."""
    return dr.mean(dr.square(share(image, target)), axis=None)


def logarithmic(image: Any, target: Any) -> Any:
    """L2 of logarithms: mean log((a + 0.01) / (b + 0.01))^2; noise biases it, so take enough samples."""
    return dr.mean(dr.square(ratio(image, target)), axis=None)


LOSSES: dict[str, Loss] = {"l1": absolute, "l2": squared, "relative": relative, "log": logarithmic}
"""The losses by name."""

RESIDUALS: dict[str, Loss] = {"l2": difference, "relative": share, "log": ratio}
"""The residuals, pixel by pixel, of the losses that are means of squares."""


def loss_of(loss: str | Loss) -> Loss:
    """A loss by its name, or the function itself.

    Raises:
        RenderError: The name is unknown.
    """
    if callable(loss):
        return loss
    if loss not in LOSSES:
        raise RenderError(f"unknown loss '{loss}'{near_miss(str(loss), LOSSES)}")
    return LOSSES[loss]


def residual_of(loss: str | Loss) -> Loss:
    """The residuals whose squares a loss averages.

    Raises:
        RenderError: The loss isn't a mean of squares.
    """
    if isinstance(loss, str) and loss in RESIDUALS:
        return RESIDUALS[loss]
    name = f"'{loss}'" if isinstance(loss, str) else "a function"
    possible = ", ".join(RESIDUALS)
    raise RenderError(
        f"'gauss_newton' needs a sum of squares as its loss ({possible}), found {name}; 'adam' takes any loss"
    )

"""Losses, the distance of an image from its target, and priors, assumptions that don't come from the pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.errors import DjptError, ParameterError, RenderError, near_miss

__all__ = ["LOSSES", "PRIORS", "RESIDUALS", "Loss", "Prior", "curvature_of", "loss_of", "prior_of", "residual_of"]

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


def by_name(what: str, given: Any, known: Mapping[str, Any], error: type[DjptError]) -> Any:
    """The function of a name, or the function itself; raises the `error` for a name that isn't `known`."""
    if callable(given):
        return given
    if given not in known:
        raise error(f"unknown {what} '{given}'{near_miss(str(given), known)}")
    return known[given]


def loss_of(loss: str | Loss) -> Loss:
    """A loss by its name, or the function itself; raises `RenderError` if the name is unknown."""
    found: Loss = by_name("loss", loss, LOSSES, RenderError)
    return found


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


# ---- priors: assumptions about a texture -----------------------------------------------------


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
    """A prior by its name, or the function itself; raises `ParameterError` if the name is unknown."""
    found: Prior = by_name("prior", prior, PRIORS, ParameterError)
    return found


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

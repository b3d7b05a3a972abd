"""Tone mapping: the conversion of radiance of any range to the range of a display.

    shown = djpt.tonemap(image, "agx", exposure=1.5)
    djpt.write("out.png", shown)

The result is linear as well, in [0, 1]: `write` and `Image` apply the curve of sRGB to it as to any image, so nothing
is encoded twice. The three steps are white balance, exposure, and an operator.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.core.color import LUMINANCE
from djpt.errors import RenderError, near_miss
from djpt.images.colorimetry import XYZ_TO_RGB, black_body_xyz
from djpt.images.image import Image

__all__ = ["OPERATORS", "balance_matrix", "log_average", "stops", "tonemap"]

Pixels = npt.NDArray[np.float64]

MIDDLE_GREY = 0.18
"""The value to which `exposure="auto"` maps the average luminance."""

LARGEST = float(np.finfo(np.float32).max)


def tonemap(
    image: Any,
    operator: str = "srgb",
    exposure: float | str = 0.0,
    white_balance: float | Sequence[float] | None = None,
    white: float = math.inf,
) -> Any:
    """Fit an image into the range of a display.

    Args:
        image: `TensorXf`, NumPy array or `Image` of linear values: grey (H, W), (H, W, 1) or, with alpha, (H, W, 2);
            RGB (H, W, 3) or, with alpha, (H, W, 4). Alpha is passed on. Not changed.
        operator: What happens to bright light:

            * `srgb`: nothing; it is clipped at 1. The same as writing the image as it is.
            * `reinhard`: luminance L becomes L (1 + L / white^2) / (1 + L), and colours keep their ratios (Reinhard,
              Stark, Shirley and Ferwerda, "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002, eq. 4).
            * `aces`: the look of ACES on film-like displays, dark and contrasty; bright colours turn pale. S. Hill's
              fit of the reference and output transforms (2016).
            * `agx`: the look of T. Sobotka's AgX, soft, without tints in highlights; B. Wrensch's polynomial ("Minimal
              AgX Implementation", 2022).
        exposure: In stops: values are multiplied by 2^exposure. ``"auto"``: such that the logarithmic average of the
            luminance becomes 0.18 (Reinhard 2002, eq. 1).
        white_balance: The light that shall look white: the temperature of a black body in kelvin (1000 to 40000), or
            a linear RGB. Colours are adapted from it to the white of sRGB by von Kries's rule in Bradford's space (Lam
            1985). Default: none.
        white: For `reinhard`, the smallest luminance that becomes 1. Default: infinity.

    Returns:
        Values in [0, 1], of the shape and kind of `image`. Every operator is monotone in the exposure, maps 0 to 0 and
        keeps grey grey. NaN and negative values are taken for 0, infinity for the largest number.

    Raises:
        RenderError: An unknown operator, or arguments out of range.
        FileError: `image` isn't an image.
    """
    if operator not in OPERATORS:
        raise RenderError(f"unknown tone mapping operator '{operator}'{near_miss(str(operator), OPERATORS)}")
    if not white > 0:
        raise RenderError(f"'white' must be greater than 0, found {white!r}")
    view = Image(image)
    pixels = view.numpy()
    if pixels.dtype == np.uint8:
        raise RenderError("8-bit pixels are encoded for displays already; tone mapping needs linear values")
    if pixels.shape[2] > 4:
        raise RenderError(
            f"tone mapping takes images of 1 to 4 channels, found {pixels.shape[2]}: select some, such as "
            "image[..., :3]"
        )
    colors = 3 if pixels.shape[2] >= 3 else 1
    light = np.nan_to_num(pixels[..., :colors].astype(np.float64), nan=0.0, posinf=LARGEST, neginf=0.0)
    if white_balance is not None:
        if colors == 1:
            raise RenderError("'white_balance' needs colours, found a grey image")
        light = light @ balance_matrix(white_balance).T
    light = np.maximum(light, 0.0)
    light = np.minimum(light * 2.0 ** stops(exposure, light), LARGEST)
    rgb = OPERATORS[operator](np.broadcast_to(light, (*light.shape[:2], 3)), white)
    result = pixels.copy()
    result[..., :colors] = np.clip(rgb[..., :colors], 0.0, 1.0)
    return like(image, result)


def like(image: Any, pixels: npt.NDArray[np.float32]) -> Any:
    """Convert `pixels` to the type of array that `image` has."""
    if isinstance(image, Image):
        return Image(pixels)
    pixels = pixels.reshape(image.shape) if hasattr(image, "shape") else pixels
    return type(image)(pixels) if hasattr(image, "array") else pixels


# ---- exposure -------------------------------------------------------------------------------


def stops(exposure: float | str, light: Pixels) -> float:
    """The exposure as a number of stops; ``"auto"`` is computed from the pixels `light`."""
    if exposure == "auto":
        average = log_average(light)
        return math.log2(MIDDLE_GREY / average) if average > 0 else 0.0
    try:
        number = float(exposure)
    except (TypeError, ValueError):
        number = math.nan
    if not -100 <= number <= 100:
        raise RenderError(f"'exposure' must be a number of stops from -100 to 100, or 'auto', found {exposure!r}")
    return number


def log_average(light: Pixels) -> float:
    """The logarithmic average exp(mean(log(L + d))) - d of the luminance, d a thousandth of its mean.

    The offset d limits the weight of black backgrounds. Pixels of infinite light don't count.
    """
    luminance = light @ np.array(LUMINANCE) / sum(LUMINANCE) if light.shape[2] == 3 else light[..., 0]
    luminance = luminance[luminance < LARGEST / 2]
    small = 1e-3 * float(luminance.mean()) if luminance.size else 0.0
    return math.exp(float(np.log(luminance + small).mean())) - small if small > 0 else 0.0


# ---- white balance --------------------------------------------------------------------------

BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""The matrix from XYZ to sharpened cone responses (K. M. Lam, 1985)."""


def balance_matrix(white: float | Sequence[float]) -> Pixels:
    """The matrix (3, 3) that turns colours under the light `white` into those under the white of sRGB.

    M = P B^-1 diag(B w' / B w) B P^-1 with P: XYZ to RGB, B: Bradford's matrix, w and w' the two whites, with Y = 1.
    """
    from_rgb = np.linalg.inv(XYZ_TO_RGB)
    try:
        given = np.asarray(white, np.float64)
    except (TypeError, ValueError):
        given = np.empty(0)
    if given.shape == () and 1000 <= given <= 40000:
        xyz = black_body_xyz(float(given))
    elif given.shape == (3,) and np.all(np.isfinite(given)) and np.all(given >= 0) and given.max() > 0:
        xyz = from_rgb @ given
        xyz = xyz / xyz[1]
    else:
        raise RenderError(
            "'white_balance' must be a temperature from 1000 to 40000 kelvin or three numbers (RGB) that are not "
            f"negative, found {white!r}"
        )
    ours = from_rgb @ np.ones(3)
    # Cone responses to mixtures of sRGB's primaries, and to black bodies, are positive.
    source, target = BRADFORD @ xyz, BRADFORD @ (ours / ours[1])
    return XYZ_TO_RGB @ np.linalg.inv(BRADFORD) @ np.diag(target / source) @ BRADFORD @ from_rgb


# ---- operators: from linear RGB (H, W, 3) >= 0 ------------------------------------------------


def reinhard(rgb: Pixels, white: float) -> Pixels:
    """The operator `reinhard`: luminance L becomes L (1 + L / white^2) / (1 + L), as a factor for all channels."""
    luminance = (rgb @ np.array(LUMINANCE) / sum(LUMINANCE))[..., None]
    return rgb * ((1 + luminance / white**2) / (1 + luminance))


ACES_IN = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
"""The matrix from linear sRGB to the fit's primaries: to ACEScg, with the reference transform's desaturation."""

ACES_OUT = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07603]])
"""The matrix from the primaries of the output transform back to linear sRGB."""


def aces(rgb: Pixels, white: float) -> Pixels:
    """The operator `aces`: a rational function per channel between two matrices whose rows sum to 1."""
    x = np.minimum(rgb @ ACES_IN.T, 1e9)  # the curve is flat there
    y = (x * (x + 0.0245786) - 0.000090537) / (x * (0.983729 * x + 0.4329510) + 0.238081)
    return np.maximum(y, 0.0) @ ACES_OUT.T


AGX_IN = np.array(
    [
        [0.842479062253094, 0.0784335999999992, 0.0792237451477643],
        [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
        [0.0423756549057051, 0.0784336, 0.879142973793104],
    ]
)
AGX_IN /= AGX_IN.sum(axis=1, keepdims=True)  # published with rows that sum to 1 within 1.4e-4: grey must stay grey
AGX_OUT = np.linalg.inv(AGX_IN)
AGX_STOPS = (-12.47393, 4.026069)
"""The range of log2 of light that is mapped to 0 to 1."""
AGX_CURVE = (15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232)
"""The coefficients of the contrast curve, highest power first."""


def agx(rgb: Pixels, white: float) -> Pixels:
    """The operator `agx`: a curve of log2 of light, whose result is encoded with a gamma of 2.2."""
    low, high = AGX_STOPS
    x = np.clip((np.log2(np.maximum(rgb @ AGX_IN.T, 2.0**low)) - low) / (high - low), 0.0, 1.0)
    encoded = np.maximum(np.polyval(AGX_CURVE, x), 0.0) @ AGX_OUT.T
    return np.maximum(encoded, 0.0) ** 2.2


OPERATORS: dict[str, Callable[[Pixels, float], Pixels]] = {
    "aces": aces,
    "agx": agx,
    "reinhard": reinhard,
    "srgb": lambda rgb, white: rgb,  # values above 1 are clipped later
}
"""The operators by name."""

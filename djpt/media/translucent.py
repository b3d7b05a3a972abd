"""Translucent matter as users name it: measured materials, and the albedo that gives a body a colour.

Materials are those of H. W. Jensen, S. R. Marschner, M. Levoy and P. Hanrahan, "A Practical Model for Subsurface Light
Transport", 2001, table 1. They are reduced coefficients: by the theory of similarity, light that is scattered mostly
forward gets as far as light that is scattered evenly, but (1 - g) times as often, g being the mean cosine of the phase
function. With the isotropic phase function, the default, a path in milk thus has a tenth of the vertices, or less.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.properties import Properties
from djpt.errors import near_miss
from djpt.jit.types import Color3f

__all__ = ["MATERIALS", "albedo_of_color", "translucent"]

RGB = tuple[float, float, float]

MATERIALS: Mapping[str, tuple[RGB, RGB]] = {
    "apple": ((2.29, 2.39, 1.97), (0.0030, 0.0034, 0.046)),
    "chicken_1": ((0.15, 0.21, 0.38), (0.015, 0.077, 0.19)),
    "chicken_2": ((0.19, 0.25, 0.32), (0.018, 0.088, 0.20)),
    "cream": ((7.38, 5.47, 3.15), (0.0002, 0.0028, 0.0163)),
    "ketchup": ((0.18, 0.07, 0.03), (0.061, 0.97, 1.45)),
    "marble": ((2.19, 2.62, 3.00), (0.0021, 0.0041, 0.0071)),
    "potato": ((0.68, 0.70, 0.55), (0.0024, 0.0090, 0.12)),
    "skim_milk": ((0.70, 1.22, 1.90), (0.0014, 0.0025, 0.0142)),
    "skin_1": ((0.74, 0.88, 1.01), (0.032, 0.17, 0.48)),
    "skin_2": ((1.09, 1.59, 1.79), (0.013, 0.070, 0.145)),
    "spectralon": ((11.6, 20.4, 14.9), (0.00, 0.00, 0.00)),
    "whole_milk": ((2.55, 3.21, 3.77), (0.0011, 0.0024, 0.014)),
}
"""The reduced scattering and the absorption of each material, per mm, in red, green and blue."""


def albedo_of_color(color: Any, g: float = 0.0) -> NDArray[np.float64]:
    """The albedo of matter that fills a half space and looks like a diffuse surface of a colour.

    With A = `color`, the fraction of light from all sides that comes out again,

        s = 4.09712 + 4.20863 A - sqrt(9.59217 + 41.6808 A + 17.7126 A^2),    albedo = (1 - s^2) / (1 - g s^2),

    which is the inverse of A = (1 - s) (1 - 0.139 s) / (1 + 1.17 s) by H. C. van de Hulst, "Multiple Light Scattering",
    1980, for a boundary that doesn't reflect.

    C. Kulla and A. Conty, "Revisiting Physically Based Shading at Imageworks", 2017.

    Args:
        color: numbers in [0, 1], of any shape.
        g: the mean cosine of the phase function, in (-1, 1).
    """
    a = np.asarray(color, np.float64)
    s = np.clip(4.09712 + 4.20863 * a - np.sqrt(9.59217 + 41.6808 * a + 17.7126 * a * a), 0, 1)
    return np.asarray((1 - s * s) / (1 - g * s * s))


def translucent(props: Properties) -> tuple[Color3f, Color3f] | None:
    """The extinction and the albedo of a medium that is described by a name, or by what it looks like.

    That is a `material`, `color` and `radius`, or the `asymmetry` of what it is similar to. None if it is none of
    these.

    Raises:
        SceneError: An unknown material, numbers out of range, or two descriptions of one medium.
    """
    if "asymmetry" in props:
        return similar(props)
    given = [key for key in ("material", "color", "sigma_t", "albedo") if key in props]
    named = next((key for key in given if key in ("material", "color")), None)
    if named is None:
        if "radius" in props:
            raise props.error("radius", "belongs to a 'color'; possible: 'sigma_t' and 'albedo'")
        return None
    if len(given) > 1:
        others = " and ".join(f"'{key}'" for key in given if key != named)
        raise props.error(named, f"and {others} set the same property: give only one")
    if named == "material":
        name = props.string("material")
        if name not in MATERIALS:
            raise props.error("material", f"can't be '{name}'{near_miss(name, MATERIALS)}")
        scattering, absorption = (np.array(rates) for rates in MATERIALS[name])
        return color3(scattering + absorption), color3(scattering / (scattering + absorption))
    radius = rgb(props, "radius", 1.0)
    if (radius <= 0).any():
        raise props.error("radius", f"must be positive, found {radius.tolist()}")
    color = rgb(props, "color", 0.5, high=1.0)
    return color3(1 / radius), color3(albedo_of_color(color))


def similar(props: Properties) -> tuple[Color3f, Color3f]:
    """The reduced `sigma_t` and `albedo` of a description whose own belong to a phase function of a mean cosine g.

    With the albedo a it is sigma_t (1 - a g), and (1 - g) a / (1 - a g): the same absorption, and light that is
    scattered evenly but (1 - g) times as often.

    D. R. Wyman, M. S. Patterson and B. C. Wilson, "Similarity Relations for the Interaction Parameters in Radiation
    Transport", 1989.
    """
    for key in ("material", "color"):
        if key in props:
            raise props.error("asymmetry", f"and '{key}' can't be combined: its coefficients are reduced already")
    g = props.float("asymmetry", low=-1.0, high=1.0, low_open=True, high_open=True)
    sigma_t, albedo = rgb(props, "sigma_t", 1.0), rgb(props, "albedo", 0.75, high=1.0)
    for key in ("sigma_t", "albedo"):
        if key in props:
            del props[key]
    return color3(sigma_t * (1 - albedo * g)), color3((1 - g) * albedo / (1 - albedo * g))


def color3(numbers: NDArray[np.float64]) -> Color3f:
    """Three numbers as a colour."""
    return Color3f(*numbers.tolist())


def rgb(props: Properties, key: str, default: float, high: float | None = None) -> NDArray[np.float64]:
    """A number or a colour, which is at least 0, as three numbers."""
    value = props.texture(key, default, low=0.0, high=high)
    if not value.is_constant:
        raise props.error(key, "must be the same everywhere")
    return np.array(dr.ravel(value.eval(None)), np.float64)

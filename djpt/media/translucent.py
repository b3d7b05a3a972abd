"""Translucent matter as users name it: measured materials, wax, and the albedo that gives a body a colour.

Materials are those of H. W. Jensen, S. R. Marschner, M. Levoy and P. Hanrahan, "A Practical Model for Subsurface Light
Transport", 2001, table 1, and `wax`. They are reduced coefficients: by the theory of similarity, light that is
scattered mostly forward gets as far as light that is scattered evenly, but (1 - g) times as often, g being the mean
cosine of the phase function. With the isotropic phase function, the default, a path in milk thus has a tenth of the
vertices, or less.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.properties import Properties
from djpt.errors import SceneError, near_miss
from djpt.jit.types import Color3f

__all__ = [
    "MATERIALS",
    "albedo_of_color",
    "color_behind",
    "reflectance_behind",
    "reflectance_of_albedo",
    "subsurface",
    "translucent",
]

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
    "wax": ((2.00, 2.00, 1.98), (0.00087, 0.0032, 0.016)),
    "whole_milk": ((2.55, 3.21, 3.77), (0.0011, 0.0024, 0.014)),
}
"""The reduced scattering and the absorption of each material, per mm, in red, green and blue.

All but `wax` are measured. No measurement of wax in three channels is known to us, so it is made up: a pale candle
whose large bodies have the colour (0.90, 0.82, 0.66) behind a boundary of the index 1.44, that of paraffin, with a free
path of 0.5 mm, about as in marble. Scattering and absorption follow by `reflectance_behind` and `albedo_of_color`.
"""

TEXTURED = 0.8
"""The colour of the medium under a textured surface, unless it is given: light, since surfaces only filter."""


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


def reflectance_of_albedo(albedo: Any) -> NDArray[np.float64]:
    """The inverse of `albedo_of_color` for matter that scatters evenly: (1 - s) (1 - 0.139 s) / (1 + 1.17 s).

    s = sqrt(1 - albedo); H. C. van de Hulst, "Multiple Light Scattering", 1980.
    """
    s = np.sqrt(1 - np.asarray(albedo, np.float64))
    return np.asarray((1 - s) * (1 - 0.139 * s) / (1 + 1.17 * s))


def reflectance_behind(color: Any, eta: float) -> NDArray[np.float64]:
    """The reflectance of matter that has a colour behind a boundary with the index `eta` >= 1.

    Of the light from all sides the boundary reflects k_1, and sends back k_2 = 1 - (1 - k_1) / eta^2 of what comes from
    inside. Of the light that isn't reflected at once, matter with the reflectance R returns

        color = (1 - k_2) R / (1 - k_2 R),    so that    R = color / (1 - k_2 + k_2 color).

    J. L. Saunderson, "Calculation of the Color of Pigmented Plastics", 1942; for k_1 see `boundary_reflectance`.

    Args:
        color: numbers in [0, 1], of any shape.
        eta: the index inside over that outside.
    """
    c = np.asarray(color, np.float64)
    inside = 1 - (1 - boundary_reflectance(eta)) / eta**2
    return np.asarray(c / (1 - inside + inside * c))


def color_behind(reflectance: Any, eta: float) -> NDArray[np.float64]:
    """The colour of matter behind a boundary with the index `eta` >= 1: the inverse of `reflectance_behind`."""
    r = np.asarray(reflectance, np.float64)
    inside = 1 - (1 - boundary_reflectance(eta)) / eta**2
    return np.asarray((1 - inside) * r / (1 - inside * r))


def boundary_reflectance(eta: float) -> float:
    """The fraction of light from all sides, outside, that a smooth boundary with the index `eta` >= 1 reflects.

    J. W. T. Walsh, "The Reflection Factor of a Polished Glass Surface for Diffused Light", 1926.
    """
    if eta == 1:
        return 0.0
    n, square = eta, eta * eta
    logarithms = square * (square - 1) ** 2 / (square + 1) ** 3 * math.log((n - 1) / (n + 1))
    logarithms += 8 * square**2 * (square**2 + 1) / ((square + 1) * (square**2 - 1) ** 2) * math.log(n)
    rational = 0.5 + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
    return rational + logarithms - 2 * n**3 * (square + 2 * n - 1) / ((square + 1) * (square**2 - 1))


def subsurface(
    base_color: Any = None,
    radius: Any = 1.0,
    *,
    material: str | None = None,
    scale: float = 1.0,
    weight: Any = 1.0,
    interior_color: Any = None,
    eta: float = 1.4,
    roughness: float = 0.3,
    anisotropy: float = 0.0,
    **lobes: Any,
) -> dict[str, Any]:
    """The `bsdf` and the `interior` of a closed shape that light enters, and leaves after a random walk.

    ``{"type": "sphere", **djpt.subsurface([0.8, 0.5, 0.3], [1.0, 0.3, 0.1], scale=0.05)}``: what Blender's principled
    BSDF calls subsurface. No BSDF can do it alone, since light comes out elsewhere; here walks are
    paths through a medium, which integrators of media follow, through thin parts, round holes and with derivatives. The
    boundary is a `principled` BSDF with the parameter `subsurface`, the medium a `homogeneous` one.

    With the albedo a and the radius r of a medium that scatters evenly, one whose phase function `hg` has the mean
    cosine g = `anisotropy` looks the same if

        sigma_t = (1 - g (1 - a)) / ((1 - g) r),    albedo = a / (1 - g (1 - a)).

    M. J.-Y. Chiang, P. Kutz and B. Burley, "Practical and Controllable Subsurface Scattering for Production Path
    Tracing", 2016, has such walks with another fit of the albedo; D. R. Wyman et al. 1989 for g, see `similar`.

    Args:
        base_color: What a large body looks like beside its highlights, a number or three (see `reflectance_behind`), or
            the description of a texture; by default that of the material, or 0.5.
        radius: The mean free path, a number or one for each channel, > 0: the reduced one with an `anisotropy`.
        material: One of `MATERIALS` in place of a radius, and of the colour of the medium.
        scale: The length that belongs to a radius of 1; for a `material`, the length of a millimetre in the scene. Rays
            that enter start 0.00009 (1 + c) below the surface, c being the largest coordinate, which should be a
            fiftieth of the free path at most: else bodies are too dark. Choose millimetres or centimetres as units.
        weight: The fraction of the light that enters, a number or the description of a texture in [0, 1]; the rest is
            scattered by the diffuse surface that `principled` has otherwise.
        interior_color: The colour of the medium, a number or three; by default `base_color`, with a texture 0.8. Light
            is filtered by sqrt(base_color / interior_color) on its way in and on its way out, so that each part of the
            surface that is large has its own colour.
        eta: The index of refraction, at least 1.
        roughness: That of `principled`. Rough boundaries lose light each time that it meets them: a body of the colour
            0.85 has 0.84 at 0.3, and 0.58 at 0.6.
        anisotropy: The mean cosine of the phase function, in (-1, 1). It changes the first steps below the surface,
            and walks take 1 / (1 - g) as many.
        lobes: Other parameters of `principled`, such as `sheen`, `clearcoat` and `metallic`.

    Raises:
        SceneError: `lobes` names a parameter that is fixed, or the material is unknown; or with an `anisotropy`, a
            value is out of range. Other mistakes are found when the scene is loaded.
    """
    if "specular" in lobes:
        raise SceneError("subsurface: give 'eta' in place of 'specular': 2 / (1 - sqrt(0.08 specular)) - 1")
    if "spec_trans" in lobes:
        raise SceneError("subsurface: 'spec_trans' is fixed: what is inside is one medium; blend BSDFs for others")
    require(material is None or material in MATERIALS, "material", material, f"be one of {', '.join(MATERIALS)}")
    textured = isinstance(base_color, Mapping)
    if material is not None:
        require(interior_color is None, "interior_color", interior_color, "be left out: the material has a colour")
        inside: Any = color_behind(reflectance_of_albedo(of_material(material)[1]), eta)
    elif interior_color is not None:
        inside = interior_color
    else:
        inside = TEXTURED if textured else 0.5 if base_color is None else base_color
    outside = inside if base_color is None else base_color
    bsdf = {
        "type": "principled",
        "base_color": outside if textured else number_or_rgb(outside),
        "subsurface": weight,
        "subsurface_color": number_or_rgb(inside),
        "eta": eta,
        "roughness": roughness,
        **lobes,
    }
    interior: dict[str, Any] = {"type": "homogeneous", "scale": 1 / scale}
    if anisotropy:
        require(-1 < anisotropy < 1, "anisotropy", anisotropy, "lie in (-1, 1)")
        require(np.greater(radius, 0).all(), "radius", radius, "be positive")
        name = "base_color" if interior_color is None else "interior_color"
        require(np.equal(inside, np.clip(inside, 0, 1)).all(), name, inside, "lie in [0, 1]")
        even = of_color(inside, radius, eta) if material is None else of_material(material)
        sigma_t, albedo = forward(*even, anisotropy)
        interior |= {"sigma_t": number_or_rgb(sigma_t), "albedo": number_or_rgb(albedo)}
        interior["phase"] = {"type": "hg", "g": anisotropy}
    elif material is not None:
        interior["material"] = material
    else:
        interior |= {"color": number_or_rgb(inside), "radius": number_or_rgb(radius), "boundary_eta": eta}
    return {"bsdf": bsdf, "interior": interior}


def require(met: Any, name: str, found: Any, condition: str) -> None:
    """Raise `SceneError` about a parameter of `subsurface` unless a condition is met."""
    if not met:
        raise SceneError(f"subsurface: '{name}' must {condition}, found {found}")


def of_material(name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The extinction per mm and the albedo of one of `MATERIALS`."""
    scattering, absorption = (np.array(rates) for rates in MATERIALS[name])
    return scattering + absorption, scattering / (scattering + absorption)


def of_color(color: Any, radius: Any, eta: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The extinction and the albedo that give a large body a colour behind a boundary of the index `eta`."""
    return 1 / np.asarray(radius, np.float64), albedo_of_color(reflectance_behind(color, eta))


def forward(
    sigma_t: NDArray[np.float64], albedo: NDArray[np.float64], g: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The `sigma_t` and `albedo` for a phase function of the mean cosine `g` that look like reduced ones.

    The inverse of `similar`.
    """
    kept = 1 - g * (1 - albedo)
    return sigma_t * kept / (1 - g), albedo / kept


def number_or_rgb(value: Any) -> Any:
    """A number, or the description of a colour of three."""
    numbers = np.asarray(value, np.float64)
    return float(numbers) if numbers.ndim == 0 else {"type": "rgb", "value": numbers.tolist()}


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
    for key in ("radius", "boundary_eta"):
        if key in props and named != "color":
            raise props.error(key, "belongs to a 'color'; possible: 'sigma_t' and 'albedo'")
    if named is None:
        return None
    if len(given) > 1:
        others = " and ".join(f"'{key}'" for key in given if key != named)
        raise props.error(named, f"and {others} set the same property: give only one")
    if named == "material":
        name = props.string("material")
        if name not in MATERIALS:
            raise props.error("material", f"can't be '{name}'{near_miss(name, MATERIALS)}")
        sigma_t, reduced = of_material(name)
        return color3(sigma_t), color3(reduced)
    radius = rgb(props, "radius", 1.0)
    if (radius <= 0).any():
        raise props.error("radius", f"must be positive, found {radius.tolist()}")
    color = rgb(props, "color", 0.5, high=1.0)
    eta = props.float("boundary_eta", 1.0, low=1.0, high=4.0)
    sigma_t, reduced = of_color(color, radius, eta)
    return color3(sigma_t), color3(reduced)


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

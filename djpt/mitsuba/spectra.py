"""Colours and spectra: luminance, XYZ, the CIE's tables, files of spectra."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.color import LUMINANCE, RGB_TO_XYZ
from djpt.core.files import as_path, shortened, writing
from djpt.description.files import read_pairs
from djpt.errors import ArgumentError
from djpt.images import colorimetry
from djpt.jit.types import Color3f, Float, UInt32, converting
from djpt.mitsuba.constants import MI_CIE_D65_NORMALIZATION, MI_CIE_MAX, MI_CIE_MIN

__all__ = [
    "cie1931_xyz",
    "cie1931_y",
    "cie_d65",
    "depolarizer",
    "linear_rgb_rec",
    "luminance",
    "pdf_rgb_spectrum",
    "sample_rgb_spectrum",
    "spectrum_from_file",
    "spectrum_list_to_srgb",
    "spectrum_to_file",
    "srgb_to_xyz",
    "unpolarized_spectrum",
    "xyz_to_srgb",
]

# ---- colours -------------------------------------------------------------------------------


def luminance(value: Any = None, wavelengths: Any = None, active: Any = True, *, c: Any = None) -> Float:
    """The luminance of a linear colour. `wavelengths` and `active` are Mitsuba's; they mean nothing to colours."""
    colour = Color3f(value if c is None else c)
    return sum((weight * x for weight, x in zip(LUMINANCE, colour, strict=True)), Float(0))


@converting
def xyz_to_srgb(rgb: Color3f, active: Any = True) -> Color3f:
    """Convert CIE 1931 XYZ to linear RGB."""
    return by_matrix(colorimetry.XYZ_TO_RGB.tolist(), rgb)


@converting
def srgb_to_xyz(rgb: Color3f, active: Any = True) -> Color3f:
    """Convert linear RGB to CIE 1931 XYZ."""
    return by_matrix(RGB_TO_XYZ, rgb)


def by_matrix(matrix: Sequence[Sequence[float]], v: Color3f) -> Color3f:
    """The product of a matrix of constants with a vector."""
    return Color3f(*(dr.fma(a, v.x, dr.fma(b, v.y, c * v.z)) for a, b, c in matrix))


def unpolarized_spectrum(arg: Any, /) -> Color3f:
    """The intensity of light: the colour itself, since there is no polarisation here."""
    return Color3f(arg)


def depolarizer(arg: Any = 1.0, /) -> Color3f:
    """What depolarises light when it is multiplied: the colour itself, since there is no polarisation here."""
    return Color3f(arg)


# ---- tables --------------------------------------------------------------------------------


@converting
def cie1931_xyz(wavelength: Float) -> Color3f:
    """The colour matching functions of the CIE's standard observer of 1931, 0 outside of the visible range (nm)."""
    return Color3f(*(tabulated(colorimetry.MATCHING[row], wavelength) for row in range(3)))


@converting
def cie1931_y(wavelength: Float) -> Float:
    """The luminous efficiency: the second one of `cie1931_xyz`."""
    return tabulated(colorimetry.MATCHING[1], wavelength)


@converting
def cie_d65(wavelength: Float) -> Float:
    """The spectrum of daylight, normalised to a luminance of 1; 0 outside of the visible range (nm)."""
    return tabulated(colorimetry.DAYLIGHT * MI_CIE_D65_NORMALIZATION, wavelength)


def linear_rgb_rec(wavelength: Any) -> Color3f:
    """The colour matching functions of linear RGB: `cie1931_xyz`, converted."""
    return xyz_to_srgb(cie1931_xyz(wavelength))


def tabulated(table: Any, wavelength: Float) -> Float:
    """The interpolation of a table over the visible range, 0 outside."""
    t = (wavelength - MI_CIE_MIN) * ((len(table) - 1) / (MI_CIE_MAX - MI_CIE_MIN))
    inside = (wavelength >= MI_CIE_MIN) & (wavelength <= MI_CIE_MAX)
    first = UInt32(dr.clip(t, 0, len(table) - 2))
    memory = Float(np.asarray(table, np.float32).copy())
    low, high = dr.gather(Float, memory, first, inside), dr.gather(Float, memory, first + 1, inside)
    return dr.select(inside, dr.lerp(low, high, t - Float(first)), 0)


# ---- wavelengths ---------------------------------------------------------------------------


def sample_rgb_spectrum(sample: Any) -> tuple[Any, Any]:
    """A wavelength where the eye is sensitive, and the inverse of its density.

    The density is proportional to cosh(0.0072 (wavelength - 538 nm))^-2 (M. Radziszewski, K. Boryczko and W. Alda,
    "An Improved Technique for Full Spectral Rendering", 2009).
    """
    u = numbers(sample)
    low, high = np.tanh(0.0072 * (np.array([MI_CIE_MIN, MI_CIE_MAX]) - 538))
    wavelength = 538 + dr.atanh(dr.lerp(float(low), float(high), u)) / 0.0072
    return wavelength, float(high - low) / 0.0072 * dr.square(dr.cosh(0.0072 * (wavelength - 538)))


def pdf_rgb_spectrum(wavelengths: Any) -> Any:
    """The density of `sample_rgb_spectrum`, per nm; 0 outside of the visible range."""
    w = numbers(wavelengths)
    low, high = np.tanh(0.0072 * (np.array([MI_CIE_MIN, MI_CIE_MAX]) - 538))
    density = 0.0072 / float(high - low) / dr.square(dr.cosh(0.0072 * (w - 538)))
    return dr.select((w >= MI_CIE_MIN) & (w <= MI_CIE_MAX), density, 0)


def numbers(value: Any) -> Any:
    """A Dr.Jit array as it is, anything else as a `Float`."""
    return value if dr.is_array_v(value) else Float(value)


# ---- lists and files -----------------------------------------------------------------------


def spectrum_list_to_srgb(
    wavelengths: Sequence[float], values: Sequence[float], bounded: bool = True, d65: bool = False
) -> Any:
    """The colour of a spectrum in linear RGB.

    Args:
        wavelengths: in nm, increasing. The spectrum is linear between them and 0 outside.
        values: one per wavelength.
        bounded: clip to [0, 1], as for reflectances; otherwise colours only mustn't be negative. Clipping warns.
        d65: the spectrum is lit by daylight.

    Returns:
        Three numbers, a `drjit.scalar.Array3f`.
    """
    if not len(wavelengths) or len(wavelengths) != len(values):
        raise ArgumentError(
            f"spectrum_list_to_srgb(): as many wavelengths as values are needed, at least one; "
            f"found {len(wavelengths)} and {len(values)}"
        )
    xyz = colorimetry.spectrum_to_xyz([*wavelengths], [*values], under_d65=d65)
    colour = colorimetry.XYZ_TO_RGB @ xyz
    shown = np.clip(colour, 0, 1 if bounded else None)
    if (shown != colour).any():
        warnings.warn(f"spectrum_list_to_srgb(): the colour {colour.round(6).tolist()} is clipped", stacklevel=2)
    return dr.scalar.Array3f(shown.tolist())


def spectrum_from_file(filename: str | os.PathLike[str]) -> tuple[list[float], list[float]]:
    """Wavelengths and values in a text file (spd): two numbers a line, the rest of a line after # is a comment.

    Raises:
        ArgumentError: the name doesn't end in .spd.
        FileError: the file can't be read, or a line has other than two numbers.
    """
    check_suffix(filename)
    return read_pairs(filename)


def spectrum_to_file(filename: str | os.PathLike[str], wavelengths: Sequence[float], values: Sequence[float]) -> None:
    """Write a spectrum as `spectrum_from_file` reads it.

    Raises:
        ArgumentError: the name doesn't end in .spd, or there aren't as many wavelengths as values.
        FileError: the file can't be written.
    """
    check_suffix(filename)
    if len(wavelengths) != len(values):
        raise ArgumentError(f"spectrum_to_file(): {len(wavelengths)} wavelengths, but {len(values)} values")
    with writing(as_path(filename)) as temporary:
        temporary.write_text("".join(f"{w:.9g} {v:.9g}\n" for w, v in zip(wavelengths, values, strict=True)), "utf-8")


def check_suffix(filename: str | os.PathLike[str]) -> None:
    """Raise an `ArgumentError` unless a name ends in .spd."""
    path = as_path(filename)
    if path.suffix.lower() != ".spd":
        raise ArgumentError(f"'{shortened(path)}': spectra are stored in text files whose names end in .spd")

"""Colours of spectra in linear sRGB, by the CIE 1931 standard observer."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "DAYLIGHT",
    "LONGEST",
    "MATCHING",
    "SHORTEST",
    "XYZ_TO_RGB",
    "black_body_xyz",
    "spectrum_to_rgb",
    "spectrum_to_xyz",
]


SHORTEST, LONGEST = 360.0, 830.0
"""The visible range in nm, in which spectra are integrated."""

_STEPS = 1000
"""The number of equidistant wavelengths in sums; Mitsuba's number, so that colours agree to all digits."""

_D65_SCALE = 1 / 98.9974167
"""Factor from the tabulated D65 to Mitsuba's, under which a constant spectrum of 1 has a luminance of 0.9989."""

XYZ_TO_RGB = np.array(
    [
        [3.240479, -1.537150, -0.498535],
        [-0.969256, 1.875991, 0.041556],
        [0.055648, -0.204043, 1.057311],
    ]
)
"""The matrix from XYZ to linear RGB: ITU-R BT.709 primaries, white point D65."""


def spectrum_to_rgb(wavelengths: Sequence[float], values: Sequence[float], under_d65: bool) -> NDArray[np.float64]:
    """The colour of a spectrum in linear sRGB, (3,) float64, not negative; see `spectrum_to_xyz` for arguments."""
    return np.maximum(XYZ_TO_RGB @ spectrum_to_xyz(wavelengths, values, under_d65), 0.0)


def spectrum_to_xyz(wavelengths: Sequence[float], values: Sequence[float], under_d65: bool) -> NDArray[np.float64]:
    """The colour of a spectrum in the space CIE 1931 XYZ, (3,) float64.

    XYZ = sum of s(l) cmf(l) D(l) / sum of y(l).

    Args:
        wavelengths: in nm, increasing. The spectrum is linear between them and 0 outside.
        values: one per wavelength.
        under_d65: D is daylight, for what reflects (a constant spectrum is white). Otherwise D = 1, for
            what emits.
    """
    grid, matching, daylight = _observer()
    spectrum = np.interp(grid, wavelengths, values, left=0, right=0)
    if under_d65:
        spectrum = spectrum * daylight * _D65_SCALE
    xyz: NDArray[np.float64] = (matching * spectrum).sum(axis=1) / matching[1].sum()
    return xyz


@cache
def _observer() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The wavelengths of sums, (N,), with the three matching functions, (3, N), and D65, (N,)."""
    grid = np.linspace(SHORTEST, LONGEST, _STEPS)
    matching = np.stack([np.interp(grid, WAVELENGTHS, row) for row in MATCHING])
    return grid, matching, np.interp(grid, WAVELENGTHS, DAYLIGHT)


def black_body_xyz(kelvin: float) -> NDArray[np.float64]:
    """The colour of a black body of this temperature, XYZ (3,) with Y = 1.

    By Planck's law, B(l, T) proportional to 1 / (l^5 (exp(c2 / (l T)) - 1)), c2 = 0.014388 m K.
    """
    grid = np.linspace(SHORTEST, LONGEST, _STEPS)
    # Relative to 560 nm, in a form that doesn't overflow at low temperatures.
    x, middle = 1.438777e7 / (grid * kelvin), 1.438777e7 / (560.0 * kelvin)
    spectrum = (560.0 / grid) ** 5 * np.exp(middle - x) * (-np.expm1(-middle)) / (-np.expm1(-x))
    xyz = spectrum_to_xyz(grid.tolist(), spectrum.tolist(), under_d65=False)
    return xyz / xyz[1]


WAVELENGTHS, *_MATCHING, DAYLIGHT = np.loadtxt(Path(__file__).with_name("cie1931.txt")).T
MATCHING = np.stack(_MATCHING)
"""The functions x, y and z of the standard observer, (3, n), at n equidistant wavelengths of the visible range."""

"""Colours of spectra in linear sRGB, by the CIE 1931 standard observer."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from djpt.core.files import as_path, read_bytes
from djpt.errors import FileError

__all__ = [
    "DAYLIGHT",
    "LONGEST",
    "MATCHING",
    "SHORTEST",
    "XYZ_TO_RGB",
    "black_body_xyz",
    "read_pairs",
    "spectrum_to_rgb",
    "spectrum_to_xyz",
]


def read_pairs(filename: str | os.PathLike[str]) -> tuple[list[float], list[float]]:
    """Wavelengths and values in a text file (spd): two numbers a line, the rest of a line after # is a comment.

    Raises:
        FileError: The file can't be read, or a line has other than two numbers.
    """
    name = as_path(filename)
    try:
        lines = [line.split("#")[0].split() for line in read_bytes(name).decode("utf-8").splitlines()]
    except UnicodeError:
        raise FileError(f"can't read '{name}': it isn't a text file") from None
    wavelengths, values = [], []
    for number, line in enumerate(lines, 1):
        if not line:
            continue
        try:
            wavelength, value = map(float, line)
        except ValueError:
            raise FileError(f"'{name}', line {number}: must be two numbers, a wavelength and a value") from None
        wavelengths.append(wavelength)
        values.append(value)
    return wavelengths, values


# ---- colours of spectra ----------------------------------------------------------------------


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


_TABLE = """
    360 0.0001299 3.917e-06 0.0006061 46.6383
    365 0.0002321 6.965e-06 0.001086 49.3637
    370 0.0004149 1.239e-05 0.001946 52.0891
    375 0.0007416 2.202e-05 0.003486 51.0323
    380 0.001368 3.9e-05 0.006450001 49.9755
    385 0.002236 6.4e-05 0.01054999 52.3118
    390 0.004243 0.00012 0.02005001 54.6482
    395 0.00765 0.000217 0.03621 68.7015
    400 0.01431 0.000396 0.06785001 82.7549
    405 0.02319 0.00064 0.1102 87.1204
    410 0.04351 0.00121 0.2074 91.486
    415 0.07763 0.00218 0.3713 92.4589
    420 0.13438 0.004 0.6456 93.4318
    425 0.21477 0.0073 1.03905 90.057
    430 0.2839 0.0116 1.3856 86.6823
    435 0.3285 0.01684 1.62296 95.7736
    440 0.34828 0.023 1.74706 104.865
    445 0.34806 0.0298 1.7826 110.936
    450 0.3362 0.038 1.77211 117.008
    455 0.3187 0.048 1.7441 117.41
    460 0.2908 0.06 1.6692 117.812
    465 0.2511 0.0739 1.5281 116.336
    470 0.19536 0.09098 1.28764 114.861
    475 0.1421 0.1126 1.0419 115.392
    480 0.09564 0.13902 0.8129501 115.923
    485 0.05795001 0.1693 0.6162 112.367
    490 0.03201 0.20802 0.46518 108.811
    495 0.0147 0.2586 0.3533 109.082
    500 0.0049 0.323 0.272 109.354
    505 0.0024 0.4073 0.2123 108.578
    510 0.0093 0.503 0.1582 107.802
    515 0.0291 0.6082 0.1117 106.296
    520 0.06327 0.71 0.07824999 104.79
    525 0.1096 0.7932 0.05725001 106.239
    530 0.1655 0.862 0.04216 107.689
    535 0.2257499 0.9148501 0.02984 106.047
    540 0.2904 0.954 0.0203 104.405
    545 0.3597 0.9803 0.0134 104.225
    550 0.4334499 0.9949501 0.008749999 104.046
    555 0.5120501 1 0.005749999 102.023
    560 0.5945 0.995 0.0039 100
    565 0.6784 0.9786 0.002749999 98.1671
    570 0.7621 0.952 0.0021 96.3342
    575 0.8425 0.9154 0.0018 96.0611
    580 0.9163 0.87 0.001650001 95.788
    585 0.9786 0.8163 0.0014 92.2368
    590 1.0263 0.757 0.0011 88.6856
    595 1.0567 0.6949 0.001 89.3459
    600 1.0622 0.631 0.0008 90.0062
    605 1.0456 0.5668 0.0006 89.8026
    610 1.0026 0.503 0.00034 89.5991
    615 0.9384 0.4412 0.00024 88.6489
    620 0.8544499 0.381 0.00019 87.6987
    625 0.7514 0.321 0.0001 85.4936
    630 0.6424 0.265 4.999999e-05 83.2886
    635 0.5419 0.217 3e-05 83.4939
    640 0.4479 0.175 2e-05 83.6992
    645 0.3608 0.1382 1e-05 81.863
    650 0.2835 0.107 0 80.0268
    655 0.2187 0.0816 0 80.1207
    660 0.1649 0.061 0 80.2146
    665 0.1212 0.04458 0 81.2462
    670 0.0874 0.032 0 82.2778
    675 0.0636 0.0232 0 80.281
    680 0.04677 0.017 0 78.2842
    685 0.0329 0.01192 0 74.0027
    690 0.0227 0.00821 0 69.7213
    695 0.01584 0.005723 0 70.6652
    700 0.01135916 0.004102 0 71.6091
    705 0.008110916 0.002929 0 72.979
    710 0.005790346 0.002091 0 74.349
    715 0.004109457 0.001484 0 67.9765
    720 0.002899327 0.001047 0 61.604
    725 0.00204919 0.00074 0 65.7448
    730 0.001439971 0.00052 0 69.8856
    735 0.0009999493 0.0003611 0 72.4863
    740 0.0006900786 0.0002492 0 75.087
    745 0.0004760213 0.0001719 0 69.3398
    750 0.0003323011 0.00012 0 63.5927
    755 0.0002348261 8.48e-05 0 55.0054
    760 0.0001661505 6e-05 0 46.4182
    765 0.000117413 4.24e-05 0 56.6118
    770 8.307527e-05 3e-05 0 66.8054
    775 5.870652e-05 2.12e-05 0 65.0941
    780 4.150994e-05 1.499e-05 0 63.3828
    785 2.935326e-05 1.06e-05 0 63.8434
    790 2.067383e-05 7.4657e-06 0 64.304
    795 1.455977e-05 5.2578e-06 0 61.8779
    800 1.025398e-05 3.7029e-06 0 59.4519
    805 7.221456e-06 2.6078e-06 0 55.7054
    810 5.085868e-06 1.8366e-06 0 51.959
    815 3.581652e-06 1.2934e-06 0 54.6998
    820 2.522525e-06 9.1093e-07 0 57.4406
    825 1.776509e-06 6.4153e-07 0 58.8765
    830 1.251141e-06 4.5181e-07 0 60.3125
"""
"""Wavelength in nm, colour matching functions x y z of the 2 degree observer (CIE 1931), D65 (100 at 560 nm).

Source: CIE 015 and CIE S 014-2, every 5 nm.
"""

WAVELENGTHS, *_MATCHING, DAYLIGHT = np.array([float(number) for number in _TABLE.split()]).reshape(-1, 5).T
MATCHING = np.stack(_MATCHING)
"""The functions x, y and z of the standard observer, (3, n), at n equidistant wavelengths of the visible range."""

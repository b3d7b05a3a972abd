"""Constant spectra, as colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array, describe
from djpt.description.files import read_pairs, resolve
from djpt.description.properties import Properties
from djpt.description.registry import register_texture
from djpt.errors import SceneError
from djpt.images.colorimetry import XYZ_TO_RGB
from djpt.textures.tabulated import Pairs, TabulatedSpectrum, pairs_of

__all__ = ["SpectrumTexture"]


class SpectrumTexture(TabulatedSpectrum):
    """A spectrum as it stands in scene files, as a colour: see `TabulatedSpectrum`.

    Parameters: `value` (one number for a constant spectrum, or pairs of a wavelength in nm and a value, linear in
    between), or `filename` of a text file with a pair per line. As a parameter it is a colour, `value`, as in
    Mitsuba's RGB variants.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        self._constant: float | None = None
        pairs: Pairs = ([], [])
        if "filename" in props and "value" not in props:
            pairs = from_file(props)
        else:
            value = props.raw("value")
            with props.naming("value"):
                numbers = as_array(value)
            if numbers.ndim == 0:
                self._constant = float(numbers)
            else:
                pairs = from_list(props, value, numbers)
        super().__init__(props, pairs)

    def _colour(self) -> list[float]:
        if self._constant is None:
            return super()._colour()
        white = XYZ_TO_RGB.sum(axis=1) if self._emitted else np.ones(3)
        colour: list[float] = (self._constant * white).tolist()
        return colour


def from_list(props: Properties, value: Any, array: NDArray[np.float64]) -> Pairs:
    """The spectrum of a list of pairs, `array` by their numbers."""
    if array.ndim != 2 or array.shape[1] != 2 or len(array) < 2:
        problem = f"must be a number, or two or more pairs of wavelength and value, found {describe(value)}"
        raise props.error("value", problem)
    try:
        return pairs_of(array[:, 0], array[:, 1])
    except SceneError as error:
        raise props.error("value", f"{error}, found {describe(value)}") from None


def from_file(props: Properties) -> Pairs:
    """The spectrum in a text file."""
    with props.naming("filename"):
        wavelengths, values = read_pairs(resolve(props.string("filename")))
        return pairs_of(np.array(wavelengths), np.array(values))


register_texture("spectrum", SpectrumTexture)

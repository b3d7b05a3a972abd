"""The colours of spectra that are given by a constant or by several wavelengths."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array, describe, numbers_in
from djpt.description.files import read_pairs, resolve
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.errors import SceneError
from djpt.images.colorimetry import XYZ_TO_RGB, spectrum_to_rgb
from djpt.jit.types import Color3f
from djpt.textures.rgb import ConstantTexture

__all__ = ["Pairs", "SpectrumTexture", "TabulatedSpectrum", "list_of_numbers", "nested_pairs", "pairs_of"]

Pairs = tuple[list[float], list[float]]
"""Increasing wavelengths in nm, and a value for each: linear in between, 0 outside."""


class TabulatedSpectrum(ConstantTexture):
    """The colour of a spectrum, computed when it is loaded or edited: rendering is in linear sRGB.

    Reflectances are seen under D65, radiances are not: a constant reflectance is grey, a constant radiance is the
    white of equal energies, (1.205, 0.948, 0.909) per unit. Colours that sRGB can't show are clipped to the range of
    the parameter that they are used for.
    """

    def __init__(self, props: Properties, pairs: Pairs) -> None:
        self._pairs = pairs
        self._emitted = False
        self._highest: float = np.inf
        super().__init__(Properties(props.plugin_name(), props.node, {"value": self._colour()}, props.id()))

    def pairs(self) -> Pairs:
        """The wavelengths and values."""
        return self._pairs

    def set_pairs(self, pairs: Pairs) -> None:
        """Take another spectrum."""
        self._pairs = pairs
        self.value = Color3f(*self._colour())

    def _colour(self) -> list[float]:
        colour = spectrum_to_rgb(*self._pairs, under_d65=not self._emitted)
        clipped: list[float] = np.minimum(colour, self._highest).tolist()
        return clipped

    def used_by(self, kind: str) -> None:
        if kind == "emitter" and not self._emitted:
            self._emitted = True
            self.value = Color3f(*self._colour())

    def restrict(self, allowed: Allowed, where: str) -> None:
        if allowed.high is not None and allowed.high < self._highest:
            self._highest = allowed.high
            self.value = Color3f(*self._colour())
        super().restrict(allowed, where)


def pairs_of(wavelengths: NDArray[np.float64], values: NDArray[np.float64]) -> Pairs:
    """Check a spectrum; raise `SceneError` unless there are two or more increasing wavelengths with a value each."""
    if wavelengths.shape != values.shape or len(wavelengths) < 2:
        raise SceneError(
            f"must be two or more values, one per wavelength: found {values.size} for {wavelengths.size} wavelengths"
        )
    if not (np.diff(wavelengths) > 0).all():
        raise SceneError("must have increasing wavelengths")
    return wavelengths.tolist(), values.tolist()


def nested_pairs(props: Properties) -> Pairs:
    """The pairs of the nested spectrum `value`: another way to give wavelengths and values."""
    nested = props.raw("value")
    if not isinstance(nested, TabulatedSpectrum) or len(nested.pairs()[0]) < 2:
        raise props.error("value", "must be a 'spectrum' of several wavelengths")
    return nested.pairs()


def list_of_numbers(props: Properties, key: str) -> NDArray[np.float64]:
    """The numbers of an entry, a list or text with commas or spaces in between, (n,) float64."""
    value: Any = props.raw(key)
    with props.naming(key):
        return as_array(numbers_in(value) if isinstance(value, str) else value).reshape(-1)


# ---- the texture -----------------------------------------------------------------------------


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

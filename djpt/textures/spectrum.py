"""Constant spectra, as colours."""

from __future__ import annotations

from typing import Any

import numpy as np

from djpt.description.allowed import Allowed
from djpt.description.numeric import as_array, describe
from djpt.description.properties import Properties
from djpt.description.registry import register_texture
from djpt.errors import SceneError
from djpt.images.colorimetry import XYZ_TO_RGB, spectrum_to_rgb
from djpt.textures.rgb import ConstantTexture
from djpt.types import Color3f

__all__ = ["SpectrumTexture"]


class SpectrumTexture(ConstantTexture):
    """A spectrum, turned into its colour when it is loaded: rendering is in linear sRGB.

    Parameters: `value` (one number for a constant spectrum, or pairs of a wavelength in nm and a value, linear in
    between; required). Reflectances are seen under D65, radiances are not: a constant reflectance is grey, a constant
    radiance is the white of equal energies, (1.205, 0.948, 0.909) per unit. Colours that sRGB can't show are clipped
    to the range of the parameter. As a parameter it is a colour, as in Mitsuba's RGB variants.
    """

    def __init__(self, props: Properties) -> None:
        value = props.raw("value")
        self._pairs = self._read(value, props)
        if self._pairs is not None:
            colour = spectrum_to_rgb(*self._pairs, under_d65=True).tolist()
            props = Properties(props.plugin_name(), props.node, {"value": colour}, props.id())
        super().__init__(props)
        self._reflected = self.value
        """The colour of a reflectance; a radiance of these numbers has another."""

    @staticmethod
    def _read(value: Any, props: Properties) -> tuple[list[float], list[float]] | None:
        """Wavelengths and values; None for a number."""
        try:
            array = as_array(value)
        except SceneError as error:
            raise props.error("value", str(error)) from None
        if array.ndim == 0:
            return None
        if array.ndim != 2 or array.shape[1] != 2 or len(array) < 2:
            problem = f"must be a number, or two or more pairs of wavelength and value, found {describe(value)}"
            raise props.error("value", problem)
        if not (np.diff(array[:, 0]) > 0).all():
            raise props.error("value", f"must have increasing wavelengths, found {describe(value)}")
        return array[:, 0].tolist(), array[:, 1].tolist()

    def used_by(self, kind: str) -> None:
        if kind == "emitter" and self._pairs is not None:
            self.value = Color3f(*spectrum_to_rgb(*self._pairs, under_d65=False).tolist())
        elif kind == "emitter":
            self.value = self._reflected * Color3f(*XYZ_TO_RGB.sum(axis=1).tolist())

    def restrict(self, allowed: Allowed, where: str) -> None:
        if self._pairs is not None and allowed.high is not None:
            self.value = Color3f(*np.minimum(self._numbers(self.value), allowed.high).tolist())
        super().restrict(allowed, where)


register_texture("spectrum", SpectrumTexture)

"""The light of black bodies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from djpt.core.numeric import as_number
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.images.colorimetry import LONGEST, SHORTEST
from djpt.textures.spectrum import Pairs, TabulatedSpectrum, pairs_of

__all__ = ["BlackBody"]

SPEED_OF_LIGHT, PLANCK, BOLTZMANN = 2.99792458e8, 6.62607004e-34, 1.38064852e-23
"""In m/s, J s and J/K (CODATA 2014)."""

STEPS = 1000
"""The wavelengths at which the spectrum is computed, as many as colours are summed over."""


class BlackBody(TabulatedSpectrum):
    """The spectrum of a black body, as a colour: see `TabulatedSpectrum`.

    By Planck's law, 2 h c^2 / (l^5 (exp(h c / (l k T)) - 1)), in W / (m^2 sr nm). Mitsuba's RGB variants load this
    texture, but can't render it: its colour here is that of a `spectrum` with the same numbers.

    Parameters: `temperature` T in kelvin (> 0, required), `wavelength_min`, `wavelength_max` (nm, default 360 and 830):
    there is no light outside. In `traverse`: `temperature`, which has no derivatives.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        self.temperature = props.float("temperature", low=0.0, low_open=True)
        low = props.float("wavelength_min", SHORTEST, low=0.0)
        high = props.float("wavelength_max", LONGEST, low=low, low_open=True)
        self._limits = max(low, SHORTEST), min(high, LONGEST)
        if self._limits[0] >= self._limits[1]:
            raise props.error("wavelength_max", f"leaves no visible light, found {low:.9g} to {high:.9g} nm")
        super().__init__(props, self._spectrum())

    def _spectrum(self) -> Pairs:
        wavelengths = np.linspace(*self._limits, STEPS)
        metres = wavelengths * 1e-9
        # A factor exp(-x) above and below, so that low temperatures don't overflow.
        # The temperature comes last: its product with the constant of Boltzmann may vanish.
        with np.errstate(over="ignore"):
            x = PLANCK * SPEED_OF_LIGHT / BOLTZMANN / metres / self.temperature
        power = 2e-9 * PLANCK * SPEED_OF_LIGHT**2 / metres**5 * np.exp(-x) / -np.expm1(-x)
        return pairs_of(wavelengths, power)

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("temperature", self.temperature, ParamFlags.NonDifferentiable)

    def check_parameter(self, name: str, value: Any) -> Any:
        number = as_number(value)
        Allowed(0.0, low_open=True).require(np.array([number]))
        return number

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self.set_pairs(self._spectrum())


register_texture("blackbody", BlackBody)

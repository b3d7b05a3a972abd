"""Spectra given by equidistant wavelengths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.numeric import as_array
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_texture
from djpt.jit.types import Float
from djpt.textures.spectrum import TabulatedSpectrum, list_of_numbers, nested_pairs, pairs_of

__all__ = ["RegularSpectrum"]


class RegularSpectrum(TabulatedSpectrum):
    """A spectrum at equidistant wavelengths, as a colour: see `TabulatedSpectrum`.

    Mitsuba's RGB variants load this texture, but can't render it: its colour here is that of a `spectrum` with the
    same pairs.

    Parameters: `wavelength_min`, `wavelength_max` (in nm, required), `values` (a list, or text with commas in between;
    required); or `value`, a nested `spectrum`. In `traverse`: `range` and `values`, which have no derivatives.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        if "value" in props and "values" not in props:
            wavelengths, values = (np.array(numbers) for numbers in nested_pairs(props))
            low, high = float(wavelengths[0]), float(wavelengths[-1])
            if not np.allclose(np.diff(wavelengths), (high - low) / (len(values) - 1), rtol=1e-3):
                raise props.error("value", "must have equidistant wavelengths; 'irregular' takes any")
        else:
            low = props.float("wavelength_min", low=0.0)
            high = props.float("wavelength_max", low=low, low_open=True)
            values = list_of_numbers(props, "values")
        self.range = dr.scalar.Array2f(low, high)
        self.samples = Float(values.astype(np.float32))
        with props.naming("values"):
            pairs = pairs_of(np.linspace(low, high, len(values)), values)
        super().__init__(props, pairs)

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("range", self.range, ParamFlags.NonDifferentiable)
        callback.put("values", self.samples, ParamFlags.NonDifferentiable, "samples")

    def check_parameter(self, name: str, value: Any) -> Any:
        return value

    def parameters_changed(self, keys: Sequence[str]) -> None:
        values = as_array(self.samples).reshape(-1)
        self.set_pairs(pairs_of(np.linspace(self.range[0], self.range[1], len(values)), values))


register_texture("regular", RegularSpectrum)

"""Spectra given by wavelengths at any distances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from djpt.core.numeric import as_array
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_texture
from djpt.jit.types import Float
from djpt.textures.spectrum import TabulatedSpectrum, list_of_numbers, nested_pairs, pairs_of

__all__ = ["IrregularSpectrum"]


class IrregularSpectrum(TabulatedSpectrum):
    """A spectrum at any wavelengths, as a colour: see `TabulatedSpectrum`.

    Mitsuba's RGB variants load this texture, but can't render it: its colour here is that of a `spectrum` with the
    same pairs.

    Parameters: `wavelengths` (in nm, increasing) and `values` (lists, or text with commas in between; required); or
    `value`, a nested `spectrum`. In `traverse`: `wavelengths` and `values`, which have no derivatives.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        if "value" in props and "values" not in props:
            wavelengths, values = (np.array(numbers) for numbers in nested_pairs(props))
        else:
            wavelengths, values = list_of_numbers(props, "wavelengths"), list_of_numbers(props, "values")
        self.wavelengths, self.samples = (Float(x.astype(np.float32)) for x in (wavelengths, values))
        with props.naming("values"):
            pairs = pairs_of(wavelengths, values)
        super().__init__(props, pairs)

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("wavelengths", self.wavelengths, ParamFlags.NonDifferentiable)
        callback.put("values", self.samples, ParamFlags.NonDifferentiable, "samples")

    def check_parameter(self, name: str, value: Any) -> Any:
        return value

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self.set_pairs(pairs_of(as_array(self.wavelengths).reshape(-1), as_array(self.samples).reshape(-1)))


register_texture("irregular", IrregularSpectrum)

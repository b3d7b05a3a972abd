"""The same call in djpt and in Mitsuba: `same(lambda m: m.fresnel(0.5, 1.5), mi)`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import numpy as np

import djpt
from tests.kit.arrays import in_numpy

__all__ = ["parts", "same"]


def parts(value: Any) -> Iterator[np.ndarray]:
    """The numbers of a result: of an array, or of all arrays in tuples and lists."""
    if dr.is_array_v(value) and dr.is_complex_v(value):
        yield from parts([dr.real(value), dr.imag(value)])
    elif dr.is_array_v(value):
        yield in_numpy(value)
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from parts(part)
    else:
        yield np.asarray(value, np.float64)


def same(call: Callable[[Any], Any], mi: Any, rtol: float = 1e-5, atol: float = 2e-6) -> None:
    """Fail unless a call gives the same numbers with both modules, in the same structure."""
    ours, theirs = list(parts(call(djpt))), list(parts(call(mi)))
    assert len(ours) == len(theirs)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(*np.broadcast_arrays(a.squeeze(), b.squeeze()), rtol=rtol, atol=atol)

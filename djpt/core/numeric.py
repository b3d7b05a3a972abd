"""Numbers, vectors and matrices in a scene description: the accepted types, and their checks.

Plain Python and NumPy numbers and the width-1 arrays of Dr.Jit and Mitsuba are accepted if
they are finite in single precision, in which kernels compute. The errors raised here don't
name the node: the caller knows it.
"""

from __future__ import annotations

import math
import operator
import reprlib
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.limits import LARGEST
from djpt.errors import SceneError
from djpt.jit.frozen import recording
from djpt.jit.kernels import may_wait

__all__ = [
    "as_array",
    "as_integer",
    "as_number",
    "as_type",
    "as_vector",
    "cross_product",
    "describe",
    "is_finite",
    "non_negative",
    "numbers_in",
    "whole",
]

FEW = 16
"""The most numbers, those of a matrix, that are checked sooner one by one than as an array."""

_shorten = reprlib.Repr()
_shorten.maxstring = _shorten.maxother = 60
_shorten.maxlist = _shorten.maxtuple = _shorten.maxdict = 8


def describe(value: Any) -> str:
    """Describe a value for a message: ``str 'abc'``, ``list [1, 2]``."""
    if value is None:
        return "None"
    try:
        text = " ".join(_shorten.repr(value).split())
    except Exception:  # a foreign object may fail in its own repr
        text = ""
    name = type(value).__name__
    return text if text.startswith(name) else f"{name} {text}".rstrip()


def as_array(value: Any) -> NDArray[np.float64]:
    """Convert `value` to float64 numbers; the lane axis of width-1 Dr.Jit arrays is dropped.

    Raises:
        SceneError: not numbers, numbers of unequal length, not finite, or attached to a gradient.
    """
    if type(value) in (list, tuple) and {*map(type, value)} == {float}:
        # Most are lists of numbers, and what follows takes five times as long.
        array = np.array(value)
        if not is_finite(array):
            raise SceneError(f"must be finite in single precision, found {describe(value)}")
        return array
    # NumPy would convert strings and booleans, and the conversion of objects is unpredictable.
    if value is None or isinstance(value, (str, bytes, bool, dict, set, type)):
        raise SceneError(f"must be numbers, found {describe(value)}")
    jit = dr.is_array_v(value)
    if jit and dr.grad_enabled(value):
        raise SceneError("must be plain numbers, found an array with gradients, which would be lost here")
    if jit and recording() and value.state != dr.VarState.Literal:
        raise SceneError(
            "can't be read while dr.freeze records a function: its value is another one in the next call; "
            "set it before the call, or make the function's other results depend on it"
        )
    try:
        with may_wait():
            found = from_device(dr.detach(value)) if jit else np.array(value)
        if found.dtype.kind not in "iuf":
            raise SceneError(f"must be numbers, found {describe(value)}")
        # Always a new array, which its owner may change.
        array = found.astype(np.float64, copy=False)
    except SceneError:
        raise
    except Exception as error:
        raise SceneError(f"must be numbers, found {describe(value)}") from error
    if not is_finite(array):
        raise SceneError(f"must be finite in single precision, found {describe(value)}")
    return array


def is_finite(array: NDArray[np.float64]) -> bool:
    """True if all numbers are finite in single precision."""
    if array.size <= FEW:
        found = array.ravel().tolist()
        # NaN makes comparisons false, but not those of `min` and `max` for sure.
        return all(map(math.isfinite, found)) and (not found or (min(found) >= -LARGEST and max(found) <= LARGEST))
    return bool((np.abs(array) <= LARGEST).all())


def from_device(value: Any) -> NDArray[Any]:
    """Read the contents of a Dr.Jit array; lanes are the last axis, unless there is only one.

    NumPy's own conversion would compile a kernel to interleave the components, and another one for
    every new literal.
    """
    if not dr.is_jit_v(value) or dr.is_tensor_v(value) or dr.width(value) != 1:
        return np.array(value)
    dr.eval(value)

    def read(part: Any) -> Any:
        return part[0] if dr.depth_v(part) == 1 else [read(component) for component in part]

    return np.array(read(value))


class AttachedNumber(float):
    """A number on the host that knows the Dr.Jit number, attached to gradients, that it was made from."""

    lanes: Any

    def __new__(cls, lanes: Any) -> AttachedNumber:
        """Read a `Float` of width 1."""
        number = super().__new__(cls, as_number(dr.detach(lanes)))
        number.lanes = lanes
        return number


def as_number(value: Any) -> float:
    """Convert to a finite float; raise `SceneError` for anything else."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = float("inf")
        # `not <=` is also true for NaN.
        if not abs(number) <= LARGEST:
            raise SceneError(f"must be finite in single precision, found {describe(value)}")
        return number
    if not (isinstance(value, (np.ndarray, np.number)) or dr.is_array_v(value)):
        raise SceneError(f"must be a float, found {describe(value)}")
    array = as_array(value)
    if array.ndim != 0:
        raise SceneError(f"must be a float, found {describe(value)}")
    return float(array)


def as_integer(value: Any) -> int:
    """Convert to a whole number; raise `SceneError` for anything else. Floats are refused, as in Mitsuba."""
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool):
        return int(value)
    if isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iu":
        return int(value)
    if dr.is_array_v(value) and dr.is_integral_v(value) and dr.depth_v(value) == 1 and dr.width(value) == 1:
        return int(value[0])
    raise SceneError(f"must be an integer, found {describe(value)}")


def as_vector(value: Any) -> NDArray[np.float64]:
    """Convert to three finite numbers, (3,) float64; raise `SceneError` for anything else."""
    array = as_array(value)
    if array.shape != (3,):
        raise SceneError(f"must be three numbers, found {describe(value)}")
    return array


def as_type(kind: Any, value: Any) -> Any:
    """Convert numbers in any form, one per lane or a single one, to a type of Dr.Jit's or Python's.

    Raises:
        SceneError: they can't be converted.
    """
    try:
        return kind(_plain(value))
    except Exception:
        count = dr.size_v(kind) if dr.is_array_v(kind) and dr.depth_v(kind) > dr.is_jit_v(kind) else 1
        wanted = {1: "a number", 2: "two numbers", 3: "three numbers"}.get(count, f"{count} numbers")
        raise SceneError(f"must be {wanted}, found {describe(value)}") from None


def _plain(value: Any) -> Any:
    """`value` with Python's numbers in place of single numbers of NumPy, which Dr.Jit's vectors don't take."""
    if isinstance(value, (list, tuple)):
        return [_plain(x) for x in value]
    return value.item() if isinstance(value, np.generic) else value


def cross_product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The cross product of two vectors (3,): a tenth of the time that NumPy's takes, which is for many."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def non_negative(value: Any) -> float:
    """Convert to a finite number that is at least 0.

    Raises:
        SceneError: anything else.
    """
    number = as_number(value)
    if number < 0:
        raise SceneError(f"must be at least 0, found {number:g}")
    return number


def numbers_in(text: str) -> list[float]:
    """The numbers in a text, separated by commas or spaces.

    Raises:
        SceneError: a word isn't a number.
    """
    try:
        return [float(word) for word in text.replace(",", " ").split()]
    except ValueError as error:
        raise SceneError(f"must be numbers separated by commas, found {describe(text)} ({error})") from None


def whole(value: Any) -> int | None:
    """Python's or another library's integer, or a Dr.Jit array of one, as an int; None for anything else."""
    if dr.is_array_v(value) and dr.is_integral_v(value) and dr.width(value) == 1:
        value = value[0]
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None

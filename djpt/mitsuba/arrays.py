"""Array types under Mitsuba's names: ``djpt.Vector2u``, ``djpt.ScalarPoint3f``, ``djpt.TensorXu8``.

Vectors, points, normals and colours of a size are one type, Dr.Jit's array. Names that begin with ``Scalar`` stand for
types without lanes: arrays of `drjit.scalar`, and Python's `float`, `int` and `bool`.
"""

from __future__ import annotations

from typing import Any

import drjit.scalar

from djpt.jit.types import backend
from djpt.mitsuba.names import ARRAYS, SCALAR

__all__ = list(ARRAYS)


def __getattr__(name: str) -> Any:
    """The type of a name."""
    if name not in ARRAYS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(drjit.scalar if name.startswith(SCALAR) else backend, ARRAYS[name])


def __dir__() -> list[str]:
    return __all__

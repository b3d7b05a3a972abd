"""`as_float` and `as_vector` under the name that plugins imported them by up to version 0.1: see `djpt.kernels`."""

from __future__ import annotations

from djpt.kernels import as_float, as_vector

__all__ = ["as_float", "as_vector"]

"""The arithmetic of formulas that serve kernels and compiled functions alike.

A formula that takes its functions from a namespace can be written once: Dr.Jit traces it with `KERNELS`, and
`djpt.jit.llvm.arithmetic` has functions of the same names that write IR.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, Protocol

import drjit as dr

from djpt.jit.kernels import maximum, minimum

__all__ = ["KERNELS", "Arithmetic"]


class Arithmetic(Protocol):
    """Functions of numbers: of Dr.Jit's, or of those of `djpt.jit.llvm.arithmetic`."""

    fma: Callable[..., Any]
    rcp: Callable[..., Any]
    sqrt: Callable[..., Any]
    abs: Callable[..., Any]
    select: Callable[..., Any]
    minimum: Callable[..., Any]
    maximum: Callable[..., Any]


KERNELS: Any = SimpleNamespace(
    fma=dr.fma, rcp=dr.rcp, sqrt=dr.sqrt, abs=dr.abs, select=dr.select, minimum=minimum, maximum=maximum
)
"""The arithmetic of Dr.Jit."""

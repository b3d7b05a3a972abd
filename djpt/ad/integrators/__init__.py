"""The place where scripts look for differentiable integrators, to use or to derive from."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["common", "direct_projective", "prb", "prb_basic", "prb_projective", "prbvolpath", "volprim_rf_basic"]


def __getattr__(name: str) -> Any:
    """Import a module when it is first used (PEP 562)."""
    if name in __all__:
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""Keeping traces reproducible, so that compiled kernels are found again."""

from __future__ import annotations

import drjit as dr

from djpt.types import Float

__all__ = ["begin_trace"]


def begin_trace() -> None:
    """Trace what follows independently of what was traced before.

    Dr.Jit merges equal subexpressions, literals included, within a scope. Without a scope of
    its own, a kernel would share literals with whatever happens to be alive, and the same
    render would compile twice: once with and once without them.
    """
    dr.detail.new_scope(dr.backend_v(Float))

"""What a script asks about the variant, and the change of variant for a while."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Final

from djpt.jit.backends import set_variant, variant

__all__ = ["is_monochromatic", "is_polarized", "is_rgb", "is_spectral", "scoped_set_variant", "variant_context"]

is_rgb: Final = True
is_monochromatic: Final = False
is_spectral: Final = False
is_polarized: Final = False


@contextlib.contextmanager
def variant_context(*names: str) -> Iterator[None]:
    """``set_variant(*names)`` for the block of a ``with``; then the variant that was set before.

    Raises:
        BackendError: see `djpt.set_variant`.
    """
    before = variant()
    set_variant(*names)
    try:
        yield
    finally:
        set_variant(before)


scoped_set_variant = variant_context
"""Another name of `variant_context`."""

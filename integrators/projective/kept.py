"""Samples that only their derivatives are asked of."""

from __future__ import annotations

from typing import Any

import drjit as dr

__all__ = ["keep"]

MOST_LANES = 1 << 21
"""The samples that are stored at most."""


def keep(*values: Any) -> None:
    """Compute samples before anything is attached to them, so that derivatives don't compute them again.

    Of many samples storage would be the limit: they are computed again.
    """
    known = [value for value in values if value is not None]
    if dr.width(known) <= MOST_LANES:
        dr.eval(known)

"""Paths from both ends: what each strategy finds."""

from __future__ import annotations

import djpt
from djpt.images.sheets import captioned_rows
from djpt.validation.ladder.pyramid import pyramid
from places import IMAGES

__all__ = ["strategies"]


def strategies() -> None:
    """The pyramids of strategies, weighted and alone, of paths of 2 to 5 edges in the box with the glass ball."""
    rows = pyramid("glass_ball", 5, 256, width=112)
    half = len(rows) // 2
    for name, part in (("strategies", rows[:half]), ("strategies_alone", rows[half:])):
        djpt.write(IMAGES / f"{name}.png", captioned_rows(part))

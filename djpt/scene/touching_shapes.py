"""Shapes that touch each other, or nearly so, and are parts of one body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from djpt.jit.types import UInt32

__all__ = ["Bodies", "in_touch"]

NEAR = 0.1
"""The gap that counts as none, as a fraction of the smaller shape."""

MOST_SHAPES = 1 << 10
"""The number of shapes of which it is looked for who touches whom."""


@dataclass(frozen=True)
class Bodies:
    """The bodies of a scene: shapes that derivatives take for parts of one."""

    of_shape: UInt32
    """The number of the body of each shape; the largest number for shapes that belong to none."""
    moving: tuple[int, ...]
    """The shapes of those bodies on which points of paths move."""


def in_touch(shapes: Sequence[Any]) -> list[int]:
    """For each of some shapes the first one that it is in touch with, directly or by way of others; else itself.

    Shapes count as touching if the boxes around them do, but for a gap. Points of paths pass others at the distance of
    the gap, which is noise enough. Of more than `MOST_SHAPES` shapes all are in touch.
    """
    if len(shapes) > MOST_SHAPES or not shapes:
        return [0] * len(shapes)
    low, high = (np.array(ends) for ends in zip(*(shape.world_box() for shape in shapes), strict=True))
    slack = NEAR * np.linalg.norm(high - low, axis=1)
    first = np.arange(len(shapes))
    for i in range(1, len(shapes)):
        gap = np.maximum(low[:i] - high[i], low[i] - high[:i]).max(axis=1)
        met = np.unique(first[:i][gap <= np.minimum(slack[:i], slack[i])])
        if met.size:
            first[i] = met[0]
            first[:i][np.isin(first[:i], met)] = met[0]
    return [int(number) for number in first]

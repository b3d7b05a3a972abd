"""Where surfaces meet in curves: shapes that cut or touch each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from djpt.scene.intersecting_shapes import may_intersect

__all__ = ["meeting_pairs"]


def meeting_pairs(shapes: Sequence[Any], moving: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
    """The pairs of shapes that may cut or touch each other, of which one is among the `moving`."""
    numbers = {id(shape) for shape in moving}
    moved: list[Any] = []  # of those before
    for i, shape in enumerate(shapes):
        moves = id(shape) in numbers
        for other in shapes[:i] if moves else moved:
            if may_intersect(shape, other):
                yield shape, other
        if moves:
            moved.append(shape)

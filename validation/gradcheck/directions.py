"""Directions in which a parameter is changed to measure its derivative."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["Direction", "directions_of"]

Floats = npt.NDArray[np.float64]


class Direction(NamedTuple):
    """A change of a parameter: the derivative in its direction is a number."""

    name: str
    vector: Floats
    """The change of each entry, (n,)."""


def directions_of(inward: Floats, slopes: Floats, samples: int, seed: int) -> list[Direction]:
    """The directions that a parameter of some entries is checked in.

    Up to four entries: each by itself. More: all together; two random combinations of signs, which no error of an entry
    that matters survives; and `samples` entries, half of them those of the largest `slopes`, half drawn at random.

    Args:
        inward: 1 for entries that can only grow, -1 for those that can only shrink, 0 for the others, (n,): where many
            entries change at once, such entries change inwards, so that the parameter keeps its range.
        slopes: The derivative with respect to each entry, (n,).
        samples: The number of single entries.
        seed: The seed of what is drawn.
    """
    count = inward.size
    if count <= 4:
        names = ("",) if count == 1 else tuple(f"[{i}]" for i in range(count))
        return [Direction(name, row) for name, row in zip(names, np.eye(count), strict=True)]
    rng = np.random.default_rng(seed)
    signs = [("all entries", np.ones(count))]
    signs += [(f"random signs {i}", rng.choice([-1.0, 1.0], count)) for i in (1, 2)]
    found = [Direction(name, np.where(inward == 0, row, inward)) for name, row in signs]
    largest = np.argsort(-np.abs(slopes))[: samples // 2]
    drawn = rng.choice(count, size=min(count, samples - len(largest)), replace=False)
    for entry in dict.fromkeys([*largest.tolist(), *drawn.tolist()]):
        vector = np.zeros(count)
        vector[entry] = 1.0
        found.append(Direction(f"entry {entry}", vector))
    return found

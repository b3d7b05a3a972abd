"""Derivatives of images compared with differences block by block: sums over an image may hide what cancels.

A derivative that puts light into the wrong pixels, or misses an edge whose two sides have weights alike, may have the
right sum. Its map has not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.validation.statistics import Batches, TestResult, pixel_test, z_map
from tests.gradients.cells import Cell, Scene

__all__ = ["BlockMap", "block_map"]

BLOCK = 8
"""The side of a block in pixels."""

SIGNIFICANCE = 1e-4
"""The probability that noise alone puts any block of a map beyond its bound."""

SPREAD = 1.5
"""The root mean square of deviates up to which derivatives are right: that of noise alone is about 1."""


@dataclass(frozen=True)
class BlockMap:
    """The comparison of a derivative image with one of differences."""

    z: NDArray[np.float64]
    """The difference of each block (rows, columns) as a normal deviate, by Welch's test."""
    worst: TestResult
    """The test of the block with the largest deviate: the bound is Sidak's for so many blocks."""
    found: NDArray[np.float64]
    """The means of blocks by forward mode, (rows, columns), ..."""
    expected: NDArray[np.float64]
    """... and by differences."""

    @property
    def spread(self) -> float:
        """The root mean square of the deviates."""
        return float(np.sqrt(np.mean(self.z**2)))

    @property
    def right(self) -> bool:
        """Whether noise explains all differences."""
        return self.spread < SPREAD and self.worst.passed

    def __str__(self) -> str:
        row, column, _ = self.worst.where
        pair = f"{self.found[row, column]:.4g} for {self.expected[row, column]:.4g}"
        return f"root mean square of z {self.spread:.2f} (< {SPREAD}); {self.worst}, {pair}"


def block_map(cell: Cell, seeds: int, seeds_of_differences: int, step: float, **settings: Any) -> BlockMap:
    """Compare the derivative image of a cell, the mean of its colours, with central differences.

    Args:
        cell: The scene and what moves.
        seeds: The number of derivative images.
        seeds_of_differences: The number of pairs of images.
        step: That of differences: small enough for edges to stay in a block.
        settings: Attributes of the integrator.
    """
    # Maps have no weights.
    scene = Scene(replace(cell, picture=0.0))
    for name, value in settings.items():
        setattr(scene.scene.integrator(), name, value)
    found, expected = Batches(), Batches()
    for seed in range(seeds):
        found.add(blocks(scene.forward_image(2 * seed + 5001)))
    for seed in range(seeds_of_differences):
        expected.add(blocks(scene.difference_image(seed, step)))
    z = z_map(found, expected, equal_variance=False)
    worst = pixel_test(found, expected, SIGNIFICANCE, equal_variance=False)
    return BlockMap(z, worst, found.mean[..., 0], expected.mean[..., 0])


def blocks(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """The means of all colours of blocks, (rows, columns, 1)."""
    rows, columns = (side // BLOCK for side in image.shape[:2])
    found: NDArray[np.float64] = image.reshape(rows, BLOCK, columns, BLOCK, -1).mean(axis=(1, 3, 4))[..., None]
    return found

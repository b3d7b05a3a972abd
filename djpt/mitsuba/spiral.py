"""The order in which a picture can be rendered block by block, from its middle outwards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count

from djpt.description.plugin import Plugin
from djpt.errors import RenderError
from djpt.jit.types import ScalarArray2i, ScalarArray2u

__all__ = ["Spiral"]

STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""Right, down, left, up."""
END = 0xFFFFFFFF
"""The number of the block after the last."""


class Spiral(Plugin):
    """Square blocks of pixels along a spiral that begins in the middle of the picture.

    Args:
        size: width and height of the picture.
        offset: its place in a larger frame, added to the places of blocks.
        block_size: the side of a block; those at the right and lower edge may be smaller.
        passes: how often the spiral is run through.

    Raises:
        RenderError: `block_size` or `passes` isn't positive.
    """

    def __init__(self, size: Sequence[int], offset: Sequence[int], block_size: int = 32, passes: int = 1) -> None:
        super().__init__()
        if block_size < 1 or passes < 1:
            raise RenderError(f"Spiral: at least one pixel and one pass are needed, found {block_size} and {passes}")
        self._size, self._offset = [int(n) for n in size], [int(n) for n in offset]
        self._block_size, self._passes_left = int(block_size), int(passes)
        self.reset()

    def max_block_size(self) -> int:
        """The side of a block."""
        return self._block_size

    def block_count(self) -> int:
        """The number of blocks of one pass."""
        columns, rows = self._blocks()
        return columns * rows

    def reset(self) -> None:
        """Begin the present pass again."""
        self._number = 0
        self._places = self._along()

    def next_block(self) -> tuple[ScalarArray2i, ScalarArray2u, int]:
        """The place, the size and the number of the next block; after the last one the size is 0 x 0.

        Numbers differ between passes; those of the last pass begin at 0.
        """
        if self._number == self.block_count():
            if self._passes_left == 1:
                return ScalarArray2i(0), ScalarArray2u(0), END
            self._passes_left -= 1
            self.reset()
        corner = [n * self._block_size for n in next(self._places)]
        size = [min(self._block_size, whole - start) for whole, start in zip(self._size, corner, strict=True)]
        number = self._number + (self._passes_left - 1) * self.block_count()
        self._number += 1
        place = [start + shift for start, shift in zip(corner, self._offset, strict=True)]
        return ScalarArray2i(*place), ScalarArray2u(*size), number

    def _blocks(self) -> tuple[int, int]:
        """The number of blocks per row and per column."""
        columns, rows = (-(-n // self._block_size) for n in self._size)
        return columns, rows

    def _along(self) -> Iterator[tuple[int, int]]:
        """The columns and rows of blocks along the spiral, whose legs are 1, 1, 2, 2, 3, 3 .. blocks long."""
        columns, rows = self._blocks()
        x, y = columns // 2, rows // 2
        for leg in count():
            dx, dy = STEPS[leg % 4]
            for _ in range(leg // 2 + 1):
                if 0 <= x < columns and 0 <= y < rows:
                    yield x, y
                x, y = x + dx, y + dy

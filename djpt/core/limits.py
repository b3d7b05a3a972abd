"""Limits of descriptions, so that a small file can't ask for endless time or memory."""

from __future__ import annotations

__all__ = [
    "LARGEST",
    "MAX_DEPTH",
    "MAX_FILES",
    "MAX_INCLUDES",
    "MAX_NAME",
    "MAX_NODES",
    "MAX_NUMBERS",
    "MAX_PARTS",
    "NUMBERS_PER_BYTE",
]

LARGEST = (2 - 2**-23) * 2.0**127
"""The largest number of float32, in which kernels compute."""

MAX_DEPTH = 32
"""Deepest nesting of nodes. Real scenes need about five levels."""

MAX_NODES = 500_000
"""Most nodes of a scene: a dict that stands in another one twice, level by level, grows exponentially."""

MAX_PARTS = 256
"""Most plugins in a material, a texture or a medium; one that is referred to counts each time. Kernels are traced
through all of them. Real materials need about ten."""

MAX_NAME = 1000
"""Longest name of a node, in characters."""

MAX_NUMBERS = 2**24
"""Most numbers of an image that a stranger's file may hold whatever its size: 64 MiB."""

NUMBERS_PER_BYTE = 128
"""Most numbers that each byte of a stranger's larger image may stand for. Photographs have about ten, uniform images up
to a thousand."""

MAX_INCLUDES = 15
"""Deepest nesting of includes, as in Mitsuba."""

MAX_FILES = 1000
"""Most files that one scene reads: includes of includes grow exponentially."""

"""Kernels of a chosen width, to test on one machine what others compute.

``DJPT_TEST_LANES=8 python -m pytest`` compiles all kernels as for a processor with AVX2 and without AVX-512. Besides
the width, its approximate square root differs, so results differ in their last bits.
"""

from __future__ import annotations

import os

from djpt.jit.backends import load_backend
from djpt.jit.llvm.lanes import force_lanes

__all__ = ["VARIABLE", "lanes_from_environment"]

VARIABLE = "DJPT_TEST_LANES"
"""The environment variable for the number of lanes, 8 or 16. Processes that a test starts ignore it."""


def lanes_from_environment() -> None:
    """Force the width that `VARIABLE` asks for, if it is set; before the first kernel of the process."""
    asked = os.environ.get(VARIABLE)
    if asked:
        load_backend()
        force_lanes(int(asked))

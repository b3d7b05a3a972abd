"""Make the pictures of the README and of the documentation: ``python docs/figures [NAME ..]``."""

from __future__ import annotations

import djpt  # noqa: F401 # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import sys

import blur
import box
import cards
import cells
import chains
import comparison
import ends
import estimators
import experiments
import face
import house
import illumination
import measures
import mist
import observers
import packets
import proof
import rounds
import slopes
import surfaces
import vapour
import window
from places import IMAGES

FIGURES = {
    name: getattr(module, name)
    for module in (
        *(proof, face, box, surfaces, illumination, mist, vapour, observers, blur, estimators, ends, slopes),
        *(experiments, rounds, window, comparison, house, chains, packets, cells, measures, cards),
    )
    for name in module.__all__
}
"""All figures by name; `cards` comes last, as it is cut from the others."""


def main() -> None:
    """Make all pictures, or those named on the command line."""
    IMAGES.mkdir(exist_ok=True)
    names = sys.argv[1:] or list(FIGURES)
    unknown = [name for name in names if name not in FIGURES]
    if unknown:
        sys.exit(f"no figure {', '.join(unknown)}; there are: {', '.join(FIGURES)}")
    for name in names:
        FIGURES[name]()


if __name__ == "__main__":
    main()

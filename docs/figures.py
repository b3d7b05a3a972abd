"""Make the pictures of the README and of the documentation: ``python docs/figures.py [NAME ..]``."""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"


def cornell_box() -> None:
    """The Cornell box, as `djpt render cornell_box` makes it, with more pixels and samples."""
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=400, height=400)
    image = djpt.render(djpt.load_dict(description), spp=2048)
    djpt.write(IMAGES / "cornell_box.png", image)


def spheres() -> None:
    """The variant with two spheres."""
    description = djpt.scenes.cornell_box_spheres()
    image = djpt.render(djpt.load_dict(description), spp=1024)
    djpt.write(IMAGES / "spheres.png", image)


def albedo() -> None:
    """What the albedo example writes."""
    with patch.object(sys, "argv", ["albedo.py", "--out", str(IMAGES / "albedo.png")]):
        runpy.run_path(str(DOCS.parent / "examples" / "albedo.py"), run_name="__main__")


FIGURES: dict[str, Callable[[], None]] = {f.__name__: f for f in (cornell_box, spheres, albedo)}


def main() -> None:
    """Make all pictures, or those named on the command line."""
    IMAGES.mkdir(exist_ok=True)
    for name in sys.argv[1:] or FIGURES:
        FIGURES[name]()


if __name__ == "__main__":
    main()

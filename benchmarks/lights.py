"""Times of scenes under an environment map, compared with Mitsuba 3 on the same machine.

    python benchmarks/lights.py [--quick] [--pairs N] [--json FILE]

Twenty diffuse spheres under a sky with a sun, 256x256 pixels, without and with a ground. As in
`versus_mitsuba.py` the renderers take turns. Exit code 1: the required number was missed.
"""

from __future__ import annotations

import djpt  # noqa: F401  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import sys
from collections.abc import Iterator

from light_scenes import spheres_under_sky
from meshes import image_row
from pairs import Row, report


def rows(pairs: int, quick: bool) -> Iterator[Row]:
    """Measure all rows of the table."""
    spp = 32 if quick else 128
    yield image_row("20 spheres under an envmap", lambda m: spheres_under_sky(m, False), pairs, 4, None, spp)
    yield image_row("the same on a ground", lambda m: spheres_under_sky(m, True), pairs, None, None, spp)


if __name__ == "__main__":
    sys.exit(report(__doc__ or "", "Twenty spheres under an environment map, 256x256", rows))

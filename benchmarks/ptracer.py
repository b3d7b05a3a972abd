"""Times of light tracing, compared with Mitsuba 3's `ptracer` on the same machine.

    python benchmarks/ptracer.py [--quick] [--pairs N] [--json FILE]

Measured as in `versus_mitsuba.py`. Both trace as many light paths as the image has samples, and add what they find to
the film by atomic additions: Mitsuba in floating point, djpt in whole numbers, so that its image can be repeated.
Exit code 1: a required ratio was missed.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import sys
from collections.abc import Iterator

import mitsuba as mi
from pairs import Row, in_pairs, report
from versus_mitsuba import cornell_box


def image_row(rfilter: str, spp: int, pairs: int, required: float | None) -> Row:
    """Measure an image, kernels compiled."""
    ours, theirs = (m.load_dict(cornell_box(m, rfilter, "ptracer")) for m in (djpt, mi))
    ratios, times = in_pairs(
        lambda seed: djpt.render(ours, spp=spp, seed=seed), lambda seed: mi.render(theirs, spp=spp, seed=seed), pairs
    )
    return Row(f"light tracing, {rfilter} filter, {spp} spp", required, None, ratios, times)


def all_rows(pairs: int, quick: bool) -> Iterator[Row]:
    """Measure all rows of the table."""
    spp = 16 if quick else 64
    yield image_row("box", spp, pairs, 4)
    yield image_row("gaussian", spp, pairs, None)


if __name__ == "__main__":
    sys.exit(report(__doc__.split("\n")[0], "Cornell box, 256x256, depth 8", all_rows))

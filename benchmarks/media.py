"""Times of scenes with fog and smoke, compared with Mitsuba 3's `volpath` on the same machine.

    python benchmarks/media.py [--quick] [--pairs N] [--json FILE]

The Cornell box in fog and in coloured fog, with bodies of fog in meshes, and with a dense cloud of smoke on grids of
64^3 and 256^3 points. As in `versus_mitsuba.py` the renderers take turns. Exit code 1: a required number was missed.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from media_scenes import cloud, fog, fog_in_meshes, smoke
from mesh_scenes import write_bumpy_sphere
from pairs import Row, in_pairs, report

EVEN = 0.01
"""Errors are relative to radiance^2 + EVEN mean^2: black pixels count as well."""


def render_both(description: Any, spp: int) -> tuple[Any, Any]:
    """Functions of the seed that render ``description(module)`` by djpt and by Mitsuba."""
    ours, theirs = djpt.load_dict(description(djpt)), mi.load_dict(description(mi))
    return (
        lambda seed: djpt.render(ours, spp=spp, seed=seed),
        lambda seed: mi.render(theirs, spp=spp, seed=seed),
    )


def row(what: str, description: Any, spp: int, pairs: int, required: float | None, aim: float | None = None) -> Row:
    """Measure an image, kernels compiled."""
    return Row(what, required, aim, *in_pairs(*render_both(description, spp), pairs))


def equal_error_row(
    what: str, description: Any, spp: int, pairs: int, required: float | None, aim: float | None = None
) -> Row:
    """Measure the ratio of times until both images have the same error: times count with the variance of a sample."""
    images: dict[str, list[Any]] = {"ours": [], "theirs": []}

    def kept(name: str, render: Any) -> Any:
        def rendered(seed: int) -> Any:
            image = render(seed)
            images[name].append(np.array(image))
            return image

        return rendered

    ours, theirs = render_both(description, spp)
    ratios, times = in_pairs(kept("ours", ours), kept("theirs", theirs), pairs)
    mine, reference = (np.array(found) for found in images.values())
    mean = (mine.mean(axis=0) + reference.mean(axis=0)) / 2
    weight = 1 / (mean**2 + EVEN * mean.mean() ** 2)
    gain = float((reference.var(axis=0, ddof=1) * weight).mean() / (mine.var(axis=0, ddof=1) * weight).mean())
    return Row(what, required, aim, [ratio * gain for ratio in ratios], f"{times}, variance {gain:.2f}")


def smoke_rows(pairs: int, quick: bool) -> Iterator[Row]:
    """Measure smoke at two resolutions, and how the time grows with it."""
    size, spp = (96, 8) if quick else (128, 16)
    times = {}
    for resolution, aim in ((64, 12.0), (256, None)):
        density = cloud(resolution)
        found = row(f"smoke, {resolution}^3 points", lambda m, d=density: smoke(m, d, size), spp, min(pairs, 5), 8, aim)
        times[resolution] = float(found.note.split("/")[1].split()[0])
        yield found
    yield Row("  time of 256^3 / time of 64^3", 4, None, [times[256] / times[64]], "at most linear", True)


def all_rows(pairs: int, quick: bool) -> Iterator[Row]:
    """Measure all rows of the table."""
    size, spp = (128, 32) if quick else (256, 32)
    yield row("fog", lambda m: fog(m, False, "volpath", size), spp, pairs, 6, 8)
    yield equal_error_row("fog, at equal error", lambda m: fog(m, False, "volpath", size), spp, pairs, None)
    yield equal_error_row("coloured fog, at equal error", lambda m: fog(m, True, "volpath", size), spp, pairs, 8)
    name = "coloured fog by volpathmis, at equal error"
    yield equal_error_row(name, lambda m: fog(m, True, "volpathmis", size), spp, pairs, None)
    with tempfile.TemporaryDirectory() as folder:
        file = write_bumpy_sphere(Path(folder), 5000)
        yield row("bodies of fog in meshes", lambda m: fog_in_meshes(m, file, size), spp, pairs, 1.4, 2)
    yield from smoke_rows(pairs, quick)


if __name__ == "__main__":
    sys.exit(report(__doc__.split("\n")[0], "the Cornell box, up to 16 edges in fog and 32 in smoke", all_rows))

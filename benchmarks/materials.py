"""Times of scenes of several materials, compared with Mitsuba 3 on the same machine.

    python benchmarks/materials.py [--quick] [--pairs N] [--json FILE]

A Cornell box with a glass and a rough metal sphere; twenty meshes of five kinds of material; 200 spheres of
200 colours. As in `versus_mitsuba.py` the renderers take turns. Exit code 1: a required number was missed.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import drjit as dr
from material_scenes import five_materials, glass_and_gold, many_colours
from mesh_scenes import write_bumpy_sphere
from meshes import image_row
from pairs import Row, report


def box_row(spp: int, pairs: int) -> Row:
    """Measure analytic shapes, in the flat schedule."""
    return image_row("Cornell box, glass and rough gold spheres", glass_and_gold, pairs, 6.5, 9, spp)


def meshes_row(folder: Path, pairs: int) -> Row:
    """Measure triangles, in the machine schedule."""
    files = [write_bumpy_sphere(folder, 5000, seed) for seed in range(20)]
    return image_row(
        "twenty meshes of five classes, 100000 triangles", lambda m: five_materials(m, files), pairs, 1.4, 1.8
    )


def colours_rows(pairs: int) -> Iterator[Row]:
    """Measure 200 spheres with a material each, whose values are read from tables."""
    yield image_row("200 spheres of 200 colours", many_colours, pairs, 1.0, None)
    times = [first_image() for _ in range(3)]
    yield Row("  its first image, seconds", 2, None, [statistics.median(times)], "empty kernel cache", True)


def first_image() -> float:
    """Measure the seconds from the end of the imports to the image, in a process of its own."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "DRJIT_CACHE_DIR": cache}
        command = [sys.executable, __file__, "first"]
        return float(subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout)


def first_alone() -> None:
    """Print the seconds that `first_image` reads from this process."""
    _ = djpt.load_dict, djpt.render, djpt.integrators
    start = time.perf_counter()
    dr.eval(djpt.render(djpt.load_dict(many_colours(djpt)), spp=16))
    dr.sync_thread()
    print(time.perf_counter() - start)


def all_rows(pairs: int, quick: bool) -> Iterator[Row]:
    """Measure all rows of the table."""
    yield box_row(64 if quick else 128, pairs)
    with tempfile.TemporaryDirectory() as name:
        yield meshes_row(Path(name), pairs)
    yield from colours_rows(pairs)


if __name__ == "__main__":
    if sys.argv[1:] == ["first"]:
        first_alone()
    else:
        sys.exit(report(__doc__.split("\n")[0], "256x256, depth 8", all_rows))

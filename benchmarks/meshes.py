"""Times of meshes and many shapes, compared with Mitsuba 3 on the same machine.

    python benchmarks/meshes.py [--quick] [--pairs N] [--json FILE]

Path tracing of bumpy spheres of 10^4 to 10^6 triangles, of twenty meshes with several materials and of
64 analytic shapes; ray queries; building the BVH; the first image of a process. As in
`versus_mitsuba.py` the renderers take turns. Exit code 1: a required number was missed.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from gradients import image_and_gradient
from mesh_scenes import (
    bumpy_sphere,
    instances,
    many_shapes,
    over_floor,
    textured_sphere,
    twenty_meshes,
    write_bumpy_sphere,
)
from pairs import Row, first_image, in_pairs, report

SPP = 32


def image_row(
    what: str, description: Any, pairs: int, required: float | None, aim: float | None, spp: int = SPP
) -> Row:
    """Measure an image, kernels compiled; ``description(module)`` is the scene as djpt or mitsuba describes it."""
    ours, theirs = djpt.load_dict(description(djpt)), mi.load_dict(description(mi))
    ratios, times = in_pairs(
        lambda seed: djpt.render(ours, spp=spp, seed=seed), lambda seed: mi.render(theirs, spp=spp, seed=seed), pairs
    )
    return Row(what, required, aim, ratios, times)


def image_rows(folder: Path, pairs: int, quick: bool) -> Iterator[Row]:
    """Measure images by path tracing."""
    sizes = (10_000, 1.65, 2.0), (100_000, 2.0, 2.4), (1_000_000, 2.2, 2.6)
    for count, required, aim in sizes[:2] if quick else sizes:
        file = write_bumpy_sphere(folder, count)
        yield image_row(
            f"bumpy sphere of {count} triangles",
            lambda m, file=file: over_floor(m, bumpy_sphere(file, True)),
            pairs,
            required,
            aim,
        )
        yield image_row(
            "  with vertex normals, uv and a texture",
            lambda m, file=file: over_floor(m, textured_sphere(m, file)),
            pairs,
            1.7,
            2.2,
        )
    files = [write_bumpy_sphere(folder, 5000, seed) for seed in range(20)]
    yield image_row("twenty meshes of 5000, 8 materials", lambda m: twenty_meshes(m, files), pairs, 1.8, 2.2)
    file = write_bumpy_sphere(folder, 10_000)
    yield image_row("1000 instances of 10000 triangles", lambda m: instances(m, file), min(pairs, 2), 25, None)
    yield image_row("64 analytic shapes", many_shapes, pairs, 4, None)


def gradient_row(folder: Path, pairs: int) -> Row:
    """Measure an image and its gradient by an albedo."""
    file = write_bumpy_sphere(folder, 100_000)

    def gradient(module: Any) -> Any:
        description = over_floor(module, bumpy_sphere(file, True))
        return image_and_gradient(module, description, ["ball.bsdf.reflectance.value"])

    ratios, times = in_pairs(gradient(djpt), gradient(mi), pairs)
    return Row("image and gradient, 100000 triangles, 16 spp", 2.0, 2.3, ratios, times)


def query_rows(folder: Path, pairs: int) -> Iterator[Row]:
    """Measure `ray_intersect` and `ray_test` on incoherent rays, bounces off the bumpy sphere, and on camera rays."""
    file = write_bumpy_sphere(folder, 100_000)
    ours, theirs = (m.load_dict({"type": "scene", "ball": bumpy_sphere(file, True)}) for m in (djpt, mi))
    for kind, (o, d), closest, any_hit in (
        ("incoherent rays", bounces(ours, 2**20), (1.8, 2.3), (2.0, 2.7)),
        ("camera rays", camera_rays(1024), (1.15, 1.4), (1.0, 1.3)),
    ):
        rays = [m.Ray3f(m.Point3f(o), m.Vector3f(d)) for m in (djpt, mi)]
        dr.eval(rays)
        # Embree is the faster for it where rays are coherent, and slower elsewhere.
        coherent = kind == "camera rays"
        for query, (required, aim) in (("ray_intersect_preliminary", closest), ("ray_test", any_hit)):
            ratios, times = in_pairs(
                lambda seed, query=query, rays=rays: getattr(ours, query)(rays[0]),
                lambda seed, query=query, rays=rays, coherent=coherent: getattr(theirs, query)(
                    rays[1], coherent=coherent
                ),
                pairs,
            )
            yield Row(f"{query}, {o.shape[1]} {kind}", required, aim, ratios, times)


def camera_rays(size: int) -> tuple[np.ndarray, np.ndarray]:
    """The origins and directions (3, N) of a camera's rays, row by row."""
    x, y = (np.stack(np.meshgrid(*2 * [np.arange(size)])).reshape(2, -1) + 0.5) / size - 0.5
    d = np.stack([x, -y - 0.15, np.full_like(x, -1)])
    return np.tile([[0], [0.6], [3.2]], (1, size * size)), d / np.linalg.norm(d, axis=0)


def bounces(scene: djpt.Scene, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The origins and directions (3, N) of rays that leave the surface cosine-distributed."""
    rng = np.random.default_rng(0)
    o = rng.normal(size=(3, count))
    o *= 3 / np.linalg.norm(o, axis=0)
    d = rng.uniform(-1, 1, (3, count)) - o
    d /= np.linalg.norm(d, axis=0)
    si = scene.ray_intersect(djpt.Ray3f(djpt.Point3f(o), djpt.Vector3f(d)))
    hit = np.array(si.is_valid())
    p, n, d = (np.array(x)[:, hit] for x in (si.p, si.n, d))
    n *= -np.sign((n * d).sum(axis=0))
    s = rng.normal(size=n.shape)
    out = n + s / np.linalg.norm(s, axis=0)
    return p + 1e-4 * n, out / np.linalg.norm(out, axis=0)


def build_rows(folder: Path) -> Iterator[Row]:
    """Measure seconds and memory for the BVH of 10^6 triangles, each in a process of its own."""
    file = write_bumpy_sphere(folder, 1_000_000)
    numbers = [float(x) for x in in_process("build", file).split()]
    yield Row("BVH over 10^6 triangles, seconds", 1, None, [numbers[0]], "triangles' frames and records included", True)
    yield Row("  memory beyond the mesh, MiB", 300, None, [numbers[1]], "at its peak", True)


def first_image_row(folder: Path, pairs: int) -> Row:
    """Measure the first image of a process that finds no compiled kernels, loading included."""
    file = str(write_bumpy_sphere(folder, 100_000))
    times = [(first_image("mitsuba", file)["image"], first_image("djpt", file)["image"]) for _ in range(pairs)]
    theirs, ours = (statistics.median(column) for column in zip(*times, strict=True))
    note = f"{theirs:.2f} s / {ours:.2f} s, empty kernel cache"
    return Row("first image, 100000 triangles, 16 spp", 1.2, None, [a / b for a, b in times], note)


def in_process(what: str, file: Path) -> str:
    """Run this script as ``meshes.py what file`` with an empty kernel cache, and return its output."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "DRJIT_CACHE_DIR": cache}
        command = [sys.executable, __file__, what, str(file)]
        return subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout


def build_alone(file: Path) -> None:
    """Print the seconds that the BVH of a mesh takes, and the peak of additional memory in MiB."""
    from djpt.geometry.two_level_bvh import TwoLevelBVH
    from djpt.shapes.meshes.mesh_set import MeshSet

    meshes = MeshSet([djpt.load_dict(bumpy_sphere(file, True))])
    # What is compiled once and kept on disk doesn't count.
    TwoLevelBVH(MeshSet([djpt.Mesh("one", [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])]), [1], [], []).tree()
    dr.sync_thread()
    before, sizes, done = memory_in_use(), [0.0], threading.Event()

    def watch() -> None:
        while not done.wait(0.002):
            sizes.append(memory_in_use())

    watcher = threading.Thread(target=watch)
    watcher.start()
    start = time.perf_counter()
    TwoLevelBVH(meshes, [1], [], []).tree()
    dr.sync_thread()
    elapsed = time.perf_counter() - start
    done.set()
    watcher.join()
    print(elapsed, max(sizes) - before)


def memory_in_use() -> float:
    """The memory of this process in MiB; Linux only."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def all_rows(pairs: int, quick: bool) -> Iterator[Row]:
    """Measure all rows of the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield from image_rows(folder, pairs, quick)
        yield gradient_row(folder, pairs)
        yield from query_rows(folder, pairs)
        yield from build_rows(folder)
        yield first_image_row(folder, min(pairs, 5))


if __name__ == "__main__":
    if len(sys.argv) == 3 and sys.argv[1] == "build":
        build_alone(Path(sys.argv[2]))
    else:
        sys.exit(report(__doc__.split("\n")[0], f"256x256, depth 8, {SPP} spp", all_rows))

"""Rays per second of the acceleration structures, compared with Mitsuba 3 on the same machine.

    python benchmarks/accelerators.py [--triangles 100000] [--rays 1000000] [--rounds 5] [--all]

Three kinds of rays: coherent ones from a camera, incoherent ones that leave the first hits by the cosine, and
shadow rays from there to a lamp, which end at any hit. All structures and Mitsuba (Embree)
take turns in one process; numbers are medians over the rounds in millions of rays per second, and the median
over the rounds of the ratio to Mitsuba. Kernels are compiled before the clock starts. `--all` adds trees by
other methods, the BSP tree, which takes a millisecond per triangle to build, and, on small scenes, brute force.
"""

from __future__ import annotations

import djpt  # noqa: F401  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f
from djpt.core.records import Ray3f
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.geometry.accelerators.base import Accelerator
from djpt.geometry.accelerators.brute_force import BruteForce
from djpt.geometry.accelerators.bsp import BspTree
from djpt.geometry.accelerators.bvh import Bvh
from djpt.geometry.accelerators.grid import UniformGrid
from djpt.geometry.accelerators.kdtree import KdTree
from djpt.geometry.accelerators.octree import Octree
from djpt.geometry.accelerators.simple_bvh import SimpleBvh
from djpt.jit.types import PCG32, Float, Point2f, Point3f, UInt32, Vector3f

BRUTE_FORCE = 3000
"""Most triangles for which brute force is measured."""

LAMP = (2.0, 3.0, 4.0)

Work = Callable[[], Any]


def model(triangles: int, seed: int = 0) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """The vertices and faces of a sphere with bumps of all sizes on a floor."""
    rng = np.random.default_rng(seed)
    rows = max(2, round((triangles / 4) ** 0.5))
    u, v = np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False), np.linspace(0.02, np.pi - 0.02, rows + 1)
    u, v = (x.ravel() for x in np.meshgrid(u, v))
    p = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=1)
    bumps = np.zeros(len(p))
    for octave in range(7):
        waves, phase = 1.5 * 2**octave * rng.normal(size=(3, 4)), rng.uniform(0, 2 * np.pi, 4)
        bumps += 0.06 / 1.7**octave * np.sin(p @ waves + phase).sum(axis=1)
    p *= 1 + bumps[:, None]
    row, column = (x.ravel() for x in np.meshgrid(np.arange(rows), np.arange(2 * rows), indexing="ij"))
    a, b = row * 2 * rows + column, row * 2 * rows + (column + 1) % (2 * rows)
    faces = np.concatenate([np.stack([a, a + 2 * rows, b], 1), np.stack([b, a + 2 * rows, b + 2 * rows], 1)])
    floor = np.array([[-6, -6, -1.3], [6, -6, -1.3], [6, 6, -1.3], [-6, 6, -1.3]])
    faces = np.concatenate([faces, np.array([[0, 1, 2], [0, 2, 3]]) + len(p)])
    return np.concatenate([p, floor]).astype(np.float32), faces.astype(np.uint32)


def rays(structure: Accelerator, corners: NDArray[np.float32], count: int) -> dict[str, Ray3f]:
    """Make the rays of each kind."""
    side = round(count**0.5)
    index = dr.arange(UInt32, side * side)
    x, y = (Float(index % side) + 0.5) / side - 0.5, (Float(index // side) + 0.5) / side - 0.5
    forward = dr.normalize(Vector3f(-3, -2, -1.2))
    frame = Frame3f.from_normal(forward)
    camera = Ray3f(Point3f(3, 2, 1.2), dr.normalize(frame.to_world(Vector3f(x, y, 1))), maxt=Float(dr.inf))
    camera.o = camera.o + dr.zeros(Point3f, side * side)
    dr.eval(camera)
    t, face = structure.closest(camera)
    hit = dr.compress(dr.isfinite(t))
    t, face, d = dr.gather(Float, t, hit), dr.gather(UInt32, face, hit), dr.gather(Vector3f, camera.d, hit)
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = dr.normalize(dr.gather(Vector3f, Vector3f(*edges.T.copy()), face))
    normal = dr.select(dr.dot(normal, d) > 0, -normal, normal)
    p = Point3f(3, 2, 1.2) + d * t + normal * 1e-4
    random = PCG32(size=dr.width(hit))
    bounce = square_to_cosine_hemisphere(Point2f(random.next_float32(), random.next_float32()))
    lamp = Point3f(*LAMP) + 0.3 * Vector3f(*(random.next_float32() for _ in range(3)))
    result = {
        "coherent": camera,
        "incoherent": Ray3f(
            p, Frame3f.from_normal(normal).to_world(bounce), maxt=dr.full(Float, dr.inf, dr.width(hit))
        ),
        "any hit": Ray3f(p, dr.normalize(lamp - p), maxt=dr.norm(lamp - p)),
    }
    dr.eval(result)
    return result


def mitsuba_scene(vertices: NDArray[np.float32], faces: NDArray[np.uint32]) -> Any:
    """Load a mesh into Mitsuba."""
    mesh = mi.Mesh("model", len(vertices), len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"], parameters["faces"] = vertices.ravel(), faces.ravel()
    parameters.update()
    return mi.load_dict({"type": "scene", "model": mesh})


def mitsuba_works(scene: Any, kinds: dict[str, Ray3f]) -> dict[str, Work]:
    """The queries of each kind of rays to Mitsuba, as functions."""
    theirs = {kind: mi.Ray3f(mi.Point3f(ray.o), mi.Vector3f(ray.d), ray.maxt, 0.0, []) for kind, ray in kinds.items()}

    def closest(ray: Any) -> Any:
        found = scene.ray_intersect_preliminary(ray)
        return found.t, found.prim_index

    return {
        kind: (lambda ray=ray: scene.ray_test(ray)) if kind == "any hit" else (lambda ray=ray: closest(ray))
        for kind, ray in theirs.items()
    }


def works(structure: Accelerator, kinds: dict[str, Ray3f]) -> dict[str, Work]:
    """The queries of each kind of rays to a structure, as functions."""
    return {
        kind: (lambda ray=ray: structure.any_hit(ray))
        if kind == "any hit"
        else (lambda ray=ray: structure.closest(ray))
        for kind, ray in kinds.items()
    }


def seconds(work: Work) -> float:
    """The time of one call, until all its results are computed."""
    dr.sync_thread()
    start = time.perf_counter()
    dr.eval(work())
    dr.sync_thread()
    return time.perf_counter() - start


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=100_000)
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--all", action="store_true")
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")

    vertices, faces = model(options.triangles)
    corners = vertices[faces]
    structures: dict[str, Accelerator] = {"BVH": Bvh(corners)}
    if options.all:
        structures |= {f"BVH, {method}": Bvh(corners, method) for method in ("longest_axis", "median")}
        structures["simple BVH"] = SimpleBvh(corners)
    structures |= {"grid": UniformGrid(corners), "octree": Octree(corners), "kd-tree": KdTree(corners)}
    if options.all:
        structures["BSP tree"] = BspTree(corners)
    if options.all and len(corners) <= BRUTE_FORCE:
        structures["brute force"] = BruteForce(corners)
    kinds = rays(structures["BVH"], corners, options.rays)

    for name, structure in structures.items():
        print(f"{name:<18}{structure.statistics()}")
    contestants = {"Mitsuba": mitsuba_works(mitsuba_scene(vertices, faces), kinds)}
    contestants |= {name: works(structure, kinds) for name, structure in structures.items()}
    times: dict[tuple[str, str], list[float]] = {(n, kind): [] for n in contestants for kind in kinds}
    for turn in range(options.rounds + 1):
        for kind in kinds:
            for name, work in contestants.items():
                taken = seconds(work[kind])
                if turn:  # the first one compiles
                    times[name, kind].append(taken)

    print(f"\n{dr.thread_count()} threads; Mrays/s (ratio to Mitsuba)")
    print(" " * 18 + "".join(f"{kind:>20}" for kind in kinds))
    for name in contestants:
        cells = []
        for kind, ray in kinds.items():
            speed = dr.width(ray) / statistics.median(times[name, kind]) / 1e6
            ratio = statistics.median(m / own for m, own in zip(times["Mitsuba", kind], times[name, kind], strict=True))
            cells.append(f"{speed:>12.2f} ({ratio:.2f})")
        print(f"{name:<18}" + "".join(f"{cell:>20}" for cell in cells))


if __name__ == "__main__":
    main()

"""Times of djpt on a GPU, compared with Mitsuba 3 on the same GPU and with djpt on the processor.

    python benchmarks/cuda.py [--variant NAME] [--quick] [--pairs N] [--json FILE]

Images of the Cornell box and of meshes, gradients, ray queries. djpt and Mitsuba take turns in this process, as in
`versus_mitsuba.py`; the processor's times are measured by another process, before. Without a GPU it says so and exits
with 0. ``--variant llvm_ad_rgb`` runs the same program on the processor alone.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from gradients import image_and_gradient
from mesh_scenes import bumpy_sphere, over_floor, textured_sphere, twenty_meshes, write_bumpy_sphere

from djpt.apps.benchmarks.measuring import machine, seconds, times_in_pairs
from djpt.errors import BackendError
from djpt.jit.backends import VARIANTS, load_backend

Work = Callable[[int], Any]
"""Does what is measured, with a seed."""

LAYOUT = "{:45} {:>10} {:>22} {:>18}"


# ---- what is measured -------------------------------------------------------------------


def works(folder: Path, quick: bool) -> dict[str, Callable[[Any], Work]]:
    """What is measured, by name: functions that prepare it for a module, djpt or mitsuba."""
    few, many = (16, 64) if quick else (64, 256)
    ball, balls = write_bumpy_sphere(folder, 100_000), [write_bumpy_sphere(folder, 5000, seed) for seed in range(20)]
    return {
        f"Cornell box, box filter, {many} spp": lambda m: image(m, cornell_box(m, "box"), many),
        f"Cornell box, gaussian filter, {many} spp": lambda m: image(m, cornell_box(m, "gaussian"), many),
        f"Cornell box, 1024 x 1024, {few} spp": lambda m: image(m, cornell_box(m, "box", 1024), few),
        "bumpy sphere of 10^5 triangles, 32 spp": lambda m: image(m, over_floor(m, bumpy_sphere(ball, True)), 32),
        "  with vertex normals and a texture": lambda m: image(m, over_floor(m, textured_sphere(m, ball)), 32),
        "twenty meshes, 8 materials, 32 spp": lambda m: image(m, twenty_meshes(m, balls), 32),
        "image and gradient, Cornell box, 16 spp": lambda m: image_and_gradient(
            m, cornell_box(m, "box"), ["red.reflectance.value"]
        ),
        "image and gradient, 10^5 triangles, 16 spp": lambda m: image_and_gradient(
            m, over_floor(m, bumpy_sphere(ball, True)), ["ball.bsdf.reflectance.value"]
        ),
        "ray_intersect, 10^6 rays, 10^5 triangles": lambda m: query(m, ball, "ray_intersect"),
        "ray_test, the same rays": lambda m: query(m, ball, "ray_test"),
    }


def cornell_box(module: Any, rfilter: str, size: int = 256) -> dict[str, Any]:
    """The scene as a module describes it, paths of up to 8 edges."""
    scene = module.cornell_box()
    scene["sensor"]["film"].update(width=size, height=size, rfilter={"type": rfilter})
    scene["integrator"] = {"type": "path", "max_depth": 8}
    return scene


def image(module: Any, description: dict[str, Any], spp: int) -> Work:
    """Prepare an image."""
    scene = module.load_dict(description)
    return lambda seed: module.render(scene, spp=spp, seed=seed)


def query(module: Any, file: Path, name: str) -> Work:
    """Prepare a ray query, for rays from a sphere about the mesh to anywhere within."""
    scene = module.load_dict({"type": "scene", "ball": bumpy_sphere(file, True)})
    rng = np.random.default_rng(0)
    o = rng.normal(size=(3, 2**20))
    o *= 3 / np.linalg.norm(o, axis=0)
    d = rng.uniform(-1, 1, o.shape) - o
    d /= np.linalg.norm(d, axis=0)
    ray = module.Ray3f(module.Point3f(o.astype(np.float32)), module.Vector3f(d.astype(np.float32)))
    dr.eval(ray)
    return lambda seed: getattr(scene, name)(ray)


# ---- measuring --------------------------------------------------------------------------


def on_processor(pairs: int, quick: bool) -> dict[str, float]:
    """The seconds of djpt on the processor, by name, from a process of its own."""
    command = [sys.executable, __file__, "--alone", "--variant", "llvm_ad_rgb", "--pairs", str(pairs)]
    done = subprocess.run(command + ["--quick"] * quick, stdout=subprocess.PIPE, text=True, check=True)
    times: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return times


def alone(pairs: int, quick: bool) -> dict[str, float]:
    """The seconds of djpt in this process, by name: medians of `pairs` runs, kernels compiled."""
    times = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, prepare in works(Path(folder), quick).items():
            work = prepare(djpt)
            runs = [seconds(lambda work=work, seed=seed: work(seed)) for seed in range(pairs + 2)]
            times[name] = statistics.median(runs[2:])
    return times


def mitsuba_problem(variant: str) -> str | None:
    """Why Mitsuba can't trace rays in a variant; None if it can. On a GPU it needs OptiX."""
    try:
        mi.set_variant(variant)
        dr.eval(mi.render(mi.load_dict(cornell_box(mi, "box", 16)), spp=1))
        dr.sync_thread()
    except (RuntimeError, ImportError, AttributeError) as error:
        return str(error).strip().splitlines()[0]
    return None


def row(prepare: Callable[[Any], Work], pairs: int, with_mitsuba: bool) -> dict[str, Any]:
    """Measure djpt, and Mitsuba in turns with it: seconds and the ratios of the pairs."""
    ours = prepare(djpt)
    if with_mitsuba:
        times = times_in_pairs(ours, prepare(mi), pairs)
        theirs, mine = (statistics.median(column) for column in zip(*times, strict=True))
        return {"djpt": mine, "mitsuba": theirs, "ratios": [a / b for a, b in times]}
    runs = [seconds(lambda seed=seed: ours(seed)) for seed in range(pairs + 2)]
    return {"djpt": statistics.median(runs[2:]), "mitsuba": None, "ratios": []}


def line(name: str, result: dict[str, Any]) -> str:
    """A line of the table."""
    theirs, cpu = "-", "-"
    if result["ratios"]:
        theirs = f"{1e3 * result['mitsuba']:.1f} ms, x {statistics.median(result['ratios']):.2f}"
    if result["processor"] is not None:
        cpu = f"{1e3 * result['processor']:.0f} ms, x {result['processor'] / result['djpt']:.1f}"
    return LAYOUT.format(name, f"{1e3 * result['djpt']:.1f} ms", theirs, cpu)


def main() -> int:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--variant", choices=tuple(VARIANTS), default="cuda_ad_rgb", help="of djpt and of Mitsuba")
    parser.add_argument("--quick", action="store_true", help="3 pairs, and fewer samples")
    parser.add_argument("--pairs", type=int, help="pairs of each row (default 7)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to FILE as well")
    parser.add_argument("--alone", action="store_true", help="print the seconds of djpt alone, as JSON")
    arguments = parser.parse_args()
    pairs, quick, variant = arguments.pairs or (3 if arguments.quick else 7), arguments.quick, arguments.variant
    if pairs < 1:
        parser.error("--pairs must be at least 1")
    djpt.set_variant(variant)
    try:
        load_backend()
    except BackendError as error:
        print(f"no GPU here: {error}" if variant == "cuda_ad_rgb" else str(error))
        return int(variant != "cuda_ad_rgb")
    if arguments.alone:
        print(json.dumps(alone(pairs, quick)))
        return 0
    facts, problem = machine(), mitsuba_problem(variant)
    print(", ".join(f"{name} {value}" for name, value in facts.items()))
    if problem is not None:
        print(f"Mitsuba doesn't run in {variant}: {problem}")
    processor = on_processor(pairs, quick) if variant != "llvm_ad_rgb" else {}
    print(f"\n256x256, depth 8, unless said; {variant}; x = their time / djpt's, median of interleaved pairs\n")
    print(LAYOUT.format("what", "djpt", "Mitsuba", "djpt on processor").rstrip())
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, prepare in works(Path(folder), quick).items():
            results[name] = {**row(prepare, pairs, problem is None), "processor": processor.get(name)}
            print(line(name, results[name]).rstrip(), flush=True)
    if arguments.json:
        document = {"machine": facts, "variant": variant, "mitsuba_problem": problem, "rows": results}
        arguments.json.write_text(json.dumps(document, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

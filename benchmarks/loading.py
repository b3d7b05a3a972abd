"""Times before the first ray: reading textures, meshes and environment maps, compared with Mitsuba 3; imports.

    python benchmarks/loading.py [--quick] [--pairs N] [--json FILE]

Both renderers read the same files in turns, in one process. A first load with its imports, and processes that print an
error or render the Cornell box, are measured by the CPU seconds of new processes, with the kernels in the cache.
Exit code 1: a required number was missed.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from mesh_scenes import write_bumpy_sphere
from pairs import Row, report

from djpt.shapes.meshes.ply import read_ply


def load_row(what: str, description: dict[str, Any], pairs: int, required: float | None = None) -> Row:
    """Measure how long loading a node takes."""

    def seconds(load: Callable[[Any], Any]) -> float:
        start = time.process_time()
        loaded = load(description)
        elapsed = time.process_time() - start
        del loaded
        return elapsed

    seconds(djpt.load_dict), seconds(mi.load_dict)
    times = [(seconds(mi.load_dict), seconds(djpt.load_dict)) for _ in range(pairs)]
    theirs, ours = (statistics.median(column) for column in zip(*times, strict=True))
    ratios = [a / max(b, 1e-9) for a, b in times]
    return Row(what, required, None, ratios, f"{1e3 * theirs:.0f} ms / {1e3 * ours:.0f} ms of CPU")


def texture_rows(folder: Path, pairs: int, size: int) -> Iterator[Row]:
    """Measure bitmaps of smooth noise."""
    rng = np.random.default_rng(0)
    coarse = rng.random((size // 16, size // 16, 3)).astype(np.float32)
    image = np.minimum(coarse.repeat(16, 0).repeat(16, 1) + 0.02 * rng.random((size, size, 3), dtype=np.float32), 1)
    for suffix, required in (("png", 0.4), ("jpg", 0.35), ("exr", 1)):
        file = folder / f"{size}.{suffix}"
        djpt.write(file, image)
        yield load_row(f"{suffix}, {size} x {size}", {"type": "bitmap", "filename": str(file)}, pairs, required)


def environment_rows(folder: Path, pairs: int, size: int) -> Iterator[Row]:
    """Measure environment maps, sampling tables included."""
    rng = np.random.default_rng(1)
    pixels = rng.random((size // 2, size, 3)).astype(np.float32) ** 4
    file = folder / f"sky{size}.exr"
    djpt.write(file, pixels)
    for what, keys in (("exr", {"filename": str(file)}), ("in memory", {"bitmap": mi.Bitmap(pixels)})):
        yield load_row(f"environment map {what}, {size} x {size // 2}", {"type": "envmap", **keys}, pairs)


def mesh_rows(folder: Path, pairs: int, count: int) -> Iterator[Row]:
    """Measure meshes without normals."""
    binary = write_bumpy_sphere(folder, count)
    mesh = read_ply(binary.read_bytes(), binary.name)
    header = (
        f"ply\nformat ascii 1.0\nelement vertex {len(mesh.positions)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(mesh.indices)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    vertices = "\n".join(f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.positions.tolist())
    ascii_faces = "\n".join(f"3 {a} {b} {c}" for a, b, c in mesh.indices.tolist())
    obj_faces = "\n".join(f"f {a} {b} {c}" for a, b, c in (mesh.indices + 1).tolist())
    text, obj = folder / f"{count}.text.ply", folder / f"{count}.obj"
    text.write_text(f"{header}{vertices}\n{ascii_faces}\n")
    obj.write_text("v " + vertices.replace("\n", "\nv ") + f"\n{obj_faces}\n")
    mi.set_log_level(mi.LogLevel.Error)
    for what, kind, file in (("binary ply", "ply", binary), ("ascii ply", "ply", text), ("obj", "obj", obj)):
        yield load_row(f"{what}, {len(mesh.indices)} triangles", {"type": kind, "filename": str(file)}, pairs)


def shared_texture_row(folder: Path, pairs: int) -> Row:
    """Measure a scene of eight materials with one bitmap."""
    file = folder / "shared.png"
    djpt.write(file, np.random.default_rng(2).random((64, 64, 3)).repeat(16, 0).repeat(16, 1).astype(np.float32))
    bsdf = {"type": "diffuse", "reflectance": {"type": "bitmap", "filename": str(file)}}
    scene = {"type": "scene"} | {f"ball{i}": {"type": "sphere", "bsdf": bsdf} for i in range(8)}
    return load_row("png of eight materials, 1024 x 1024", scene, pairs)


def first_load_row(pairs: int) -> Row:
    """Measure the imports and the first load of the Cornell box, in new processes."""
    theirs = ["-c", "import mitsuba as m; m.set_variant('llvm_ad_rgb'); m.load_dict(m.cornell_box())"]
    ours = ["-c", "import djpt; djpt.load_dict(djpt.cornell_box())"]
    cpu_seconds(theirs), cpu_seconds(ours)
    times = [(cpu_seconds(theirs), cpu_seconds(ours)) for _ in range(pairs)]
    mitsuba, own = (1e3 * statistics.median(column) for column in zip(*times, strict=True))
    ratios = [a / b for a, b in times]
    return Row("import and first load, Cornell box", 1, 1.5, ratios, f"{mitsuba:.0f} ms / {own:.0f} ms of CPU")


def process_rows(pairs: int) -> Iterator[Row]:
    """Measure the CPU seconds of new processes."""
    yield first_load_row(pairs)
    render = "import djpt; djpt.render(djpt.load_dict(djpt.cornell_box()), spp=16).numpy()"
    for what, arguments, required in (
        ("import djpt", ["-c", "import djpt"], 0.2),
        ("a file that doesn't exist: djpt render nothing.xml", ["-m", "djpt", "render", "nothing.xml"], 0.6),
        ("Cornell box, 16 spp, kernels in the cache", ["-c", render], 1.2),
    ):
        cpu_seconds(arguments)
        yield Row(what, required, None, [cpu_seconds(arguments) for _ in range(pairs)], "CPU seconds", True)


def cpu_seconds(arguments: list[str]) -> float:
    """The CPU seconds of a Python process, its threads included; Linux and macOS only."""

    def used() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return children.ru_utime + children.ru_stime

    # Mitsuba's process gets djpt's choice of LLVM, whose neighbours only djpt finds by itself.
    llvm = os.environ["DRJIT_LIBLLVM_PATH"]
    environment = os.environ | {"LD_LIBRARY_PATH": os.path.dirname(llvm)}
    before = used()
    subprocess.run(
        [sys.executable, *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
        env=environment,
    )
    return used() - before


def all_rows(pairs: int, quick: bool) -> Iterator[Row]:
    """Measure all rows of the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for size in (1024,) if quick else (1024, 4096):
            yield from texture_rows(folder, pairs, size)
            yield from environment_rows(folder, pairs, size)
        yield shared_texture_row(folder, pairs)
        for count in (57_000,) if quick else (57_000, 1_000_000):
            yield from mesh_rows(folder, pairs, count)
    yield from process_rows(pairs)


if __name__ == "__main__":
    sys.exit(report(__doc__.split("\n")[0], "CPU time", all_rows))

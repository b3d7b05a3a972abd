"""One scene file in both renderers: ``python one_scene.py FILE RESULTS OPTIONS``.

Run by `scenes.py`, in a process of its own with an empty kernel cache: a renderer may end its process. OPTIONS are
those of `scenes.py` (JSON): width, spp, pairs, lanes, define. What is known is written to RESULTS (JSON) before each
stage, so that the results of a process that was ended say what it was doing.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from pairs import seconds, times_in_pairs

from djpt.jit.backends import load_backend
from djpt.jit.llvm.lanes import force_lanes
from djpt.validation.comparison import agreement
from djpt.validation.metrics import ComparisonError, relative_rmse

LOADS = 3
"""How many times a scene is loaded by each renderer, at most."""

PATIENCE = 10.0
"""Seconds after which no more pairs are measured."""

RENDERERS = {"mitsuba": mi, "djpt": djpt}


class Results:
    """What was found out about a scene; kept in a file from stage to stage."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.found: dict[str, Any] = {"failures": {}}

    def add(self, **found: Any) -> None:
        """Add what was found."""
        self.found.update(found)
        self.file.write_text(json.dumps(self.found))

    def stage(self, renderer: str, what: str) -> None:
        """Say what comes next, in case that it never ends."""
        self.add(stage=[renderer, what])

    def attempt(self, renderer: str, what: str, work: Callable[[], Any]) -> Any:
        """Return the result of `work`, or None after an exception, which is noted as the renderer's failure."""
        self.stage(renderer, what)
        try:
            return work()
        except Exception as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            self.found["failures"].setdefault(renderer, f"{what}: {reason}")
            return None


def parameters_of(file: Path, define: dict[str, str]) -> dict[str, str]:
    """The values that a file uses: both renderers refuse others."""
    text = file.read_text(errors="replace")
    return {name: value for name, value in define.items() if f"${name}" in text}


def load(renderer: Any, file: Path, parameters: dict[str, str]) -> tuple[float, Any]:
    """The seconds that loading takes, and the scene."""
    start = time.perf_counter()
    scene = renderer.load_file(str(file), **parameters)
    dr.sync_thread()
    return time.perf_counter() - start, scene


def narrow(renderer: Any, scene: Any, width: int) -> None:
    """Make films at most `width` pixels wide, of the same shape. A film with a crop window stays as it is."""
    parameters = renderer.traverse(scene)
    names = {key: np.array(value).ravel() for key, value in parameters.items() if key.endswith("film.size")}
    for key, (old_width, old_height) in names.items():
        if old_width > width and np.array_equal(np.array(parameters[f"{key[:-4]}crop_size"]).ravel(), names[key]):
            height = max(1, round(float(old_height * width / old_width)))
            parameters[key] = (width, height)
    parameters.update()


def in_order(file: Path, parameters: dict[str, str], width: int, spp: int) -> np.ndarray:
    """Mitsuba's image without merging of meshes.

    Merging numbers lights that are meshes by addresses in memory, anew in each process; djpt keeps the file's order.
    """
    scene = mi.load_file(str(file), optimize=False, **parameters)
    narrow(mi, scene, width)
    return np.array(mi.render(scene, spp=spp, seed=0), np.float32)


@contextmanager
def kernels(into: dict[str, float]) -> Iterator[None]:
    """Measure the seconds that kernels take inside: ``run`` on all threads, ``compile`` with the code generation."""
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        yield
        dr.sync_thread()
        history = dr.kernel_history()
    into["launches"] = len(history)
    into["run"] = sum(entry["execution_time"] for entry in history) / 1e3
    into["compile"] = sum(entry.get("codegen_time", 0) + entry.get("backend_time", 0) for entry in history) / 1e3


def compare(results: Results, images: dict[str, np.ndarray]) -> None:
    """Measure how far two images of one seed agree."""
    ours, theirs = images["djpt"], images["mitsuba"]
    try:
        same = agreement(ours, theirs)
    except ComparisonError as error:
        results.found["failures"]["comparison"] = str(error)
        return
    # The bias in units of its standard error, if pixels were independent.
    difference = (ours.astype(np.float64) - theirs).mean(axis=2)
    error = float(difference.std()) / difference.size**0.5
    results.add(
        equal=same.share,
        bias=same.bias,
        bias_in_errors=float(difference.mean()) / error if error else 0.0,
        rmse=relative_rmse(ours, theirs),
    )


def measure(results: Results, file: Path, options: dict[str, Any]) -> None:
    """Measure loading, the first image, equality, and images in turns."""
    width, parameters = options["width"], parameters_of(file, options["define"])
    loads: dict[str, list[float]] = {name: [] for name in RENDERERS}
    scenes: dict[str, Any] = {}
    start = time.perf_counter()
    while len(loads["djpt"]) < LOADS and time.perf_counter() - start < PATIENCE and not results.found["failures"]:
        for name, renderer in RENDERERS.items():
            loaded = results.attempt(name, "load", lambda renderer=renderer: load(renderer, file, parameters))
            if loaded is not None:
                loads[name].append(loaded[0])
                scenes[name] = loaded[1]
    results.add(load={name: statistics.median(times) for name, times in loads.items() if times})
    if results.found["failures"]:
        return

    spp = min(options["spp"], scenes["mitsuba"].sensors()[0].sampler().sample_count())
    for name, renderer in RENDERERS.items():
        results.attempt(name, "set the size of the film", lambda r=renderer, n=name: narrow(r, scenes[n], width))
    render = {
        name: lambda seed, r=renderer, n=name: r.render(scenes[n], spp=spp, seed=seed)
        for name, renderer in RENDERERS.items()
    }
    first: dict[str, float] = {}
    first_kernels: dict[str, dict[str, float]] = {name: {} for name in RENDERERS}
    images: dict[str, np.ndarray] = {}
    for name in RENDERERS:

        def image(name: str = name) -> None:
            start = time.perf_counter()
            with kernels(first_kernels[name]):
                images[name] = np.array(render[name](0), np.float32)
            first[name] = time.perf_counter() - start

        results.attempt(name, "first image", image)
    results.add(spp=spp, first=first, first_kernels=first_kernels)
    if results.found["failures"]:
        return
    results.add(shape=images["djpt"].shape)
    if len(scenes["mitsuba"].emitters()) > 1:
        unmerged = results.attempt("mitsuba", "image without merging", lambda: in_order(file, parameters, width, spp))
        images["mitsuba"] = images["mitsuba"] if unmerged is None else unmerged
    compare(results, images)

    results.stage("both", "images in turns")
    times = times_in_pairs(render["djpt"], render["mitsuba"], options["pairs"], warm_up=0, limit=PATIENCE)
    results.add(image=[list(pair) for pair in times])
    warm_kernels: dict[str, dict[str, float]] = {name: {} for name in RENDERERS}
    for name in RENDERERS:
        with kernels(warm_kernels[name]):
            warm_kernels[name]["wall"] = seconds(lambda name=name: render[name](1))
    results.add(kernels=warm_kernels)


def main() -> None:
    """Measure the scene that the command line names."""
    file, into, words = sys.argv[1:]
    options = json.loads(words)
    mi.set_variant("llvm_ad_rgb")
    djpt.set_variant("llvm_ad_rgb")
    load_backend()
    if options["lanes"]:
        force_lanes(options["lanes"])
    mi.set_log_level(mi.LogLevel.Error)
    # Names of djpt are imported at their first use; Mitsuba's with the variant. LLVM starts with the first kernel.
    _ = djpt.load_file, djpt.render, djpt.traverse, djpt.integrators
    dr.eval(dr.arange(dr.llvm.ad.Float, 10) + 1)
    results = Results(Path(into))
    measure(results, Path(file).resolve(), options)
    results.add(stage=None)


if __name__ == "__main__":
    main()

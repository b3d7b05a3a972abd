"""One scene in both renderers: ``python -m djpt.apps.benchmarks.one_scene SCENE RESULTS OPTIONS``.

Run by `command`, in a process of its own with an empty kernel cache: a renderer may end its process. OPTIONS are an
`Options` as JSON. What is known is written to RESULTS (JSON) before each stage, so that the results of a process that
was ended say what it was doing.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import djpt
from djpt.apps.benchmarks.measuring import CLOCKS, seconds, times_in_pairs
from djpt.jit.backends import load_backend, variant
from djpt.jit.llvm.gathers import gather_as_llvm_does
from djpt.scenes.overrides import described

__all__ = ["Options", "main"]

LOADS = 2
"""How many times a scene is loaded by each renderer, at most."""

PATIENCE = 10.0
"""Seconds after which no more pairs are measured."""

AGREED = 0.99
"""If fewer pixels agree, images are compared with lights in the order of the description."""


@dataclass
class Options:
    """What is measured of a scene."""

    width: int = 320
    """Films are at most this wide."""
    spp: int | None = None
    """Samples per pixel, at most those of the scene; None: as many as make `samples`."""
    samples: int = 10**6
    """The samples of an image."""
    pairs: int = 5
    lanes: int | None = None
    """The lanes of kernels; None: those of the machine."""
    clock: str = "wall"
    """A name in `CLOCKS`."""
    define: dict[str, str] = field(default_factory=dict)
    """Parameters of files that use them."""


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


class Pair:
    """A scene in both renderers, loaded by the same words: a file, or the name of a built-in scene."""

    def __init__(self, scene: str, options: Options) -> None:
        self.scene, self.options = scene, options
        self.is_file = scene.lower().endswith(".xml")
        text = Path(scene).read_text(errors="replace") if self.is_file else ""
        # Both renderers refuse values that a file doesn't use.
        self.parameters = {name: value for name, value in options.define.items() if f"${name}" in text}

    def load(self, renderer: str, **options: Any) -> Any:
        """The scene, loaded by a renderer."""
        module = RENDERERS[renderer]
        if self.is_file:
            return module.load_file(self.scene, **options, **self.parameters)
        _, description = described(self.scene)
        if renderer == "mitsuba":
            from djpt.validation.bridge import to_mitsuba

            description = to_mitsuba(description)
        return module.load_dict(description, **options)

    def narrowed(self, renderer: str, **options: Any) -> Any:
        """The scene with a narrow film."""
        scene = self.load(renderer, **options)
        narrow(RENDERERS[renderer], scene, self.options.width)
        return scene


RENDERERS: dict[str, Any] = {}
"""The modules of the renderers by name, once `main` has imported them."""


def narrow(renderer: Any, scene: Any, width: int) -> None:
    """Make films at most `width` pixels wide, of the same shape. A film with a crop window stays as it is."""
    import numpy as np

    parameters = renderer.traverse(scene)
    names = {key: np.array(value).ravel() for key, value in parameters.items() if key.endswith("film.size")}
    for key, (old_width, old_height) in names.items():
        if old_width > width and np.array_equal(np.array(parameters[f"{key[:-4]}crop_size"]).ravel(), names[key]):
            height = max(1, round(float(old_height * width / old_width)))
            parameters[key] = (width, height)
    parameters.update()


@contextmanager
def kernels(into: dict[str, float]) -> Iterator[None]:
    """Measure the seconds that kernels take inside: ``run`` on all threads, ``compile`` with the code generation."""
    import drjit as dr

    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        yield
        dr.sync_thread()
        history = dr.kernel_history()
    into["launches"] = len(history)
    into["run"] = sum(entry["execution_time"] for entry in history) / 1e3
    into["compile"] = sum(entry.get("codegen_time", 0) + entry.get("backend_time", 0) for entry in history) / 1e3


def compiling(renderer: str) -> AbstractContextManager[None]:
    """Compile kernels inside as the renderer does; those of Mitsuba as without djpt."""
    return gather_as_llvm_does() if renderer == "mitsuba" else nullcontext()


def agreed(results: Results, images: dict[str, Any]) -> bool:
    """Measure how far two images of one seed agree; whether they do, or can't be compared."""
    import numpy as np

    from djpt.validation.comparison import agreement
    from djpt.validation.metrics import ComparisonError, relative_rmse

    ours, theirs = images["djpt"], images["mitsuba"]
    try:
        same = agreement(ours, theirs)
    except ComparisonError as error:
        results.found["failures"]["comparison"] = str(error)
        return True
    # The bias in units of its standard error, if pixels were independent.
    difference = (ours.astype(np.float64) - theirs).mean(axis=2)
    deviation = float(difference.std()) / difference.size**0.5
    results.add(
        equal=same.share,
        bias=same.bias,
        bias_in_errors=float(difference.mean()) / deviation if deviation else 0.0,
        rmse=relative_rmse(ours, theirs),
    )
    return same.share >= AGREED


def measure(results: Results, pair: Pair) -> None:
    """Measure loading, the first image, equality, and images in turns."""
    import drjit as dr
    import numpy as np

    options = pair.options
    now = CLOCKS[options.clock]
    loads: dict[str, list[float]] = {name: [] for name in RENDERERS}
    scenes: dict[str, Any] = {}

    def load(name: str) -> None:
        start = now()
        with compiling(name):
            scenes[name] = pair.load(name)
            dr.sync_thread()
        loads[name].append(now() - start)

    begun = time.perf_counter()
    while len(loads["djpt"]) < LOADS and time.perf_counter() - begun < PATIENCE and not results.found["failures"]:
        for name in RENDERERS:
            results.attempt(name, "load", lambda name=name: load(name))  # type: ignore[misc]
    results.add(
        load={name: times[0] for name, times in loads.items() if times},
        load_again={name: statistics.median(times[1:]) for name, times in loads.items() if times[1:]},
    )
    if results.found["failures"]:
        return

    for name, renderer in RENDERERS.items():
        narrowing = f"make the film {options.width} pixels wide"
        results.attempt(name, narrowing, lambda r=renderer, n=name: narrow(r, scenes[n], options.width))  # type: ignore[misc]
    sensor = scenes["mitsuba"].sensors()[0]
    size = np.array(sensor.film().crop_size(), int)
    spp = max(1, round(options.samples / int(size.prod())))
    if options.spp is not None:
        spp = min(options.spp, sensor.sampler().sample_count())
    first: dict[str, float] = {}
    first_kernels: dict[str, dict[str, float]] = {name: {} for name in RENDERERS}
    images: dict[str, Any] = {}

    def image(name: str, scene: Any) -> None:
        with compiling(name):
            images[name] = np.array(RENDERERS[name].render(scene, spp=spp, seed=0), np.float32)

    def first_image(name: str) -> None:
        start = now()
        with kernels(first_kernels[name]):
            image(name, scenes[name])
        first[name] = now() - start

    for name in RENDERERS:
        results.attempt(name, "first image", lambda name=name: first_image(name))  # type: ignore[misc]
    results.add(spp=spp, first=first, first_kernels=first_kernels)
    if results.found["failures"]:
        return
    results.add(shape=images["djpt"].shape)
    if not agreed(results, images) and len(scenes["mitsuba"].emitters()) > 1:
        # Merging numbers lights that are meshes by addresses in memory, anew in each process.
        for name in RENDERERS:
            in_order = lambda n=name: image(n, pair.narrowed(n, optimize=False))  # noqa: E731
            results.attempt(name, "image without merging", in_order)
        results.add(optimize=False)
        agreed(results, images)

    results.stage("both", "images in turns")
    ours, theirs = (
        lambda seed, n=name: RENDERERS[n].render(scenes[n], spp=spp, seed=seed) for name in ("djpt", "mitsuba")
    )
    times = times_in_pairs(ours, theirs, options.pairs, warm_up=1, limit=PATIENCE, clock=options.clock)
    results.add(image=[list(times) for times in times])
    warm_kernels: dict[str, dict[str, float]] = {name: {} for name in RENDERERS}
    for name, render in (("djpt", ours), ("mitsuba", theirs)):
        with compiling(name), kernels(warm_kernels[name]):
            warm_kernels[name]["wall"] = seconds(lambda render=render: render(1))  # type: ignore[misc]
    results.add(kernels=warm_kernels)


def main() -> None:
    """Measure the scene that the command line names."""
    scene, into, words = sys.argv[1:]
    options = Options(**json.loads(words))
    djpt.set_variant(variant())
    load_backend()
    import drjit as dr

    from djpt.jit.llvm.lanes import force_lanes
    from djpt.validation.bridge import mitsuba_scene

    results = Results(Path(into))
    results.stage("mitsuba", "import")
    with mitsuba_scene(None) as (mi, _):
        RENDERERS.update(mitsuba=mi, djpt=djpt)
        if options.lanes:
            force_lanes(options.lanes)
        mi.set_log_level(mi.LogLevel.Error)
        # Names of djpt are imported at their first use; Mitsuba's with the variant. LLVM starts with the first kernel.
        _ = djpt.load_file, djpt.load_dict, djpt.render, djpt.traverse, djpt.integrators
        dr.eval(dr.arange(dr.llvm.ad.Float, 10) + 1)
        measure(results, Pair(scene, options))
        results.add(stage=None)


if __name__ == "__main__":
    main()

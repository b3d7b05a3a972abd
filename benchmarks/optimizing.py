"""How long a texture takes to be found from three views, in djpt and in Mitsuba.

Until the mean absolute error of the texels is below 5 %, in scenes of a textured floor with two balls under a lamp, of
analytic shapes or of meshes. Two comparisons of each:

* the same loop: both render with path replay and step with Adam, with the same samples, rates and seeds;
* each as well as it can: djpt by `optimize` with Gauss-Newton steps, Mitsuba with path replay and Adam, of which the
  best of several rates is taken; both with the best of several numbers of samples.

Seconds are those of the processor (of all threads), and in brackets those of the clock.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from mesh_scenes import write_bumpy_sphere

from djpt.apps.benchmarks.measuring import heading, machine
from djpt.apps.optimization import Progressed, optimize
from djpt.apps.optimization.gauss_newton import RATE
from djpt.jit.llvm.gathers import gather_as_llvm_does
from djpt.validation.bridge import mitsuba_scene, to_mitsuba

KEY = "floor.bsdf.reflectance.data"
GOAL = 0.05
REQUIRED = {"analytic": 5.0, "meshes": 1.3}
RATES = (0.05, 0.1, 0.2)
SAMPLES = (8, 4, 16)


def scene(kind: str, texels: np.ndarray, size: int, folder: Path) -> dict[str, Any]:
    """The floor with the given paint."""
    T = djpt.ScalarTransform4f
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    result: dict[str, Any] = {"type": "scene", "integrator": {"type": "prb", "max_depth": 4}}
    for name, x in (("left", -1.2), ("middle", 0.0), ("right", 1.2)):
        to_world = T().look_at([x, -1.6, 2.2], [0, 0, 0], [0, 0, 1])
        result[name] = {"type": "perspective", "fov": 50, "to_world": to_world, "film": film}
    paint = {"type": "bitmap", "data": texels, "raw": True, "filter_type": "bilinear"}
    result["floor"] = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": paint}}
    lamp = T().translate([0, 0, 2.5]).rotate([1, 0, 0], 180).scale(0.5)
    result["lamp"] = {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": 12.0}}
    grey = {"type": "diffuse", "reflectance": 0.5}
    for name, x in (("ball", -0.5), ("other", 0.5)):
        shape = {"type": "sphere", "center": [x, 0.2, 0.25], "radius": 0.25}
        if kind == "meshes":
            file = str(write_bumpy_sphere(folder, 20_000))
            shape = {"type": "ply", "filename": file, "to_world": T().translate([x, 0.2, 0.3]).scale(0.25)}
        result[name] = {**shape, "bsdf": grey}
    return result


@dataclass(frozen=True)
class Found:
    """How a search ended."""

    cpu: float
    """Seconds of the processor until the goal; infinite if it wasn't reached."""
    wall: float
    """Seconds of the clock."""
    steps: int
    spp: int
    rate: float

    def __str__(self) -> str:
        return f"{self.cpu:.1f} s ({self.wall:.1f} s), {self.steps} steps, {self.spp} spp, rate {self.rate:g}"


class Watch:
    """Time since the start, and whether the goal is reached."""

    def __init__(self, truth: np.ndarray) -> None:
        self._truth = truth
        self._cpu, self._wall = time.process_time(), time.perf_counter()

    def spent(self) -> float:
        """Seconds of the processor."""
        return time.process_time() - self._cpu

    def reached(self, texels: Any) -> bool:
        """Whether texels are near enough."""
        return bool(np.abs(np.array(texels) - self._truth).mean() < GOAL * self._truth.mean())

    def found(self, reached: bool, steps: int, spp: int, rate: float) -> Found:
        """The end of a search."""
        if not reached:
            return Found(math.inf, math.inf, steps, spp, rate)
        return Found(self.spent(), time.perf_counter() - self._wall, steps, spp, rate)


@dataclass(frozen=True)
class Problem:
    """A scene of djpt or of Mitsuba, and what it should look like."""

    module: Any
    scene: Any
    targets: list[Any]
    truth: np.ndarray

    def begin(self) -> Any:
        """Make the texture grey."""
        params = self.module.traverse(self.scene)
        params[KEY] = self.module.TensorXf(np.full_like(self.truth, 0.5))
        params.update()
        return params

    def adam(self, spp: int, rate: float, most: int, seconds: float = math.inf) -> Found:
        """A loop of Adam, given up after so many steps or seconds."""
        params = self.begin()
        optimizer = djpt.ad.Adam(lr=rate, params={KEY: params[KEY]})
        watch, reached, step = Watch(self.truth), False, 0
        while not reached and step < most and watch.spent() < seconds:
            params.update(optimizer)
            for view, target in enumerate(self.targets):
                image = self.module.render(self.scene, params, sensor=view, spp=spp, seed=3 * step + view)
                dr.backward(dr.mean(dr.square(image - target), axis=None))
                params.update(optimizer)
            optimizer.step()
            optimizer[KEY] = dr.clip(dr.detach(optimizer[KEY]), 0, 1)
            step, reached = step + 1, watch.reached(optimizer[KEY])
        return watch.found(reached, step, spp, rate)

    def gauss_newton(self, spp: int, most: int) -> Found:
        """`optimize` with Gauss-Newton steps, at its usual rate."""
        self.begin()
        watch, ended = Watch(self.truth), list[bool]()

        def seen(done: Progressed) -> bool:
            ended.append(watch.reached(done.values[KEY]))
            return ended[-1]

        optimize(self.scene, KEY, self.targets, optimizer="gauss_newton", spp=spp, iterations=most, callback=seen)
        return watch.found(ended[-1], len(ended), spp, RATE)


def tuned(adam: Callable[..., Found], most: int) -> Found:
    """The best of Adam in Mitsuba: of all rates, then of all numbers of samples."""
    adam(SAMPLES[0], RATES[0], 2)  # compiles
    best = adam(SAMPLES[0], RATES[0], most)
    for rate in RATES[1:]:
        best = min(best, adam(SAMPLES[0], rate, most, best.cpu), key=lambda found: found.cpu)
    for spp in SAMPLES[1:]:
        best = min(best, adam(spp, best.rate, most, best.cpu), key=lambda found: found.cpu)
    return best


def said(name: str, kind: str, pairs: list[tuple[Found, Found]], required: float) -> bool:
    """Print a row of pairs, djpt's first; whether it is as good as required."""
    ratio, by_clock = (
        float(np.median([getattr(theirs, unit) / getattr(ours, unit) for ours, theirs in pairs]))
        for unit in ("cpu", "wall")
    )
    good = ratio >= required
    verdict = "" if required == 0 else f" >= {required}  {'ok' if good else 'MISSED'}"
    ours, theirs = pairs[-1]
    print(f"texture from three views, {kind}, {name}: {ratio:.2f} ({by_clock:.2f}){verdict}")
    print(f"    djpt {ours}; Mitsuba {theirs}", flush=True)
    return good


def main() -> int:
    """Print a table; 1 if a requirement is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--texels", type=int, default=16)
    parser.add_argument("--spp", type=int, default=32, help="of the same loop")
    parser.add_argument("--most", type=int, default=400)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--kinds", nargs="+", choices=REQUIRED, default=list(REQUIRED))
    chosen = parser.parse_args()
    import mitsuba as mi

    print(heading(machine(), "a texture from three views: Mitsuba's time / djpt's, of the processor (of the clock)"))
    folder = Path(tempfile.mkdtemp())
    met = True
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.1, 0.9, (chosen.texels, chosen.texels, 3)).astype(np.float32)
    for kind in chosen.kinds:
        problems = []
        for load, module in loaders(mi):
            loaded = load(scene(kind, truth, chosen.size, folder))
            targets = [module.render(loaded, sensor=view, spp=512, seed=900 + view) for view in range(3)]
            dr.eval(targets)
            problems.append(Problem(module, loaded, targets, truth))
        ours, theirs = problems
        their_adam = gather_as_llvm_does()(theirs.adam)
        for adam in (ours.adam, their_adam):
            adam(chosen.spp, 0.05, 2)  # compiles
        same = [
            (ours.adam(chosen.spp, 0.05, chosen.most), their_adam(chosen.spp, 0.05, chosen.most))
            for _ in range(chosen.repeat)
        ]
        said("the same loop", kind, same, 0)
        best = tuned(their_adam, chosen.most)
        ours.gauss_newton(SAMPLES[0], 2)  # compiles
        fewest = min((ours.gauss_newton(spp, chosen.most) for spp in SAMPLES), key=lambda found: found.cpu).spp
        pairs = [
            (ours.gauss_newton(fewest, chosen.most), their_adam(best.spp, best.rate, chosen.most))
            for _ in range(chosen.repeat)
        ]
        met &= said("each as well as it can", kind, pairs, REQUIRED[kind])
    return int(not met)


def loaders(mi: Any) -> list[tuple[Callable[[dict[str, Any]], Any], Any]]:
    """How a scene is loaded in djpt and in Mitsuba, and the modules."""

    def in_mitsuba(description: dict[str, Any]) -> Any:
        with mitsuba_scene(None):
            return mi.load_dict(to_mitsuba(description))

    with mitsuba_scene(None):
        return [(djpt.load_dict, djpt), (in_mitsuba, mi)]


if __name__ == "__main__":
    sys.exit(main())

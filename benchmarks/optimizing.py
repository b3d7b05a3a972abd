"""How long a texture takes to be found from three views: djpt's loop against the same in Mitsuba.

Both render with path replay and step with Adam, with the same samples, rates and seeds, until the mean absolute error
of the texels is below 5 %. Scenes: a textured floor with two balls under a lamp, of analytic shapes or of meshes.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from mesh_scenes import write_bumpy_sphere
from pairs import heading, machine

from djpt.validation.bridge import mitsuba_scene, to_mitsuba

KEY = "floor.bsdf.reflectance.data"
GOAL = 0.05
REQUIRED = {"analytic": 5.0, "meshes": 1.3}


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


def search(module: Any, loaded: Any, targets: list[Any], truth: np.ndarray, spp: int, most: int) -> tuple[float, int]:
    """The seconds and the steps until the goal is reached."""
    params = module.traverse(loaded)
    params[KEY] = module.TensorXf(np.full_like(truth, 0.5))
    params.update()
    optimizer = djpt.ad.Adam(lr=0.05, params={KEY: params[KEY]})
    start = time.perf_counter()
    for step in range(most):
        params.update(optimizer)
        for view, target in enumerate(targets):
            image = module.render(loaded, params, sensor=view, spp=spp, seed=3 * step + view)
            dr.backward(dr.mean(dr.square(image - target), axis=None))
            params.update(optimizer)
        optimizer.step()
        optimizer[KEY] = dr.clip(dr.detach(optimizer[KEY]), 0, 1)
        if np.abs(np.array(optimizer[KEY]) - truth).mean() < GOAL * truth.mean():
            return time.perf_counter() - start, step + 1
    return float("inf"), most


def main() -> int:
    """Print a table; 1 if a requirement is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--texels", type=int, default=16)
    parser.add_argument("--spp", type=int, default=32)
    parser.add_argument("--most", type=int, default=400)
    parser.add_argument("--repeat", type=int, default=3)
    chosen = parser.parse_args()
    import mitsuba as mi

    print(heading(machine(), "a texture from three views: Mitsuba's time / djpt's"))
    folder = Path(tempfile.mkdtemp())
    missed = False
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.1, 0.9, (chosen.texels, chosen.texels, 3)).astype(np.float32)
    for kind, required in REQUIRED.items():
        ratios, lines = [], []
        for _ in range(chosen.repeat):
            found: list[tuple[float, int]] = []
            for load, module in loaders(mi):
                loaded = load(scene(kind, truth, chosen.size, folder))
                targets = [module.render(loaded, sensor=view, spp=512, seed=900 + view) for view in range(3)]
                dr.eval(targets)
                search(module, loaded, targets, truth, chosen.spp, 2)  # compiles
                found.append(search(module, loaded, targets, truth, chosen.spp, chosen.most))
            ratios.append(found[1][0] / found[0][0])
            lines.append(f"{found[0][0]:.1f} s, {found[0][1]} steps / {found[1][0]:.1f} s, {found[1][1]} steps")
        ratio = float(np.median(ratios))
        missed |= not ratio >= required
        verdict = "ok" if ratio >= required else "MISSED"
        print(f"texture from three views, {kind:9} >= {required}  {ratio:6.2f}  {verdict}  {'; '.join(lines)}")
    return int(missed)


def loaders(mi: Any) -> list[tuple[Callable[[dict[str, Any]], Any], Any]]:
    """How a scene is loaded in djpt and in Mitsuba, and the modules."""

    def in_mitsuba(description: dict[str, Any]) -> Any:
        with mitsuba_scene(None):
            return mi.load_dict(to_mitsuba(description))

    with mitsuba_scene(None):
        return [(djpt.load_dict, djpt), (in_mitsuba, mi)]


if __name__ == "__main__":
    sys.exit(main())

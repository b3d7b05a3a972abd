"""What djpt computes on one device: images, derivatives and ray queries, to be compared with those of another.

``python -m tests.kit.devices`` says whether there is a GPU, by its exit code and in words.
``python -m tests.kit.devices FILE`` computes all results by the variant of the process and writes them to FILE (npz).
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from djpt.errors import BackendError
from djpt.jit.backends import load_backend

__all__ = ["GRADIENTS", "IMAGES", "QUERIES", "computed", "gpu_problem"]

SEED = 3

IMAGES = (
    "cornell box",
    "gaussian filter",
    "sobol points",
    "all lights",
    "gold and glass",
    "environment map",
    "features",
    "light paths",
    "both ends",
    "textures",
    "meshes",
    "meshes, lanes as pixels",
    "meshes, gaussian filter",
    "instances",
)
"""The pictures, by name."""

GRADIENTS = ("albedo", "albedo, gaussian filter", "radiance, forward", "roughness", "texels", "on meshes", "plain")
"""The derivatives, by name."""

QUERIES = ("ray_intersect", "ray_test", "is_inside")
"""The ray queries, by name."""


def gpu_problem() -> str | None:
    """Why ``cuda_ad_rgb`` can't run here; None if it can. Loads the backend of the process if it can."""
    djpt.set_variant("cuda_ad_rgb")
    try:
        load_backend()
    except BackendError as error:
        return str(error)
    return None


def computed() -> dict[str, np.ndarray]:
    """All results, by name."""
    with tempfile.TemporaryDirectory() as folder:
        return {**images(Path(folder)), **gradients(Path(folder)), **queries(Path(folder))}


# ---- images ----------------------------------------------------------------------------------


def images(folder: Path) -> dict[str, np.ndarray]:
    """The pictures of `IMAGES`."""
    from tests.kit.mesh_scenes import gallery
    from tests.kit.renders import box, lights, ours, spheres
    from tests.kit.textured_room import bitmap, room, texels

    aovs = {"type": "aov", "aovs": "p:position,n:sh_normal,d:depth,i:prim_index", "inner": {"type": "path"}}
    metal_and_glass = {
        "small-sphere": {"bsdf": {"type": "roughconductor", "material": "Au", "alpha": 0.2}},
        "large-sphere": {"bsdf": {"type": "dielectric"}},
    }

    def gold_and_glass(scene: dict[str, Any]) -> None:
        spheres(scene)
        for name, keys in metal_and_glass.items():
            scene[name].update(keys)

    def sobol(scene: dict[str, Any]) -> None:
        scene["sensor"]["sampler"] = {"type": "sobol", "sample_count": 8}

    outdoors = djpt.scenes.stage({"sky": {"type": "envmap", "data": djpt.TensorXf(djpt.scenes.sky(16))}}, 32)
    meshes, smooth = gallery(folder), gallery(folder, rfilter="gaussian")
    made: dict[str, Callable[[], np.ndarray]] = {
        "cornell box": lambda: ours(box(48), 16, SEED),
        "gaussian filter": lambda: ours(box(48, "gaussian"), 16, SEED),
        "sobol points": lambda: ours(box(32, edit=sobol), 8, SEED),
        "all lights": lambda: ours(box(32, edit=lights()), 8, SEED),
        "gold and glass": lambda: ours(box(32, edit=gold_and_glass), 8, SEED),
        "environment map": lambda: ours(outdoors, 8, SEED),
        "features": lambda: ours(box(32, integrator=aovs), 4, SEED),
        "light paths": lambda: ours(box(32, integrator={"type": "ptracer", "max_depth": 5}), 16, SEED),
        "both ends": lambda: ours(box(32, integrator={"type": "bdpt", "max_depth": 5}), 16, SEED),
        "textures": lambda: ours(room(bitmap(texels(5, 7, 3)), bitmap(texels(3, 2, 1))), 8, SEED),
        "meshes": lambda: ours(meshes, 8, SEED),
        "meshes, lanes as pixels": lambda: ours(meshes, 8, SEED, schedule="flat"),
        "meshes, gaussian filter": lambda: ours(smooth, 8, SEED),
        "instances": lambda: ours(instances(folder), 8, SEED),
    }
    return {name: make() for name, make in made.items()}


def instances(folder: Path) -> dict[str, Any]:
    """The gallery with copies of a ball."""
    from djpt.core.transforms import ScalarTransform4f as T
    from tests.kit.mesh_scenes import ball_file, diffuse, gallery

    ball = {"type": "ply", "filename": ball_file(folder), "bsdf": diffuse(0.6, 0.3, 0.5)}
    copies = {
        f"copy{k}": {
            "type": "instance",
            "group": {"type": "ref", "id": "balls"},
            "to_world": T().translate([0.4 * k - 1, 0.9, 0.2 * k]).rotate([0, 1, 0], 30.0 * k).scale(0.2),
        }
        for k in range(6)
    }
    return {**gallery(folder), "balls": {"type": "shapegroup", "ball": ball}, **copies}


# ---- derivatives -----------------------------------------------------------------------------


def gradients(folder: Path) -> dict[str, np.ndarray]:
    """The derivatives of `GRADIENTS`."""
    from tests.kit.derivatives import ALBEDO, RADIANCE, SEED, Experiment
    from tests.kit.mesh_scenes import gallery
    from tests.kit.renders import box, spheres
    from tests.kit.textured_room import FLOOR, bitmap, room, texels

    prb, gold = {"type": "prb", "max_depth": 5}, {"type": "roughconductor", "material": "Au", "alpha": 0.2}

    def golden(scene: dict[str, Any]) -> None:
        spheres(scene)
        scene["small-sphere"]["bsdf"] = gold

    def reverse(description: dict[str, Any], name: str) -> np.ndarray:
        return Experiment(description, [name]).gradients()[name]

    radiance = Experiment(box(24, integrator=prb), [RADIANCE])
    return {
        "albedo": reverse(box(integrator=prb), ALBEDO),
        "albedo, gaussian filter": reverse(box(24, "gaussian", prb), ALBEDO),
        "radiance, forward": radiance.forward(radiance.component(RADIANCE, 0), SEED),
        "roughness": one_number(box(24, integrator=prb, edit=golden), "small-sphere.bsdf.alpha.value"),
        "texels": one_number(room(bitmap(texels(3, 4, 3)), 0.5, "prb"), f"{FLOOR}.data"),
        "on meshes": reverse(gallery(folder, (24, 24), integrator=prb), "floor.bsdf.reflectance.value"),
        "plain": reverse(box(16, integrator={"type": "direct"}), ALBEDO),
    }


def one_number(description: dict[str, Any], name: str) -> np.ndarray:
    """The gradient of the mean of an image with respect to a parameter."""
    import drjit as dr

    scene = djpt.load_dict(description)
    params = djpt.traverse(scene)
    dr.enable_grad(params[name])
    params.set_dirty(name)
    params.update()
    dr.backward(dr.mean(djpt.render(scene, params, spp=8, seed=SEED), axis=None))
    return np.array(dr.grad(params[name]), np.float64)


# ---- ray queries -----------------------------------------------------------------------------


def queries(folder: Path) -> dict[str, np.ndarray]:
    """The answers of `QUERIES` to rays and points from everywhere."""

    from tests.kit.mesh_scenes import gallery

    scene, rng = djpt.load_dict(gallery(folder)), np.random.default_rng(SEED)
    o, d = (rng.normal(size=(3, 20_000)).astype(np.float32) for _ in range(2))
    ray = djpt.Ray3f(djpt.Point3f(2 * o), djpt.Vector3f(d / np.linalg.norm(d, axis=0)))
    si, ray.maxt = scene.ray_intersect(ray), djpt.Float(2)
    hit = np.array(si.is_valid())
    found = [hit, np.where(hit, np.array(si.t), 0), *np.where(hit, np.array(si.n), 0)]
    return {
        "ray_intersect": np.stack(found),
        "ray_test": np.array(scene.ray_test(ray))[None],
        "is_inside": np.array(scene.is_inside(djpt.Point3f(o)))[None],
    }


if __name__ == "__main__":
    if len(sys.argv) > 1:
        np.savez(sys.argv[1], **computed())
    else:
        problem = gpu_problem()
        print("a GPU is there" if problem is None else f"no GPU here: {problem}")
        sys.exit(problem is not None)

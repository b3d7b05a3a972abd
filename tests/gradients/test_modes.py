"""Forward and reverse mode are one estimator: along random directions over all parameters of mixed scenes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import TensorXf
from tests.silhouettes.camera_cases import GROUND
from tests.silhouettes.cases import POINT, SPOTS, WEIGHTS, ball, sensor, sky
from tests.silhouettes.test_projective import octahedron

ROUNDING = 1e-5
"""The largest difference, relative to the change of the loss, or, where that cancels, to its parts."""

SPP = 64


def lit() -> dict[str, Any]:
    """A ball over a floor, in the light of a point."""
    return {
        "ball": ball({"type": "diffuse", "reflectance": SPOTS}, center=[0.5, 0.2, 0], radius=0.8),
        "floor": GROUND,
        "light": POINT,
    }


def solids() -> dict[str, Any]:
    """Facets, a box and a rough ball over a floor, in the light of a lamp."""
    return {
        "facets": octahedron((0.5, 0.5, 0.5), 0.8),
        "ball": ball({"type": "roughplastic", "alpha": 0.3}, center=[-1, 0.3, 0.4], radius=0.6),
        "box": {"type": "cube", "to_world": T().translate([0.8, -1, 0]).rotate([0.6, 0.8, 0], 35).scale(0.4)},
        "floor": GROUND,
        "lamp": {"type": "sphere", "center": [3, 3, 6], "radius": 0.5, "emitter": {"type": "area", "radiance": 60.0}},
    }


def facets() -> dict[str, Any]:
    """A mesh without normals under a sky, seen through a lens."""
    return {
        "facets": octahedron((0.1, 0.2, 0), 1.2),
        "sky": sky(),
        "sensor": sensor((-1, -1, 6), 45, type="thinlens", aperture_radius=0.2, focus_distance=6.0),
    }


def derivatives(nodes: Callable[[], dict[str, Any]], integrator: Any, seed: int) -> tuple[float, dict[str, float]]:
    """The change of a loss along a random direction, and, in reverse mode, the part of each parameter in it."""
    random = np.random.default_rng(seed)
    directions: dict[str, Any] = {}

    def scene(changes: bool) -> tuple[Any, dict[str, Any]]:
        scene = djpt.load_dict({"type": "scene", "sensor": sensor((-1, -1, 6), 45)} | nodes(), optimize=False)
        params = djpt.traverse(scene)
        leaves: dict[str, Any] = {}
        for key in [key for key in params if params.flags(key).differentiable]:
            value = params[key]
            placed = "Transform" in type(value).__name__
            value = djpt.Transform4f(value).matrix if placed else value
            leaf = type(value)(value)
            shape = np.array(leaf).shape
            if key not in directions:
                directions[key] = random.normal(size=shape).astype(np.float32) * 0.2
            dr.enable_grad(leaf)
            if changes:
                change = directions[key]
                dr.set_grad(leaf, type(leaf)(change if shape else float(change)))
            leaves[key] = leaf
            params[key] = djpt.Transform4f(leaf) if placed else leaf
        params.update()
        return scene, leaves

    moving, leaves = scene(True)
    dr.enqueue(dr.ADMode.Forward, list(leaves.values()))
    dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
    change = np.array(integrator.render_forward(moving, None, spp=SPP, seed=seed), np.float64)
    moving, leaves = scene(False)
    integrator.render_backward(moving, None, TensorXf(WEIGHTS), spp=SPP, seed=seed)
    parts = {k: float((np.array(dr.grad(v), np.float64) * directions[k]).sum()) for k, v in leaves.items()}
    return float((WEIGHTS * change).sum()), parts


@pytest.mark.parametrize(
    ("nodes", "kind", "depth"),
    [
        pytest.param(lit, "direct_projective", 2, id="direct light", marks=pytest.mark.slow),
        pytest.param(lit, "prb_projective", 4, id="indirect light", marks=pytest.mark.slow),
        pytest.param(solids, "direct_projective", 2, id="solids", marks=pytest.mark.slow),
        pytest.param(facets, "prb_projective", 3, id="facets", marks=pytest.mark.slow),
    ],
)
def test_both_modes_agree(nodes: Callable[[], dict[str, Any]], kind: str, depth: int) -> None:
    integrator = djpt.load_dict({"type": kind, "max_depth": depth, "unproven_gradients": True})
    integrator.proj_seed_spp, integrator.octree_extra_leaf_sample, integrator.octree_max_depth = 64, 32, 7
    forward, parts = derivatives(nodes, integrator, 7)
    largest = max(abs(forward), *(abs(part) for part in parts.values()))
    assert sum(part != 0 for part in parts.values()) > 6
    assert sum(parts.values()) == pytest.approx(forward, abs=ROUNDING * largest), parts

"""The notes of path replay: gradients are those of two searches for each ray."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.rendering.gradients import hit_cache, replay, single_walk
from tests.kit.mesh_scenes import gallery
from tests.kit.placed_scenes import instances


def derivatives(description: dict[str, Any], names: list[str]) -> list[np.ndarray]:
    """The gradients of a weighted image, and its change by the first name."""
    scene = djpt.load_dict(description)
    params = djpt.traverse(scene)
    for name in names:
        dr.enable_grad(params[name])
    params.update()
    image = djpt.render(scene, params, spp=4, seed=3, schedule="flat")
    weights = np.random.default_rng(2).uniform(0.5, 1.5, image.shape).astype(np.float32)
    dr.backward(dr.sum(image * djpt.TensorXf(weights), axis=None))
    found = [np.array(dr.grad(params[name])) for name in names]
    image = djpt.render(scene, params, spp=4, seed=3, schedule="flat")
    dr.set_grad(params[names[0]], 1)
    return [*found, np.array(dr.forward_to(image))]


def paths(max_depth: int) -> dict[str, Any]:
    return {"type": "prb", "max_depth": max_depth, "rr_depth": 1000}


@pytest.mark.parametrize("kind", ["meshes", "longer paths than notes", "instances"])
@pytest.mark.sparse(3)
def test_gradients_with_and_without_notes(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if kind == "instances":
        description = instances()
        names = [key for key in djpt.traverse(djpt.load_dict(description)) if key.endswith("reflectance.value")][:2]
    else:
        monkeypatch.setattr(hit_cache, "CACHED_VERTICES", 2 if kind != "meshes" else hit_cache.CACHED_VERTICES)
        description, names = gallery(tmp_path), ["floor.bsdf.reflectance.value", "flat.bsdf.reflectance.value"]
    description["integrator"] = paths(6)
    pages: list[Any] = []
    for_vertex = hit_cache.HitCache.for_vertex

    def noticed(cache: hit_cache.HitCache, *arguments: Any) -> Any:
        pages.append(arguments)
        return for_vertex(cache, *arguments)

    monkeypatch.setattr(hit_cache.HitCache, "for_vertex", noticed)
    monkeypatch.setattr(single_walk, "possible", lambda *arguments: False)
    noted = derivatives(description, names)
    assert bool(pages) == (not djpt.load_dict(description).geometry.stepwise)
    monkeypatch.setattr(replay, "empty_hit_cache", lambda *arguments: ())
    for found, expected in zip(noted, derivatives(description, names), strict=True):
        assert np.abs(expected).max() > 0
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def test_media_have_no_notes(tmp_path: Path) -> None:
    description = gallery(tmp_path)
    description["air"] = {"type": "homogeneous", "sigma_t": 0.1, "albedo": 0.5}
    description["sensor"]["medium"] = {"type": "ref", "id": "air"}
    scene = djpt.load_dict(description)
    integrator = djpt.load_dict({"type": "volpath", "max_depth": 4})
    assert hit_cache.empty_hit_cache(integrator, scene.replace(all_media=True), 16) == ()

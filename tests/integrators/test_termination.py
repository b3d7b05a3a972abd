"""Where paths end: depths are inputs of kernels, so that an edit compiles nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.description.properties import Properties
from djpt.rendering.denoising.rendered import GuideIntegrator
from tests.kit.kernels import kernels
from tests.kit.mesh_scenes import gallery
from tests.kit.renders import box, pixels, spheres

DEPTHS = [(4, 2), (3, 9), (-1, 1), (40, 1)]
"""Pairs of `max_depth` and `rr_depth`: before, at and beyond the end of paths, and paths without an end."""

PHOTONS = {"photon_count": 500}

WITH_ROULETTE: dict[str, dict[str, Any]] = {
    **{kind: {} for kind in ("path", "prb", "path_naive", "volpath", "volpathmis", "prbvolpath", "ptracer", "bdpt")},
    **{"guided": {}, "sppm": PHOTONS, "vcm": PHOTONS, "prb_projective": {"sppc": 2, "sppp": 0, "sppi": 0}},
}
WITHOUT: dict[str, dict[str, Any]] = {"path_nee": {}, "prb_basic": {}}
REPLAYED = "path", "prb_basic", "path_nee", "path_naive", "volpath", "ptracer", "bdpt"

ALBEDO = "white.reflectance.value"


def limited(kind: str, depth: tuple[int, int]) -> Any:
    roulette = {} if kind in WITHOUT else {"rr_depth": depth[1]}
    return djpt.load_dict({"type": kind, "max_depth": depth[0], **roulette, **(WITHOUT | WITH_ROULETTE)[kind]})


@pytest.fixture(scope="module")
def scene() -> Any:
    return djpt.load_dict(box(8, "box", edit=spheres))


@pytest.mark.sparse(6)
@pytest.mark.parametrize("kind", [*WITH_ROULETTE, *WITHOUT])
def test_depths_share_a_kernel(kind: str, scene: Any) -> None:
    """The first render is left out: what a scene computes once belongs to it."""
    launched = [
        kernels(lambda depth=depth: djpt.render(scene, integrator=limited(kind, depth), spp=2))
        for depth in (DEPTHS[0], *DEPTHS)
    ]
    assert launched[1]
    assert all(hashes == launched[1] for hashes in launched[2:])


def gradient_kernels(scene: Any, **options: Any) -> set[str]:
    params = djpt.traverse(scene)
    dr.enable_grad(params[ALBEDO])
    params.set_dirty(ALBEDO)
    params.update()

    def differentiate() -> None:
        dr.backward(dr.sum(djpt.render(scene, params, spp=2, **options).array))
        dr.eval(dr.grad(params[ALBEDO]))

    try:
        return kernels(differentiate)
    finally:
        dr.disable_grad(params[ALBEDO])


@pytest.mark.sparse(4)
@pytest.mark.parametrize("kind", REPLAYED)
def test_depths_share_the_kernels_of_gradients(kind: str, scene: Any) -> None:
    once, *others = (gradient_kernels(scene, integrator=limited(kind, depth)) for depth in (DEPTHS[0], *DEPTHS))
    assert once
    assert all(hashes == others[0] for hashes in others)


@pytest.mark.parametrize("nested", [{"type": "aov", "aovs": "d:depth"}, {"type": "moment"}], ids=["aov", "moment"])
def test_depths_of_nested_integrators_share_a_kernel(nested: dict[str, Any], scene: Any) -> None:
    def nest(depth: tuple[int, int]) -> Any:
        inner = {"type": "path", "max_depth": depth[0], "rr_depth": depth[1]}
        return djpt.load_dict({**nested, "inner": inner})

    launched = [
        kernels(lambda depth=depth: djpt.render(scene, integrator=nest(depth), spp=2)) for depth in (DEPTHS[0], *DEPTHS)
    ]
    assert all(hashes == launched[1] for hashes in launched[2:])


@pytest.mark.parametrize("schedule", ["flat", "machine", "wave"])
@pytest.mark.sparse(2)
def test_depths_share_a_kernel_in_all_schedules(schedule: str, tmp_path: Path) -> None:
    meshes = djpt.load_dict(gallery(tmp_path, (8, 8)))
    launched = [
        kernels(lambda depth=depth: djpt.render(meshes, integrator=limited("path", depth), spp=2, schedule=schedule))
        for depth in (DEPTHS[0], *DEPTHS)
    ]
    assert all(hashes == launched[1] for hashes in launched[2:])


def test_depths_of_guides_share_a_kernel(scene: Any) -> None:
    def guides(depth: int) -> set[str]:
        integrator = GuideIntegrator(Properties("guides", "guides", {"max_depth": depth}))
        return kernels(lambda: djpt.render(scene, integrator=integrator, spp=2))

    guides(1)
    assert guides(1) == guides(3) == guides(9)


@pytest.mark.sparse(12)
@pytest.mark.parametrize("kind", ["path", "path_nee", "volpath", "ptracer", "bdpt", "sppm", "vcm", "prb_projective"])
def test_depths_may_be_edited(kind: str, scene: Any) -> None:
    """The images before and after an edit are those of integrators that were made with these depths."""

    def image(integrator: Any) -> np.ndarray:
        return pixels(djpt.render(scene, integrator=integrator, spp=4, seed=1))

    edited = limited(kind, (2, 1))
    found = [image(edited)]
    for depth in [(5, 3), (40, 2), (1, 2)]:
        edited.max_depth = depth[0]
        if kind not in WITHOUT:
            edited.rr_depth = depth[1]
            assert edited.rr_depth == depth[1]
        np.testing.assert_array_equal(image(edited), image(limited(kind, depth)))
        found.append(image(edited))
    assert len({array.tobytes() for array in found}) == len(found)


@pytest.mark.parametrize("kind", ["path", "volpath", "bdpt"])
@pytest.mark.sparse(2)
def test_edited_depths_may_be_none_and_unbounded(kind: str, scene: Any) -> None:
    edited = limited(kind, (2, 1))
    edited.max_depth = 0
    assert not pixels(djpt.render(scene, integrator=edited, spp=4)).any()
    edited.max_depth = -1
    unbounded = djpt.render(scene, integrator=limited(kind, (-1, 1)), spp=4)
    np.testing.assert_array_equal(pixels(djpt.render(scene, integrator=edited, spp=4)), pixels(unbounded))


def test_depths_may_be_edited_between_frozen_calls(scene: Any) -> None:
    render = dr.freeze(lambda integrator, seed: djpt.render(scene, integrator=integrator, spp=2, seed=seed))
    integrator = limited("path", (2, 5))
    for depth in [(2, 5), (2, 5), (5, 2), (-1, 1), (1, 5), (2, 5)]:
        integrator.max_depth, integrator.rr_depth = depth
        expected = djpt.render(scene, integrator=limited("path", depth), spp=2, seed=3)
        np.testing.assert_array_equal(pixels(render(integrator, djpt.UInt32(3))), pixels(expected))

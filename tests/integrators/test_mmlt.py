"""Metropolis light transport: the means of `path`, its chains, and what it refuses."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError, SceneError
from djpt.integrators.markov.chains import FINEST, step
from djpt.jit.types import PCG32, Float, UInt32
from tests.kit.convergence import assert_converges_to_path, assert_equal_means, images
from tests.kit.emitters import entry
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import box
from tests.kit.threads import assert_same_for_any_threads

SIZE, SPP = 16, 256


def check(scene: dict[str, Any], depth: int = 4, spp: int = SPP, other: str = "path", **keys: Any) -> None:
    """Assert that `mmlt` and another integrator converge to one image: by the errors of independent renders."""
    hide = {key: keys[key] for key in keys if key == "hide_emitters"}
    ours = images(scene, {"type": "mmlt", "max_depth": depth, **keys}, spp)
    assert_equal_means(ours, images(scene, {"type": other, "max_depth": depth, **hide}, spp, 100))


@pytest.mark.slow
def test_lamps_the_sky_and_a_point() -> None:
    lights = {
        "sky": {"type": "constant", "radiance": 0.3},
        "point": {"type": "point", "position": [1, 3, 1]},
        "lamp": floor_scene()["lamp"],
    }
    check(floor_scene(lights, size=SIZE), emitter_choice="power")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["spot-default", "directional-default", "envmap-sun", "projector-bitmap", "area-bitmap sphere"]
)
def test_lights(name: str) -> None:
    check(floor_scene({"light": entry(name)}, size=SIZE))


@pytest.mark.slow
def test_beams() -> None:
    """Light that leaves a surface in one direction only, which `path` can't show; around the spot it is dark."""
    check(floor_scene({"light": entry("directionalarea-rectangle")}, size=SIZE), 2, other="bdpt")


SENSORS: dict[str, dict[str, Any]] = {
    "thinlens": {"type": "thinlens", "fov": 35, "aperture_radius": 0.3, "focus_distance": 5.0},
    "near plane": {"type": "perspective", "fov": 50, "principal_point_offset_x": 0.1, "near_clip": 2.0},
    "orthographic": {"type": "orthographic"},
    "meter": {"type": "distant", "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SENSORS)
def test_sensors(name: str) -> None:
    """A meter isn't reached by light: strategies with one vertex on its side are left out."""
    scene = floor_scene(sensor=SENSORS[name], size=SIZE)
    if name == "orthographic":
        scene["sensor"]["to_world"] = scene["sensor"]["to_world"] @ T().scale([2.5, 2.5, 1])
    check(scene, spp=SPP if name != "meter" else 2**16)


MATERIALS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "glass": ({"type": "dielectric"}, {"type": "thindielectric"}),
    "rough glass": ({"type": "roughdielectric", "alpha": 0.3}, {"type": "roughconductor", "alpha": 0.3}),
    "coloured glass": (
        {"type": "glass", "absorption": {"type": "rgb", "value": [0.9, 0.25, 0.12]}},
        {"type": "principled", "spec_trans": 0.8, "roughness": 0.3, "eta": 1.4},
    ),
    "openings": (
        {"type": "mask", "opacity": 0.5, "inner": {"type": "twosided", "inner": {"type": "diffuse"}}},
        {"type": "plastic"},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MATERIALS)
def test_materials(name: str) -> None:
    scene = floor_scene(size=SIZE)
    scene["ball"]["bsdf"], scene["small"]["bsdf"] = MATERIALS[name]
    check(scene, 5, 2 * SPP)


@pytest.mark.slow
def test_something_in_coloured_glass() -> None:
    """What absorbs weakens the connections within it, too."""
    scene = floor_scene(size=SIZE)
    scene["ball"]["bsdf"] = {"type": "glass", "int_ior": 1.0, "absorption": {"type": "rgb", "value": [0.9, 0.25, 0.12]}}
    scene["core"] = {"type": "sphere", "center": [-0.9, -0.2, 0.1], "radius": 0.5, "bsdf": {"type": "diffuse"}}
    check(scene, 5, 2 * SPP)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({*djpt.scenes.SCENES} - {"parabolic_mirror", "pool"}))
def test_built_in_scenes(name: str) -> None:
    """16 million steps."""
    assert_converges_to_path(name, {"type": "mmlt"}, 1024, 4096, unbounded=8)


@pytest.mark.slow
def test_hidden_lamps() -> None:
    check(floor_scene(size=SIZE), 3, hide_emitters=True)


@pytest.mark.slow
def test_steps_of_one_kind_alone() -> None:
    """Large steps alone make independent samples; with small ones alone no chain leaves its strategy."""
    scene = floor_scene(size=SIZE)
    for large in (0.0, 1.0):
        check(scene, 3, large_step_probability=large, chains=256)


# ---------------------------------------------------------------- mutations


def test_small_steps_are_symmetric_and_keep_numbers_uniform() -> None:
    count, largest = 2**20, 0.1
    random = PCG32(size=count)
    u, a = random.next_float32(), random.next_float32()
    moved = step(u, a, Float(largest)).numpy().astype(np.float64)
    assert moved.min() >= 0 and moved.max() < 1
    counts, _ = np.histogram(moved, bins=64, range=(0, 1))
    assert np.abs(counts - count / 64).max() < 5 * np.sqrt(count / 64)
    way = (moved - u.numpy().astype(np.float64) + 0.5) % 1 - 0.5
    assert abs(way.mean()) < 5 * way.std() / np.sqrt(count)
    assert largest * FINEST * 0.99 < np.abs(way).min() and np.abs(way).max() < largest * 1.01
    # The logarithm of the distance is uniform.
    assert np.median(np.abs(way)) == pytest.approx(largest * np.sqrt(FINEST), rel=0.02)


# ---------------------------------------------------------------- contracts


@pytest.mark.slow
def test_image_is_the_same_for_any_threads_and_passes() -> None:
    scene, plugin = djpt.load_dict(box(32, "gaussian")), djpt.load_dict({"type": "mmlt", "max_depth": 5})

    def render(**arguments: Any) -> np.ndarray:
        return np.array(djpt.render(scene, integrator=plugin, spp=600, **{"seed": 4, **arguments}))

    first = assert_same_for_any_threads(render)
    np.testing.assert_array_equal(render(pass_spp=177), first)
    assert (render(seed=5) != first).any()


def test_depths() -> None:
    scene = djpt.load_dict(box(16))
    one, path = (djpt.load_dict({"type": kind, "max_depth": 1}) for kind in ("mmlt", "path"))
    ours, theirs = (np.array(djpt.render(scene, integrator=plugin, spp=16)) for plugin in (one, path))
    np.testing.assert_allclose(ours, theirs, rtol=1e-5)


def test_where_no_light_comes_it_is_dark() -> None:
    """A lamp that shines into the void: no chain can begin."""
    scene = floor_scene(size=8)
    scene["lamp"] = {**scene["lamp"], "to_world": scene["lamp"]["to_world"] @ T().rotate([1, 0, 0], 180)}
    image = np.array(djpt.render(djpt.load_dict(scene), integrator=djpt.load_dict({"type": "mmlt"}), spp=4))
    assert image.max() == 0


def test_what_is_refused() -> None:
    fog = {"type": "homogeneous", "albedo": 0.8, "sigma_t": 1.0}
    scene = floor_scene(size=4)
    scene["ball"].update(bsdf={"type": "null"}, interior={**fog, "id": "fog"})
    with pytest.raises(RenderError, match=r"'mmlt' doesn't follow light through scattering media.*fog.*volpath"):
        djpt.render(djpt.load_dict(scene), integrator=djpt.load_dict({"type": "mmlt"}), spp=1)
    for key, value in {"max_depth": -1, "large_step_probability": 1.5, "chains": 0, "sigma": 0.6}.items():
        with pytest.raises(SceneError, match=key):
            djpt.load_dict({"type": "mmlt", key: value})


def test_frozen_functions_cannot_record_it() -> None:
    loaded = djpt.load_dict(box(8, integrator={"type": "mmlt"}))
    frozen = dr.freeze(lambda scene, seed: djpt.render(scene, spp=2, seed=seed))
    with pytest.raises(RuntimeError) as error:
        frozen(loaded, UInt32(1))
    assert "frozen function" in str(error.value) or "frozen function" in str(error.value.__cause__)

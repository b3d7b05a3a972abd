"""Bidirectional path tracing: the means of `path`, its strategies, and what it refuses."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError, SceneError
from djpt.integrators import bdpt
from djpt.integrators.bidirectional.strategies import strategies
from tests.kit.convergence import assert_converges_to_path, assert_equal_means, images
from tests.kit.devices import instances
from tests.kit.emitters import NAMES, entry, first_of_each, plugin_of
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import box
from tests.kit.threads import assert_same_for_any_threads


def check(scene: dict[str, Any], depth: int = 4, spp: int = 64, **keys: Any) -> None:
    """Assert that `bdpt` and `path` converge to one image."""
    shared = {"max_depth": depth, **{key: keys[key] for key in keys if key != "heuristic"}}
    ours = images(scene, {"type": "bdpt", **shared, **keys}, spp)
    assert_equal_means(ours, images(scene, {"type": "path", **shared}, 4 * spp, 100))


LIT = first_of_each(name for name in NAMES if plugin_of(name) not in ("directionalarea", "spot", "projector"))
FURTHER = [name for name in NAMES if plugin_of(name) in ("spot", "projector")]


@pytest.mark.sparse(24)
@pytest.mark.parametrize("name", [*LIT, *(pytest.param(name, marks=pytest.mark.slow) for name in FURTHER)])
def test_lights(name: str) -> None:
    check(floor_scene({"light": entry(name)}, size=16))


def test_many_lights() -> None:
    """A lamp, a point and the sky at once, chosen by their power, with the other heuristic."""
    lights = {
        "sky": {"type": "constant", "radiance": 0.3},
        "point": {"type": "point", "position": [1, 3, 1]},
        "lamp": floor_scene()["lamp"],
    }
    check(floor_scene(lights, size=16), heuristic="balance", emitter_choice="power")


SENSORS: dict[str, dict[str, Any]] = {
    "thinlens": {"type": "thinlens", "fov": 35, "aperture_radius": 0.3, "focus_distance": 5.0},
    "near plane": {"type": "perspective", "fov": 50, "principal_point_offset_x": 0.1, "near_clip": 2.0},
    "orthographic": {"type": "orthographic"},
    "meter": {
        "type": "distant",
        "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
    },
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "thinlens" else pytest.mark.slow) for name in SENSORS]
)
def test_sensors(name: str) -> None:
    """A meter isn't reached by light: connections do all."""
    scene = floor_scene(sensor=SENSORS[name], size=16)
    if name == "orthographic":
        scene["sensor"]["to_world"] = scene["sensor"]["to_world"] @ T().scale([2.5, 2.5, 1])
    check(scene, spp=64 if name != "meter" else 4096)


@pytest.mark.parametrize("border", [False, True])
@pytest.mark.sparse(2)
def test_filters(border: bool) -> None:
    """At the border, too, whether samples are taken beyond it or not."""
    scene = floor_scene(size=16)
    scene["sensor"]["film"].update(rfilter={"type": "gaussian"}, sample_border=border)
    check(scene, 3)


def heights() -> dict[str, Any]:
    data = np.random.default_rng(1).random((8, 16)).astype(np.float32)
    return {"type": "bitmap", "data": data, "raw": True}


MATERIALS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "mapped normals": (
        {"type": "bumpmap", "heights": heights(), "scale": 0.3, "inner": {"type": "roughplastic", "alpha": 0.3}},
        {"type": "hair"},
    ),
    "rough glass": ({"type": "roughdielectric", "alpha": 0.3}, {"type": "principledthin", "diff_trans": 1.2}),
    "coats": ({"type": "plastic"}, {"type": "roughconductor", "material": "Au", "alpha": 0.2}),
    "glass": ({"type": "dielectric"}, {"type": "thindielectric"}),
    "coloured glass": (
        {"type": "glass", "absorption": {"type": "rgb", "value": [0.9, 0.25, 0.12]}},
        {"type": "principled", "spec_trans": 0.8, "roughness": 0.3, "eta": 1.4},
    ),
    "openings": (
        {"type": "mask", "opacity": 0.5, "inner": {"type": "twosided", "inner": {"type": "diffuse"}}},
        {"type": "blendbsdf", "weight": 0.4, "a": {"type": "diffuse"}, "b": {"type": "roughconductor", "alpha": 0.3}},
    ),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "mapped normals" else pytest.mark.slow) for name in MATERIALS]
)
def test_materials(name: str) -> None:
    scene = floor_scene(size=16)
    scene["ball"]["bsdf"], scene["small"]["bsdf"] = MATERIALS[name]
    check(scene, 5, 128)


@pytest.mark.slow
def test_meshes_and_instances(tmp_path: Path) -> None:
    """Smooth normals, vertex colours, copies of a ball."""
    scene = instances(tmp_path)
    scene["sensor"]["film"].update(width=16, height=16)
    check(scene, 4, 128)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({*djpt.scenes.SCENES} - {"parabolic_mirror", "lamp_behind_pane", "pool"}))
def test_built_in_scenes(name: str) -> None:
    """16 million samples."""
    assert_converges_to_path(name, {"type": "bdpt"}, 1024, 4096)


def test_hidden_lamps() -> None:
    check(floor_scene(size=16), 3, hide_emitters=True)


@pytest.mark.slow
def test_beams_are_shown() -> None:
    """Light that leaves a surface in one direction only, which `path` can't show, as `ptracer` shows it."""
    scene = floor_scene({"light": entry("directionalarea-rectangle")}, size=16)
    ours = images(scene, {"type": "bdpt", "max_depth": 4}, 256)
    assert_equal_means(ours, images(scene, {"type": "ptracer", "max_depth": 4}, 512, 100))


@pytest.mark.slow
def test_long_paths_are_left_to_the_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a furnace, where they matter: with and without a longest path."""
    monkeypatch.setattr(bdpt, "JOINED", 3)
    scene = djpt.scenes.furnace(0.8)
    scene["sensor"]["film"].update(width=16, height=16)
    for depth in (6, -1):
        expected = (1 - 0.8**depth) / 0.2 if depth > 0 else 5.0
        ours = images(scene, {"type": "bdpt", "max_depth": depth, "rr_depth": 9}, 256)
        assert_equal_means(ours, [np.full_like(ours[0], expected)] * 2)


# ---------------------------------------------------------------- closed forms


@pytest.mark.slow
def test_caustic_of_a_parabolic_mirror() -> None:
    """Ring by ring, away from the rim of the beam; its formula is in the scene's documentation."""
    scene = djpt.load_dict(djpt.scenes.parabolic_mirror())
    image = np.array(djpt.render(scene, spp=1024), np.float64).mean(axis=2)
    place = 3 * (np.arange(64) + 0.5) / 64 - 1.5
    r = np.hypot(*np.meshgrid(place, place))
    beam = 0.9 / 0.25 / (1 + r**2) ** 2
    expected = (np.where(r < 1, beam, 0) + 2.5 / (2.5**2 + r**2) ** 1.5) / np.pi
    rings = np.arange(0, 1.5, 0.15)
    for low, high in itertools.pairwise(rings):
        ring = (r >= low) & (r < high) & (np.abs(r - 1) > 0.05)
        assert image[ring].mean() == pytest.approx(expected[ring].mean(), rel=0.01)
    by_camera = djpt.render(scene, integrator=djpt.load_dict({"type": "path", "max_depth": 3}), spp=16)
    assert np.array(by_camera)[32, 32, 0] < 0.1 * image[32, 32]


def test_a_plane_below_a_point() -> None:
    """I cos^3 / (pi h^2), and nothing that is brighter than the light that there is."""
    scene = djpt.scenes.parabolic_mirror()
    del scene["mirror"]
    image = np.array(djpt.render(djpt.load_dict(scene), spp=64), np.float64).mean(axis=2)
    place = 3 * (np.arange(64) + 0.5) / 64 - 1.5
    r = np.hypot(*np.meshgrid(place, place))
    np.testing.assert_allclose(image.mean(), (2.5 / (2.5**2 + r**2) ** 1.5 / np.pi).mean(), rtol=5e-3)


# ---------------------------------------------------------------- strategies


@pytest.mark.slow
def test_strategies_add_up_and_agree() -> None:
    """Weighted images of all strategies make up the image without what is seen directly; alone, all show the same."""
    depth = 3
    scene = floor_scene(size=16)
    # Where surfaces touch, connections alone have an infinite variance.
    del scene["small"]
    scene["ball"].update(center=[0.0, 0.6, 0.0], radius=0.5)
    plugin = {"type": "bdpt", "max_depth": depth, "strategies": True}
    loaded, integrator = djpt.load_dict(scene), djpt.load_dict(plugin)
    names = djpt.channel_names(loaded, integrator=integrator)
    found: list[dict[str, np.ndarray]] = []
    for image in images(scene, plugin, 512):
        layers = np.split(image, image.shape[2] // 3, axis=2)
        found.append(dict(zip((name.removesuffix(".R") for name in names[::3]), layers, strict=True)))
    straight = np.array(djpt.render(loaded, integrator=djpt.load_dict({"type": "path", "max_depth": 1}), spp=512))
    lamp = straight.max(axis=2, keepdims=True) > 0
    for layers in found:
        total = sum(layers[f"s{s}t{t}"] for s, t in strategies(depth))
        np.testing.assert_allclose((total - layers["R"]) * ~lamp, 0, atol=1e-5)
    for edges in range(2, depth + 1):
        row = [(s, t) for s, t in strategies(depth) if s + t - 1 == edges]
        assert len(row) == edges + 1
        first = [layers[f"s1t{edges}.alone"] for layers in found]
        for s, t in row:
            alone = [layers[f"s{s}t{t}.alone"] for layers in found]
            assert alone[0].max() > 0
            # What a strategy rarely finds is no matter of a normal distribution, in small blocks.
            assert_equal_means(alone, first, block=8)


def test_one_connection_stands_for_all() -> None:
    """Images of strategies follow the rays of all connections, the image itself those of one for each vertex."""
    scene = djpt.load_dict(box(16, "box", {"type": "path"}))
    means = []
    for strategies_too in (False, True):
        integrator = djpt.load_dict({"type": "bdpt", "max_depth": 5, "strategies": strategies_too})
        images = [np.array(djpt.render(scene, integrator=integrator, spp=128, seed=seed)) for seed in range(6)]
        below_the_lamp = np.stack(images, dtype=np.float64)[:, 8:, :, :3]
        means.append(below_the_lamp.reshape(6, 2, 4, 4, 4, 3).mean((2, 4)))
    a, b = means
    error = np.sqrt(a.var(0, ddof=1) / 6 + b.var(0, ddof=1) / 6)
    assert (np.abs(a.mean(0) - b.mean(0)) < 5 * error.max()).all()
    assert error.max() < 0.05 * a.mean()


def test_strategies_need_a_bound() -> None:
    for depth in (-1, 1, 9):
        with pytest.raises(SceneError, match=r"strategies.* needs a 'max_depth' from 2 to 8"):
            djpt.load_dict({"type": "bdpt", "strategies": True, "max_depth": depth})


# ---------------------------------------------------------------- contracts


def test_image_is_the_same_for_any_threads_and_passes() -> None:
    scene, plugin = djpt.load_dict(box(32, "gaussian")), djpt.load_dict({"type": "bdpt", "max_depth": 5})

    def render(**arguments: Any) -> np.ndarray:
        return np.array(djpt.render(scene, integrator=plugin, spp=32, **{"seed": 4, **arguments}))

    first = assert_same_for_any_threads(render)
    np.testing.assert_array_equal(render(pass_spp=5), first)
    assert (render(seed=5) != first).any()


def test_depths() -> None:
    scene = djpt.load_dict(box(16))

    def render(kind: str, depth: int) -> np.ndarray:
        return np.array(djpt.render(scene, integrator=djpt.load_dict({"type": kind, "max_depth": depth}), spp=16))

    assert render("bdpt", 0).max() == 0
    np.testing.assert_allclose(render("bdpt", 1), render("path", 1), rtol=1e-5)


def test_coverage_is_that_of_path() -> None:
    keys: dict[str, Any]
    scene = floor_scene(size=16)
    scene["sensor"]["film"]["pixel_format"] = "rgba"
    loaded = djpt.load_dict(scene)
    for keys in ({}, {"hide_emitters": True}):
        a, b = (
            np.array(djpt.render(loaded, integrator=djpt.load_dict({"type": kind, "max_depth": 3, **keys}), spp=16))
            for kind in ("bdpt", "path")
        )
        np.testing.assert_allclose(a[..., 3], b[..., 3], atol=1e-6)


def test_what_is_refused() -> None:
    glowing = {"type": "homogeneous", "emission": 1.0}
    scene = floor_scene({}, size=4)
    scene["ball"].update(bsdf={"type": "null"}, interior=glowing)
    with pytest.raises(RenderError, match=r"'bdpt' starts at emitters, and the scene has none.*volpath"):
        djpt.render(djpt.load_dict(scene), integrator=djpt.load_dict({"type": "bdpt"}), spp=1)
    with pytest.raises(SceneError, match="heuristic"):
        djpt.load_dict({"type": "bdpt", "heuristic": "maximum"})

"""The integrators of the teaching texts: all of them tell the same story, with more or less noise."""

from __future__ import annotations

import warnings
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import box, ours, theirs

NAIVE: list[dict[str, Any]] = [
    {"type": "path_naive", "hemisphere": "uniform"},
    {"type": "path_naive", "hemisphere": "cosine"},
    {"type": "path_nee"},
]


def images(scene: Any, integrator: dict[str, Any], spp: int, seeds: int, depth: int = 6) -> np.ndarray:
    plugin = djpt.load_dict({"max_depth": depth, **integrator})
    return np.stack([np.array(djpt.render(scene, integrator=plugin, spp=spp, seed=7 + s)) for s in range(seeds)])


def z_score(a: np.ndarray, b: np.ndarray) -> float:
    """Of the difference of two sets of images' means; independent images."""
    x, y = a.mean(axis=(1, 2, 3)), b.mean(axis=(1, 2, 3))
    return abs(x.mean() - y.mean()) / np.sqrt(x.var(ddof=1) / len(x) + y.var(ddof=1) / len(y))


def shiny(scene: dict[str, Any]) -> dict[str, Any]:
    """With glass, rough metal, rough glass, and a surface that has both a mirror and a smooth lobe."""
    scene["ball"]["bsdf"] = {"type": "dielectric"}
    scene["small"]["bsdf"] = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.7]}}
    scene["gold"] = {
        "type": "sphere",
        "center": [0.2, -0.6, -0.9],
        "radius": 0.4,
        "bsdf": {"type": "roughconductor", "material": "Au", "alpha": 0.4},
    }
    scene["frosted"] = {
        "type": "sphere",
        "center": [0.1, -0.7, 1.6],
        "radius": 0.3,
        "bsdf": {"type": "roughdielectric", "alpha": 0.4},
    }
    scene["sky"] = {"type": "constant", "radiance": 0.3}
    return scene


@pytest.mark.parametrize("integrator", NAIVE, ids=str)
@pytest.mark.parametrize("materials", [pytest.param("diffuse", marks=pytest.mark.slow), "shiny"])
@pytest.mark.sparse(3)
def test_same_mean_as_path(integrator: dict[str, Any], materials: str) -> None:
    big = {"type": "sphere", "center": [-1, 3, 1], "radius": 1.2, "emitter": {"type": "area", "radiance": 3.0}}
    description = floor_scene({"big": big}, size=16)
    scene = djpt.load_dict(shiny(description) if materials == "shiny" else description)
    assert z_score(images(scene, integrator, 256, 16), images(scene, {"type": "path"}, 128, 16)) < 4


def test_each_step_lowers_the_variance() -> None:
    """Of the surfaces: the noise at the lamp's edges, were it in sight, would be that of all of them."""
    scene = djpt.load_dict(box(32))
    steps = [{**integrator, "hide_emitters": True} for integrator in (*NAIVE, {"type": "path"})]
    uniform, cosine, nee, path = (images(scene, integrator, 64, 4).var(axis=0).mean() for integrator in steps)
    assert uniform > 1.5 * cosine
    assert cosine > 30 * nee
    assert nee > 1.25 * path


def test_point_lights_need_light_sampling() -> None:
    lamp = {"type": "point", "position": [0, 2, 2], "intensity": 3.0}
    scene = djpt.load_dict(floor_scene({"lamp": lamp}, size=8))
    for integrator in (NAIVE[0], {"type": "prb_basic"}, {"type": "path_naive", "bounces": True}):
        with pytest.warns(UserWarning, match=r"doesn't sample lights.*: lamp stays black") as caught:
            assert images(scene, integrator, 16, 1).max() == 0
        assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert images(scene, {"type": "path_nee"}, 16, 1).mean() > 0.01
        images(djpt.load_dict(box(8)), NAIVE[0], 1, 1)


def test_paths_that_never_end_are_refused() -> None:
    with pytest.raises(djpt.SceneError, match="russian_roulette"):
        djpt.load_dict({"type": "path_nee", "russian_roulette": 1.0})
    with pytest.raises(djpt.SceneError, match="russian_roulette"):
        djpt.load_dict({"type": "path_nee", "russian_roulette": 0.0})


@pytest.mark.parametrize("integrator", NAIVE, ids=str)
def test_gradients_by_replay(integrator: dict[str, Any]) -> None:
    """Images are linear in the light's radiance, here 1: with the same samples the derivative is the image."""
    lamp = {"type": "sphere", "center": [-1, 3, 1], "radius": 1.2, "emitter": {"type": "area"}}
    scene = djpt.load_dict(floor_scene({"lamp": lamp}, size=16))
    plugin = djpt.load_dict({"max_depth": 4, **integrator})
    params = djpt.traverse(scene)
    radiance = params["lamp.emitter.radiance.value"]
    dr.enable_grad(radiance)
    params.update()
    loss = dr.mean(djpt.render(scene, integrator=plugin, spp=16, seed=3, seed_grad=3), axis=None)
    dr.backward(loss)
    assert float(dr.sum(dr.grad(radiance))[0]) == pytest.approx(float(loss.numpy()), rel=1e-4)


# ---------------------------------------------------------------- before path tracing


def plane_scene(bsdf: dict[str, Any], **lights: Any) -> dict[str, Any]:
    """A floor at y = 0 seen from above, straight down."""
    return {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 1,
            "to_world": T().look_at([0, 4, 0], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 2, "height": 2, "rfilter": {"type": "box"}},
        },
        "floor": {"type": "rectangle", "to_world": T().rotate([1, 0, 0], -90).scale(50), "bsdf": bsdf},
        **lights,
    }


def value(scene: dict[str, Any], integrator: dict[str, Any], spp: int = 16) -> float:
    image = djpt.render(djpt.load_dict(scene), integrator=djpt.load_dict(integrator), spp=spp)
    return float(np.array(image).mean())


class TestRaycast:
    def test_headlight(self) -> None:
        scene = plane_scene({"type": "diffuse", "reflectance": 0.4})
        assert value(scene, {"type": "raycast"}) == pytest.approx(0.4, rel=1e-3)
        scene["floor"]["to_world"] = T().rotate([1, 0, 0], -90 + 60).scale(50)
        assert value(scene, {"type": "raycast"}) == pytest.approx(0.2, rel=0.02)

    def test_normal(self) -> None:
        scene = djpt.load_dict(plane_scene({"type": "diffuse"}))
        image = djpt.render(scene, integrator=djpt.load_dict({"type": "raycast", "shading": "normal"}), spp=4)
        np.testing.assert_allclose(np.array(image)[0, 0], [0.5, 1, 0.5], atol=1e-5)

    def test_mirrors_are_white_and_the_sky_is_seen(self) -> None:
        scene = plane_scene({"type": "conductor"}, sky={"type": "constant", "radiance": 3.0})
        assert value(scene, {"type": "raycast"}) == pytest.approx(1, rel=1e-3)
        del scene["floor"]
        assert value(scene, {"type": "raycast"}) == pytest.approx(3)
        assert value(scene, {"type": "raycast", "hide_emitters": True}) == 0

    def test_shadings_are_checked(self) -> None:
        with pytest.raises(djpt.SceneError, match="headlight"):
            djpt.load_dict({"type": "raycast", "shading": "headlite"})


class TestWhitted:
    def test_point_light_over_a_floor(self) -> None:
        """albedo / pi I / h^2, without noise."""
        lamp = {"type": "point", "position": [0, 2, 0], "intensity": 5.0}
        scene = plane_scene({"type": "diffuse", "reflectance": 0.4}, lamp=lamp)
        scene["sensor"]["fov"] = 0.01
        assert value(scene, {"type": "whitted"}) == pytest.approx(0.4 / np.pi * 5 / 4, rel=1e-4)

    def test_pane_shows_both_of_its_lobes(self) -> None:
        """A pane of glass over a floor, lit by the sky: R + T = 1, to the depth that is followed."""
        scene = plane_scene(
            {"type": "diffuse", "reflectance": 0.0},
            sky={"type": "constant", "radiance": 2.0},
            lamp={"type": "point", "position": [0, 100, 0], "intensity": 1e-6},
        )
        scene["ball"] = {"type": "sphere", "center": [0, 2, 0], "bsdf": {"type": "dielectric"}}
        del scene["floor"]
        assert value(scene, {"type": "whitted", "max_depth": 12}) == pytest.approx(2, rel=1e-3)

    def test_glass_and_mirrors_look_as_in_path(self) -> None:
        """In a scene of mirrors under a sky, where nothing else brings light, both give the same image."""
        lamp = {"type": "point", "position": [0, 90, 0], "intensity": 0.0}
        scene = floor_scene({"sky": {"type": "constant"}, "lamp": lamp}, size=24)
        scene["floor"]["bsdf"] = {"type": "conductor", "material": "Cu"}
        scene["ball"]["bsdf"] = {"type": "dielectric"}
        scene["small"]["bsdf"] = {"type": "thindielectric"}
        loaded = djpt.load_dict(scene)
        whitted = images(loaded, {"type": "whitted"}, 64, 4, depth=9)
        path = images(loaded, {"type": "path", "rr_depth": 100}, 1024, 4, depth=10)
        assert whitted.mean() == pytest.approx(path.mean(), rel=2e-3)
        assert np.abs(whitted.mean(axis=0) - path.mean(axis=0)).mean() < 0.02 * path.mean()

    def test_shadow_is_hard(self) -> None:
        scene = plane_scene({"type": "diffuse"}, lamp={"type": "point", "position": [0, 3, 0], "intensity": 5.0})
        scene["ball"] = {"type": "sphere", "center": [0, 1.5, 0], "radius": 0.2}
        scene["sensor"]["to_world"] = T().look_at([0, 1, 0.01], [0, 0, 0], [0, 0, 1])
        assert value(scene, {"type": "whitted"}) == 0

    def test_a_sky_alone_is_refused(self) -> None:
        scene = djpt.load_dict(plane_scene({"type": "diffuse"}, sky={"type": "constant"}))
        with pytest.raises(djpt.RenderError, match="environment"):
            djpt.render(scene, integrator=djpt.load_dict({"type": "whitted"}), spp=1)


class TestDistributed:
    @pytest.mark.parametrize(
        ("split", "light_samples"),
        [(3, 2), *(pytest.param(*pair, marks=pytest.mark.slow) for pair in ((1, 1), (2, 4)))],
    )
    def test_same_mean_as_path(self, split: int, light_samples: int) -> None:
        scene = djpt.load_dict(shiny(floor_scene(size=12)))
        integrator = {"type": "distributed", "split": split, "light_samples": light_samples}
        split_rays, path = images(scene, integrator, 64, 12, depth=3), images(scene, {"type": "path"}, 512, 12, depth=3)
        assert z_score(split_rays, path) < 4

    def test_more_rays_less_noise(self) -> None:
        """Four times as many light samples, a quarter of the variance; no edges are in sight."""
        lamp = {
            "type": "rectangle",
            "to_world": T().translate([0, 5, 0]).rotate([1, 0, 0], 90).scale(3),
            "emitter": {"type": "area"},
        }
        scene = djpt.load_dict(plane_scene({"type": "diffuse"}, lamp=lamp))
        one, four = (
            images(scene, {"type": "distributed", "split": 1, "light_samples": n}, 256, 32, depth=2).var(axis=0).mean()
            for n in (1, 4)
        )
        assert four < 0.4 * one


# ---------------------------------------------------------------- bounces


@pytest.mark.sparse(12)
@pytest.mark.parametrize("name", ["path", "prb", "path_nee", "path_naive", "prb_basic"])
@pytest.mark.parametrize("materials", ["diffuse", "shiny"])
def test_bounces_add_up(name: str, materials: str) -> None:
    lamp = {"type": "sphere", "center": [-1, 3, 1], "radius": 1.2, "emitter": {"type": "area", "radiance": 3.0}}
    description = floor_scene({"lamp": lamp}, size=16)
    scene = djpt.load_dict(shiny(description) if materials == "shiny" else description)
    whole = images(scene, {"type": name}, 16, 1, depth=5)[0]
    parts = images(scene, {"type": name, "bounces": True}, 16, 1, depth=5)[0]
    plugin = djpt.load_dict({"type": name, "bounces": True, "max_depth": 5})
    assert djpt.channel_names(scene, integrator=plugin)[3:5] == ("bounce0.R", "bounce0.G")
    series = parts[..., 3:].reshape(16, 16, 5, 3)
    np.testing.assert_allclose(series.sum(axis=2), whole, rtol=1e-6, atol=1e-6 * whole.mean())
    np.testing.assert_allclose(parts[..., :3], whole, rtol=1e-6, atol=1e-6 * whole.mean())
    # Each term is the image of the paths with so many edges.
    first = images(scene, {"type": name}, 16, 1, depth=1)[0]
    np.testing.assert_allclose(series[:, :, 0], first, rtol=1e-6, atol=1e-6)


def test_bounces_need_an_end() -> None:
    with pytest.raises(djpt.SceneError, match="max_depth"):
        djpt.load_dict({"type": "path", "bounces": True})


# ---------------------------------------------------------------- against Mitsuba


def test_prb_basic_equals_mitsuba() -> None:
    pytest.importorskip("mitsuba")
    from djpt.validation import agreement

    scene = box(48, integrator={"type": "prb_basic"})
    assert agreement(ours(scene, 16, 1), theirs(scene, 16, 1)).share > 0.999

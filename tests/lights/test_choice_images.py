"""Choices of emitters in scenes: images, gradients and edits."""

from __future__ import annotations

import sys
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.emitters.light_samplers import LIGHT_SAMPLERS
from djpt.samplers.seeds import gradient_seed
from djpt.scene.lights import Lights
from djpt.validation import agreement
from djpt.validation.statistics import Batches, block_test, mean_test
from tests.kit.emitters import NAMES, entry
from tests.kit.lit_floor import floor_scene
from tests.kit.processes import ROOT
from tests.kit.renders import ours, pixels, theirs


def everything(environment: str = "constant-colour") -> dict[str, Any]:
    """All emitters but for the other environments (a scene has one) and for beams that no surface point can aim at."""
    others = [name for name in NAMES if not name.startswith(("constant", "envmap", "sunsky", "directionalarea"))]
    return {
        f"light{k}": aside(entry(name), 1.6 * (k - len(others) / 2)) for k, name in enumerate([environment, *others])
    }


def aside(light: dict[str, Any], distance: float) -> dict[str, Any]:
    """A light that is a shape, moved: two in one place have no right image."""
    if "emitter" not in light:
        return light
    moved = {key: np.add(light[key], [distance, 0, 0]).tolist() for key in ("center", "p0", "p1") if key in light}
    if not moved:
        moved["to_world"] = djpt.ScalarTransform4f().translate([distance, 0, 0]) @ light.get(
            "to_world", djpt.ScalarTransform4f()
        )
    return {**light, **moved}


def lamps() -> dict[str, Any]:
    """A lamp, a globe, a point and the sky."""
    names = ("area-rectangle", "constant-colour", "point-position")
    globe = {**entry("area-sphere"), "center": [2.2, 1.5, 1], "radius": 0.2}
    return {**{name: entry(name) for name in names}, "globe": globe}


def choosing(name: str, integrator: str = "path") -> dict[str, Any]:
    depth = {} if integrator == "direct" else {"max_depth": 3}
    return {"type": integrator, "emitter_choice": name, **depth}


def test_each_emitter_can_be_chosen_where_it_shines() -> None:
    scene = djpt.load_dict(floor_scene(everything()))
    choice = scene.replace(emitter_choice="tree").lights.choice
    rng, size = np.random.default_rng(6), 4000
    lit = 0
    for i in range(len(scene.emitters())):
        p = djpt.Point3f(*(rng.uniform(-4, 4, (3, size)) * [[1], [0.7], [1]]).astype(np.float32))
        n = rng.normal(size=(3, size))
        normal = djpt.Vector3f(*(n / np.linalg.norm(n, axis=0)).astype(np.float32))
        sample = djpt.Point2f(*rng.random((2, size), dtype=np.float32))
        _, weight = scene.emitter_ptr(djpt.UInt32(i)).sample_direction(p, sample)
        shines = np.broadcast_to(np.array(dr.max(weight)) > 0, size)
        chance = np.broadcast_to(np.array(choice.probability(p, normal, djpt.UInt32(i))), size)
        assert chance[shines].min(initial=1) > 0, NAMES[i]
        lit += bool(shines.any())
    assert lit == len(scene.emitters())


@pytest.mark.sparse(3)
@pytest.mark.parametrize("integrator", ["path", "prb", "direct"])
@pytest.mark.slow
def test_means_do_not_depend_on_the_choice(integrator: str) -> None:
    lights = everything() if integrator == "path" else lamps()
    scene = djpt.load_dict(floor_scene(lights, size=24))
    batches = {}
    for name in LIGHT_SAMPLERS:
        batches[name] = Batches()
        plugin = djpt.load_dict(choosing(name, integrator))
        for seed in range(24):
            batches[name].add(pixels(djpt.render(scene, integrator=plugin, spp=32, seed=1000 * len(name) + seed)))
    for name in LIGHT_SAMPLERS[1:]:
        for test in (block_test, mean_test):
            result = test(batches[name], batches["uniform"], equal_variance=False)
            print(name, result)
            assert result.passed


def test_hits_and_samples_weigh_alike() -> None:
    """With one strategy alone `direct` has the same mean: the choice's probability is the same from both sides."""
    scene = djpt.load_dict(floor_scene(lamps(), size=16))
    batches = []
    for counts in ({"emitter_samples": 4, "bsdf_samples": 0}, {"emitter_samples": 2, "bsdf_samples": 2}):
        found = Batches()
        plugin = djpt.load_dict({"type": "direct", "emitter_choice": "tree", **counts})
        for seed in range(24):
            found.add(pixels(djpt.render(scene, integrator=plugin, spp=64, seed=seed + 100 * counts["bsdf_samples"])))
        batches.append(found)
    assert block_test(*batches, equal_variance=False).passed
    assert mean_test(*batches, equal_variance=False).passed


@pytest.mark.parametrize("schedule", ["flat", "wave"])
def test_the_tree_gives_one_image_under_every_schedule(schedule: str) -> None:
    scene = floor_scene(lamps(), integrator=choosing("tree"), size=16)
    share = agreement(ours(scene, 8, 3, schedule=schedule), ours(scene, 8, 3)).share
    assert share > 0.98


def test_sampling_weights_as_in_mitsuba() -> None:
    pytest.importorskip("mitsuba")
    lights = {
        "a": {**entry("point-position"), "sampling_weight": 0.2},
        "b": {"type": "point", "position": [1, 2, 1], "intensity": 5.0, "sampling_weight": 3.0},
        "c": {"type": "point", "position": [0, 3, -1], "intensity": 5.0, "sampling_weight": 0.0},
    }
    scene = floor_scene(lights)
    share = agreement(ours(scene, 8, 1), theirs(scene, 8, 1), 1e-3).share
    assert share >= 0.95


def test_gradients_by_radiance_equal_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the estimator as it is: densities don't move with the radiance, so the choice is kept."""
    scene = djpt.load_dict(floor_scene(lamps(), integrator=choosing("tree"), size=16))
    params = djpt.traverse(scene)
    kept = scene.replace(emitter_choice="tree").lights.choice
    monkeypatch.setattr(Lights, "choice", property(lambda self: kept))
    keys = ("area-rectangle.emitter.radiance.value", "globe.emitter.radiance.value", "constant-colour.radiance.value")
    seed = gradient_seed(0, 0)
    for key in keys:
        value = type(params[key])(params[key])
        dr.enable_grad(value)
        params[key] = value
        params.update()
        dr.backward(dr.mean(djpt.render(scene, params, spp=16), axis=None))
        found = np.sum(np.array(dr.grad(value)))
        means = []
        for step in (0.1, -0.1):
            params[key] = dr.detach(value) + step
            params.update()
            means.append(np.mean(pixels(djpt.render(scene, spp=16, seed=seed)), dtype=np.float64))
        params[key] = dr.detach(value)
        params.update()
        assert found == pytest.approx((means[0] - means[1]) / 0.2, rel=2e-3)
        assert found > 0


def test_edits_renew_the_choice_and_compile_nothing() -> None:
    scene = djpt.load_dict(floor_scene(lamps(), integrator=choosing("tree"), size=16), optimize=False)
    params = djpt.traverse(scene)
    djpt.render(scene, spp=2)

    def chance() -> float:
        """Of the globe, at a point of the floor."""
        choice, p, n = (
            scene.replace(emitter_choice="tree").lights.choice,
            djpt.Point3f(0.3, -1, 0.4),
            djpt.Vector3f(0, 1, 0),
        )
        return float(choice.probability(p, n, djpt.UInt32(3))[0])

    chances = [chance()]
    edits: list[dict[str, Any]] = [
        {"globe.emitter.radiance.value": [30.0, 20.0, 10.0]},
        {"globe.to_world": djpt.ScalarTransform4f().translate([0.5, 0.5, 0.5]).scale(0.1)},
        {"globe.emitter.radiance.value": [0.0, 0.0, 0.0]},
        {"area-rectangle.emitter.radiance.value": [0.0, 0.0, 0.0], "point-position.intensity.value": [0.0, 0.0, 0.0]},
    ]
    for edit in edits:
        params.update(edit)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            image = pixels(djpt.render(scene, spp=2))
            made = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and not k["cache_hit"]]
        assert not made, edit
        assert np.isfinite(image).all()
        chances.append(chance())
    assert len(set(chances[:4])) == 4
    assert chances[3:] == [0, 0]


@pytest.mark.parametrize("name", ["area lights", "point lights"])
@pytest.mark.sparse(2)
def test_benchmark_scenes_render(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT / "benchmarks")])
    import many_lights

    scene = djpt.load_dict(many_lights.SCENES[name](40, 16))
    for choice in LIGHT_SAMPLERS:
        image, _ = many_lights.rendered(scene, choice, 4, 0)
        assert np.isfinite(image).all()
        assert image.mean() > 0

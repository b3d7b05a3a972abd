"""Scenes of any scale and place give the same light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
import pytest
from numpy.typing import NDArray

import djpt
from djpt.core.records import RAY_EPSILON
from djpt.core.transforms import ScalarTransform4f as T
from djpt.scene.normalization.normalized_scene import normalized_scene
from tests.kit.placed_scenes import PLACED, Place, closed_room, huge_sphere, path

DIRECTION = np.array([0.6, -0.64, 0.48])


def places(scales: Sequence[float], distances: Sequence[float]) -> list[Place]:
    return [Place(scale) for scale in scales] + [Place(1.0, distance * DIRECTION) for distance in distances]


FEW = places((1e-9, 1e-3, 1e12), (1e5,))
MANY = places((1e-6, 0.03, 0.2, 1e3, 1e6, 1e9), (20, 1e2, 1e3, 1e4))


def image(description: dict[str, Any], **options: Any) -> NDArray[np.float32]:
    return np.array(djpt.render(djpt.load_dict(description), seed=1, **options))


def check_means(name: str, where: Sequence[Place]) -> None:
    """The means of images within 0.1 % of that of the scene at unit size, with equal seeds.

    Scenes a little smaller than that are rendered at their own scale, and rays leave surfaces by Mitsuba's offset,
    which doesn't shrink with them: chords of a ball of fog of radius 0.03 are wrong by up to 0.3 %.
    """
    reference = image(PLACED[name](Place()), spp=256).mean()
    for place in where:
        offset = RAY_EPSILON / place.scale if 0.01 < place.scale < 1 else 0.0
        mean = image(PLACED[name](place), spp=256).mean()
        np.testing.assert_allclose(mean, reference, rtol=1e-3 + offset, err_msg=str(place))


@pytest.mark.parametrize("name", ["cornell", "balls", "huge sphere"])
@pytest.mark.sparse(3)
def test_light_depends_on_no_scale(name: str) -> None:
    check_means(name, FEW)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLACED)
def test_light_depends_on_no_place(name: str) -> None:
    check_means(name, [*FEW, *MANY])


@pytest.mark.parametrize("walls", ["rectangles", "cube", "mesh"])
@pytest.mark.sparse(4)
def test_closed_rooms_let_no_light_in(walls: str) -> None:
    where = places((1.0, 1e-9, 1e12), (1e3, 1e5))
    leaking = [int((image(closed_room(place, walls)).max(axis=2) > 0).sum()) for place in where]
    assert leaking == [0] * len(where)


@pytest.mark.parametrize("place", [Place(), Place(1e-6), Place(1.0, np.array([0, 0, 1e4]))], ids=["1", "1e-6", "far"])
def test_a_huge_sphere_does_not_shadow_itself(place: Place) -> None:
    """Under a white sky every path that leaves a convex surface brings its albedo: closed form."""
    description = huge_sphere(place) | {"integrator": {"type": "path_naive", "max_depth": 6}}
    del description["ball"]
    seen = image(description)[..., 0]
    ground = seen[-len(seen) // 3 :]
    np.testing.assert_allclose(ground, 0.5, rtol=1e-5)


def test_usual_scenes_are_rendered_as_they_are() -> None:
    for build in (djpt.cornell_box, PLACED["balls"], PLACED["instances"]):
        assert normalized_scene(djpt.load_dict(build())) is None


@pytest.mark.sparse(8)
@pytest.mark.parametrize("name", PLACED)
def test_powers_of_two_change_no_bit(name: str) -> None:
    """The frame scales by powers of two, exactly, whatever has a length or an intensity."""
    small, smaller, large = (image(PLACED[name](Place(2.0**-k))) for k in (20, 30, -30))
    np.testing.assert_array_equal(small, smaller)
    np.testing.assert_array_equal(small, large)


PIXEL = {"film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}}


def sensors(place: Place) -> dict[str, Any]:
    """One of each kind that isn't in other scenes."""
    camera = place.camera((0, -6, 2), (0, 0, 0.5), 16)
    wide = [3 * place.scale, 3 * place.scale, 1]
    orthographic = camera | {"type": "orthographic", "to_world": camera["to_world"].scale(wide)}
    del orthographic["fov"]
    nested = {"film": {**camera["film"], "width": 32}, "a": camera, "b": dict(camera)}
    return {
        "orthographic": orthographic,
        "batch": {"type": "batch", **nested},
        "distant": {"type": "distant", "direction": [0.1, 0.2, -1], "target": place.point((0, -1.5, 0)), **PIXEL},
        "radiancemeter": {"type": "radiancemeter", "origin": place.point((0, -3, 2)), "direction": [0, 0.8, -0.6]},
    }


@pytest.mark.parametrize("name", sensors(Place()))
@pytest.mark.sparse(2)
def test_sensors_see_what_they_see_at_unit_size(name: str) -> None:
    at_unit, small = (
        image(PLACED["balls"](place) | {"sensor": sensors(place)[name]}) for place in (Place(), Place(2.0**-20))
    )
    assert at_unit.mean() > 0.01
    np.testing.assert_array_equal(small, at_unit)


def test_a_meter_on_a_shape_is_carried_with_it() -> None:
    images = []
    for place in (Place(), Place(2.0**-20)):
        scene = PLACED["balls"](place)
        del scene["sensor"]
        scene["floor"]["sensor"] = {"type": "irradiancemeter", **PIXEL}
        images.append(image(scene, spp=64))
    np.testing.assert_array_equal(*images)


def test_edits_reach_the_frame() -> None:
    """An edited scene gives the image of one that is loaded like this."""
    description = PLACED["lamps"](Place(1e-6))
    scene = djpt.load_dict(description)
    before = np.array(djpt.render(scene, seed=1))
    params = djpt.traverse(scene)
    params["floor.bsdf.reflectance.value"] = 0.1
    params["bulb.intensity.value"] = 3e-12
    params["ball.to_world"] = T().translate([0, 0, 2e-6]).scale(1e-6)
    params.update()
    description["floor"]["bsdf"]["reflectance"] = 0.1
    description["bulb"]["intensity"] = 3e-12
    description["ball"]["to_world"] = T().translate([0, 0, 2e-6]).scale(1e-6)
    after = np.array(djpt.render(scene, seed=1))
    assert np.abs(after - before).mean() > 0.01 * before.mean()
    np.testing.assert_allclose(after, image(description), rtol=1e-6)


@pytest.mark.parametrize(
    ("key", "unit"), [("floor.bsdf.reflectance.value", 0), ("bulb.intensity.value", 2), ("spot.cutoff_angle", 0)]
)
@pytest.mark.sparse(3)
def test_gradients_pass_through_the_frame(key: str, unit: int) -> None:
    """Those of a scene at 2^-20; an intensity is there 2^-40 times as large, and its gradient 2^40 times."""
    gradients = []
    for scale in (1.0, 2.0**-20):
        scene = djpt.load_dict(PLACED["lamps"](Place(scale)))
        params = djpt.traverse(scene)
        dr.enable_grad(params[key])
        params.update()
        for _ in range(2):  # the second time with the same normalized scene
            dr.clear_grad(params[key])
            dr.backward(dr.mean(djpt.render(scene, params, seed=1), axis=None))
        gradients.append(float(dr.ravel(dr.grad(params[key]))[0]) * scale**unit)
    assert gradients[0] != 0
    assert gradients[1] == pytest.approx(gradients[0], rel=2e-3)


def smoky(scale: float, **more: Any) -> dict[str, Any]:
    """A scene with a ball of smoke, at a scale."""
    description = PLACED["balls"](Place(scale)) | {"integrator": {"type": "prbvolpath"}}
    grid: dict[str, Any] = {"type": "gridvolume", "data": np.linspace(0.2, 1, 8, dtype=np.float32).reshape(2, 2, 2)}
    grid["to_world"] = T().scale(scale).translate([-1, -1, 0]).scale(2)
    medium = {"type": "heterogeneous", "sigma_t": grid, "scale": 2 / scale, **more}
    description["smoke"] = {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}
    description["smoke"]["to_world"] = T().scale(scale).translate([0, 0, 1])
    return description


@pytest.mark.parametrize(("key", "unit"), [("scale", -1), ("sigma_t.data", 0)])
@pytest.mark.sparse(2)
def test_gradients_by_smoke_pass_through_the_frame(key: str, unit: int) -> None:
    gradients = []
    for scale in (1.0, 2.0**-20):
        scene = djpt.load_dict(smoky(scale))
        params = djpt.traverse(scene)
        name = f"smoke.interior_medium.{key}"
        dr.enable_grad(params[name])
        params.update()
        assert (normalized_scene(scene) is None) == (scale == 1)
        dr.backward(dr.mean(djpt.render(scene, params, spp=64, seed=1), axis=None))
        gradients.append(np.array(dr.grad(params[name])).sum() * scale**unit)
    assert gradients[0] != 0
    assert gradients[1] == pytest.approx(gradients[0], rel=0.05)


def test_records_stay_in_the_users_units() -> None:
    scene = djpt.load_dict(PLACED["balls"](Place(1e-6)))
    djpt.render(scene, spp=1)
    hit = scene.ray_intersect(djpt.Ray3f([0, 0, 3e-6], [0, 0, -1]))
    assert float(hit.t[0]) == pytest.approx(3e-6, rel=1e-5)
    depth = np.array(djpt.render(scene, integrator=djpt.load_dict({"type": "depth"}), spp=1))
    assert depth.max() < 1e-4


@pytest.mark.parametrize("unfiltered", [False, True])
@pytest.mark.sparse(2)
def test_aovs_stay_in_the_users_units(unfiltered: bool) -> None:
    """Beside light that is that of unit size; channels of lengths and places are converted."""
    names = ("depth", "distance", "position", "dp_du", "sh_normal", "uv", "shape_index", "albedo")
    aovs = ",".join(f"{name}:{name}" for name in names)
    integrator = {"type": "aov", "aovs": aovs, "unfiltered": unfiltered, "light": path(4)}
    images = {}
    for place in (Place(), Place(2.0**-20), Place(1.0, 1e4 * DIRECTION)):
        scene = djpt.load_dict(PLACED["balls"](place, integrator=integrator))
        images[place.scale, place.offset[0] > 0] = np.array(djpt.render(scene, seed=1))
    assert normalized_scene(scene) is not None
    channels = [name.partition(".")[0] for name in djpt.channel_names(scene)]
    units = np.array([2.0**-20 if name in ("depth", "distance", "position", "dp_du") else 1 for name in channels])
    at_unit, small, far = images.values()
    np.testing.assert_array_equal(small, at_unit * units.astype(np.float32))
    same = np.array([name != "position" for name in channels])
    close = np.isclose(far[..., same], at_unit[..., same], rtol=1e-3, atol=1e-3)
    assert close.mean() > 0.99
    # In the foreground no pixel is partly empty.
    positions = [pixels[-4:, :, ~same] for pixels in (far, at_unit)]
    np.testing.assert_allclose(positions[0], positions[1] + 1e4 * DIRECTION, rtol=1e-6)


def test_a_scripts_plugin_keeps_a_scene_in_its_place() -> None:
    """What a plugin of a script does with coordinates isn't known."""

    class Lamp(djpt.BSDF):
        pass

    djpt.register_bsdf("test_scale_lamp", lambda props: Lamp(props))
    own: dict[str, Any] = {"type": "sphere", "bsdf": {"type": "test_scale_lamp"}}
    own["to_world"] = T().scale(1e-6)
    assert normalized_scene(djpt.load_dict(PLACED["balls"](Place(1e-6)) | {"ball": own})) is None


@pytest.mark.parametrize("name", ["glow", "lengths"])
@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.sparse(4)
def test_what_is_per_length_is_converted(name: str, scale: float) -> None:
    """Emission and absorption, and the heights of bump maps."""
    scenes = [PLACED[name](place) for place in (Place(), Place(scale))]
    at_unit, scaled = (image(scene, spp=64).mean(axis=(0, 1)) for scene in scenes)
    assert [normalized_scene(djpt.load_dict(scene)) is not None for scene in scenes] == [False, True]
    assert at_unit.min() > 0.01
    np.testing.assert_allclose(scaled, at_unit, rtol=2e-3)


@pytest.mark.parametrize(
    ("name", "key", "unit"),
    [
        ("lengths", "floor.bsdf.scale", 1),
        ("lengths", "ball.bsdf.absorption.value", -1),
        ("glow", "ball.interior_medium.emission.value.value", -1),
    ],
)
@pytest.mark.sparse(3)
def test_edits_and_gradients_of_lengths(name: str, key: str, unit: int) -> None:
    """Edits reach what has been converted, and so do gradients, also a second time."""
    images, gradients = [], []
    for scale in (1.0, 2.0**-20):
        description = PLACED[name](Place(scale))
        if name == "glow":
            description["integrator"]["type"] = "prbvolpath"
        scene = djpt.load_dict(description)
        djpt.render(scene, spp=1)
        params = djpt.traverse(scene)
        params[key] = 2 * params[key]
        params.update()
        images.append(np.array(djpt.render(scene, seed=1)))
        dr.enable_grad(params[key])
        params.update()
        for _ in range(2):
            dr.clear_grad(params[key])
            dr.backward(dr.mean(djpt.render(scene, params, seed=1), axis=None))
        gradients.append(float(dr.ravel(dr.grad(params[key]))[0]) * scale**unit)
    assert gradients[0] != 0
    assert gradients[1] == pytest.approx(gradients[0], rel=5e-3)
    np.testing.assert_allclose(images[1].mean(), images[0].mean(), rtol=2e-3)

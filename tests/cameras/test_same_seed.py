"""Images and measurements of every sensor: Mitsuba's pixels at equal seeds, closed forms, gradients, batches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError
from djpt.validation import agreement
from tests.kit.derivatives import by_both
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import ours, pixels, theirs

BOX = {"type": "box"}
PIXEL = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": BOX}
LOOK = T().look_at(origin=[1, 2.5, 5.5], target=[0, 0, 0], up=[0, 1, 0])
SKY = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.4, 0.5, 0.6]}}}
PLATE = {"type": "rectangle", "to_world": T().translate([0, -0.99, 0]).rotate([1, 0, 0], -90)}
THIN = {"type": "thinlens", "aperture_radius": 0.2, "focus_distance": 5.0, "fov": 35, "to_world": LOOK}
WIDE = {"type": "perspective", "fov": 35, "to_world": LOOK}
FLAT = {"type": "orthographic", "to_world": LOOK @ T().scale([2.5, 2.5, 1])}
DOWN = {"type": "distant", "direction": [0.1, -1, 0.3], "film": PIXEL}
IRRADIANCE = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": BOX}}


def film(width: int, height: int, **entries: Any) -> dict[str, Any]:
    return {"type": "hdrfilm", "width": width, "height": height, "rfilter": BOX, **entries}


def scene_with(sensor: dict[str, Any]) -> dict[str, Any]:
    """The floor and its spheres under the sky, seen by a sensor or a shape that carries one."""
    scene = floor_scene(SKY)
    return {**scene, "sensor": sensor}


SCENES: dict[str, dict[str, Any]] = {
    "thinlens": floor_scene(None, THIN),
    "thinlens crop": scene_with(
        {**THIN, "film": film(60, 40, crop_width=30, crop_height=35, crop_offset_x=20, crop_offset_y=5)}
    ),
    "orthographic": floor_scene(None, FLAT),
    "orthographic wide": scene_with({**FLAT, "film": film(48, 32)}),
    "radiancemeter": scene_with({"type": "radiancemeter", "to_world": LOOK, "film": PIXEL}),
    "distant": scene_with(DOWN),
    "distant point": scene_with({**DOWN, "target": [2, -1, 2]}),
    "distant shape": scene_with({**DOWN, "target": PLATE}),
    "irradiancemeter": scene_with({**PLATE, "meter": IRRADIANCE}),
    "irradiancemeter sphere": scene_with({"type": "sphere", "center": [0, 1, 0], "radius": 0.3, "meter": IRRADIANCE}),
    "batch": floor_scene(None, {"type": "batch", "film": film(96, 32), "a": WIDE, "b": THIN, "c": FLAT}),
}


@pytest.mark.sparse(6)
@pytest.mark.parametrize("name", SCENES)
def test_equal_pixels(name: str) -> None:
    pytest.importorskip("mitsuba")
    mine, reference = ours(SCENES[name], 8, 1), theirs(SCENES[name], 8, 1)
    assert reference.mean() > 0.01
    assert agreement(mine, reference, 1e-3).share >= 0.999


# ---------------------------------------------------------------- closed forms


def measured(sensor: dict[str, Any], spp: int = 64, **entries: Any) -> np.ndarray:
    """What a meter in a scene of `entries` shows, one colour."""
    return ours({"type": "scene", "integrator": {"type": "path"}, "sensor": sensor, **entries}, spp).ravel()


@pytest.mark.parametrize("shape", ["rectangle", "disk", "sphere", "cube", "cylinder"])
def test_irradiance_under_a_constant_sky_is_pi_times_its_radiance(shape: str) -> None:
    meter = {"type": shape, "meter": {"type": "irradiancemeter", "film": PIXEL}}
    np.testing.assert_allclose(measured(meter, **SKY), math.pi * np.array([0.4, 0.5, 0.6]), rtol=1e-5)


def test_irradiance_opposite_a_disk() -> None:
    """On the axis of a Lambertian disk of radius r at distance h: E = pi L r^2 / (r^2 + h^2)."""
    lamp = {"type": "disk", "to_world": T().translate([0, 0, 2]).rotate([1, 0, 0], 180), "light": {"type": "area"}}
    meter = {"type": "disk", "to_world": T().scale(1e-3), "meter": {"type": "irradiancemeter", "film": PIXEL}}
    np.testing.assert_allclose(measured(meter, 1 << 16, lamp=lamp), math.pi / 5, rtol=0.02)


def test_a_radiance_meter_reads_the_radiance_of_a_light() -> None:
    lamp = {"type": "sphere", "center": [0, 0, 9], "light": {"type": "area", "radiance": 2.5}}
    meter = {"type": "radiancemeter", "origin": [0, 0.5, 0], "direction": [0, 0, 3]}
    np.testing.assert_allclose(measured(meter, lamp=lamp), 2.5, rtol=1e-6)


@pytest.mark.parametrize("target", [{}, {"target": [0.1, 0.2, 0]}, {"target": {"type": "disk"}}])
def test_a_satellite_over_a_lambertian_plain(target: dict[str, Any]) -> None:
    """Its radiance is the albedo times the sky's; without a target, the sky beside the plain counts as well."""
    plain = {"type": "disk", "to_world": T().scale(2), "bsdf": {"type": "diffuse", "reflectance": 0.3}}
    meter = {"type": "distant", "direction": [0, 0, -1], **target}
    # The bounding box of the disk is a square: its cross-section has twice the disk's area.
    expected = 0.3 if target else 0.5 * 0.3 + 0.5 * 1.0
    sky = {"type": "constant", "radiance": 1.0}
    np.testing.assert_allclose(measured(meter, 1 << 14, plain=plain, sky=sky), expected, rtol=0.01)


# ---------------------------------------------------------------- the thin lens


def edge(sensor: dict[str, Any], depth: float) -> np.ndarray:
    """An edge at a depth, one row of pixels."""
    half = {"type": "rectangle", "to_world": T().translate([5.05, 0, depth]).rotate([0, 1, 0], 180).scale(5)}
    scene = {"type": "scene", "integrator": {"type": "path"}, "half": {**half, "light": {"type": "area"}}}
    return ours({**scene, "sensor": {**sensor, "fov": 30, "film": film(64, 1)}}, 256)[0, :, 0]


def test_the_plane_of_focus_is_sharp_and_others_are_blurred() -> None:
    lens = {"type": "thinlens", "aperture_radius": 0.3, "focus_distance": 4.0}
    sharp = edge({"type": "perspective"}, 4.0)
    assert ((sharp > 0.01) & (sharp < 0.99)).sum() <= 1
    # The pixel that the edge crosses is cut at the same place up to noise.
    np.testing.assert_allclose(edge(lens, 4.0), sharp, atol=0.1)
    # The blur's width in pixels: 2 aperture abs(1 / z - 1 / focus) / (2 tan(fov / 2) / 64).
    width = 2 * 0.3 * abs(1 / 8 - 1 / 4) / (2 * math.tan(math.radians(15)) / 64)
    blurred = edge(lens, 8.0)
    assert ((blurred > 0.002) & (blurred < 0.998)).sum() == pytest.approx(width, abs=2.5)


def test_a_small_aperture_is_a_pinhole() -> None:
    pinhole, lens = floor_scene(SKY, WIDE), floor_scene(SKY, {**THIN, "aperture_radius": 1e-5})
    a, b = (ours(scene, 256).astype(np.float64) for scene in (pinhole, lens))
    np.testing.assert_allclose(a.mean(), b.mean(), rtol=2e-3)
    assert np.sqrt(np.mean((a - b) ** 2)) < 0.02
    distances = [
        np.abs(ours(floor_scene(SKY, {**THIN, "aperture_radius": r}), 256) - a).mean() for r in (0.4, 0.1, 1e-5)
    ]
    assert distances[0] > distances[1] > distances[2]


def test_a_point_out_of_focus_becomes_a_round_disk() -> None:
    spark = {"type": "sphere", "center": [0, 0, 8], "radius": 0.01, "light": {"type": "area", "radiance": 1e4}}
    lens = {"type": "thinlens", "aperture_radius": 0.3, "focus_distance": 4.0, "fov": 10, "film": film(32, 32)}
    image = measured(lens, 1 << 12, spark=spark).reshape(32, 32, 3)[..., 0].astype(np.float64)
    y, x = np.mgrid[:32, :32] - 15.5
    weights = image / image.sum()
    # A uniform disk of radius R has the second moments R^2 / 4 along all axes.
    radius = 0.3 * (1 / 4 - 1 / 8) / (2 * math.tan(math.radians(5)) / 32)
    for moment in ((x**2 * weights).sum(), (y**2 * weights).sum()):
        assert moment == pytest.approx(radius**2 / 4, rel=0.05)
    assert (x * y * weights).sum() == pytest.approx(0, abs=0.02 * radius**2)
    assert weights[np.hypot(x, y) > radius + 1.5].sum() == 0


# ---------------------------------------------------------------- gradients


@pytest.mark.sparse(6)
@pytest.mark.parametrize("name", SCENES)
def test_gradients_are_differences(name: str) -> None:
    """The image is a polynomial in the albedo: at equal seeds differences of images tell its derivative."""
    scene = djpt.load_dict(SCENES[name])
    found, expected = by_both(scene, "floor.bsdf.reflectance.value", 0.01, spp=16, integrator=plain_path())
    assert abs(expected) > 0.1
    assert found == pytest.approx(expected, rel=0.01)


def plain_path() -> Any:
    """Without roulette, whose draws would depend on the albedo."""
    return djpt.load_dict({"type": "path", "max_depth": 3, "rr_depth": 100})


# ---------------------------------------------------------------- batches and several sensors


def test_a_batch_shows_what_its_sensors_show() -> None:
    batch = ours(SCENES["batch"], 256)
    for i, sensor in enumerate((WIDE, THIN, FLAT)):
        single = ours(floor_scene(None, {**sensor, "film": film(32, 32)}), 256)
        part = batch[:, 32 * i : 32 * (i + 1)]
        assert part.mean() == pytest.approx(single.mean(), rel=0.02)
        assert np.sqrt(np.mean((part - single) ** 2)) < 0.15 * single.mean() + 0.02


def kernels(scene: Any, **options: Any) -> set[str]:
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.eval(djpt.render(scene, spp=1, **options))
    return {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}


EDITS: dict[str, dict[str, Any]] = {
    "thinlens": {"sensor.aperture_radius": 0.4, "sensor.to_world": T().translate([0, 1, -6])},
    "orthographic": {"sensor.to_world": T().translate([0, 1, -6]).scale([3, 3, 1])},
    "radiancemeter": {"sensor.to_world": T().translate([0, 1, -6])},
    "distant shape": {"sensor.to_world": T().rotate([1, 0, 0], 80)},
    "irradiancemeter sphere": {"sensor.to_world": T().translate([1, 2, 1]).scale(0.2)},
    "batch": {"sensor.a.to_world": T().translate([0, 1, -6]), "sensor.b.focus_distance": 3.0},
}


@pytest.mark.parametrize("name", EDITS)
def test_edits_compile_nothing(name: str) -> None:
    scene = djpt.load_dict(SCENES[name])
    before, image = kernels(scene), pixels(djpt.render(scene, spp=16))
    djpt.traverse(scene).update(EDITS[name])
    assert kernels(scene) == before
    assert np.abs(pixels(djpt.render(scene, spp=16)) - image).max() > 1e-4


def test_sensors_are_chosen_by_number_or_handed_over() -> None:
    meter = {**DOWN, "target": [2, -1, 2]}
    scene = djpt.load_dict({**floor_scene(SKY), "second": {**WIDE, "film": film(8, 6)}, "third": meter})
    assert pixels(djpt.render(scene, sensor=1, spp=2)).shape == (6, 8, 3)
    third = pixels(djpt.render(scene, sensor=2, spp=4))
    for other in (scene.sensors()[2], djpt.load_dict(meter)):  # the last isn't in the scene
        np.testing.assert_array_equal(pixels(djpt.render(scene, sensor=other, spp=4)), third)
    with pytest.raises(RenderError, match="there is no sensor 3: the scene has 3, numbered from 0"):
        djpt.render(scene, sensor=3)


@pytest.mark.parametrize("schedule", ["flat", "wave"])
@pytest.mark.parametrize("name", ["radiancemeter", "distant point"])
def test_schedules_agree(name: str, schedule: str) -> None:
    np.testing.assert_allclose(ours(SCENES[name], 16, schedule=schedule), ours(SCENES[name], 16), rtol=1e-5)


def parts(names: Sequence[str]) -> dict[str, Any]:
    """Meters on meshes in one batch: each has tables of its own."""
    return {
        name: {"type": "distant", "target": djpt.Mesh(name, mesh_at(i), [[0, 1, 2]]), "direction": [0, 0, -1]}
        for i, name in enumerate(names)
    }


def mesh_at(x: float) -> np.ndarray:
    return np.array([[x, 0, 0], [x + 0.1, 0, 0], [x, 0.1, 0]], np.float32)


def test_a_batch_tells_its_meshes_apart() -> None:
    """Three disks of different albedo, each measured by a distant sensor over a triangle on it."""
    disks = {
        f"disk{i}": {
            "type": "disk",
            "to_world": T().translate([i, 0, -0.01]).scale(0.4),
            "bsdf": {"type": "diffuse", "reflectance": 0.2 * (i + 1)},
        }
        for i in range(3)
    }
    batch = {"type": "batch", "film": film(3, 1), **parts("abc")}
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": 2}, "sensor": batch, **disks}
    image = ours({**scene, "sky": {"type": "constant", "radiance": 1.0}}, 1024)
    np.testing.assert_allclose(image[0, :, 0], [0.2, 0.4, 0.6], rtol=0.05)

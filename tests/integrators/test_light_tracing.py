"""Light paths towards the camera."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError
from djpt.jit.types import Float, Point2f
from tests.kit.emitters import NAMES, entry, first_of_each, plugin_of
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import box
from tests.kit.threads import assert_same_for_any_threads

CROP = {"width": 80, "height": 60, "crop_offset_x": 10, "crop_offset_y": 5, "crop_width": 40, "crop_height": 30}

SENSORS: list[dict[str, Any]] = [
    {"type": "perspective", "fov": 50, "principal_point_offset_x": 0.1},
    {"type": "thinlens", "fov": 50, "aperture_radius": 0.3, "focus_distance": 3.0},
    {"type": "orthographic"},
]


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: s["type"])
class TestSensorImportance:
    def test_way_to_the_sensor_is_its_ray_backwards(self, sensor: dict[str, Any]) -> None:
        camera, position, lens, t = points(sensor)
        ray = camera.ray_through(position, lens)
        ds, importance = camera.sample_wi(ray(t), lens)
        np.testing.assert_allclose(np.array(ds.uv), np.array(position), atol=2e-5)
        assert np.array(dr.norm(ds.d + ray.d)).max() < 1e-5
        np.testing.assert_allclose(np.array(ds.p), np.array(ray.o), atol=1e-5)
        np.testing.assert_allclose(np.array(ds.dist), np.array(t), atol=1e-4)
        assert np.array(importance).min() > 0

    def test_importance_is_the_area_on_the_film(self, sensor: dict[str, Any]) -> None:
        """Of a small square across the direction, by finite differences."""
        camera, position, lens, t = points(sensor)
        p = camera.ray_through(position, lens)(t + 0.5)
        ds, importance = camera.sample_wi(p, lens)
        across, step = Frame3f.from_normal(ds.d), 1e-2
        a, b = (camera.sample_wi(p + step * v, lens)[0].uv - ds.uv for v in (across.s, across.t))
        area = np.array(dr.abs(a.x * b.y - a.y * b.x)) / step**2
        assert np.median(area / np.array(importance)) == pytest.approx(1, rel=1e-2)

    def test_points_behind_and_beside_are_not_seen(self, sensor: dict[str, Any]) -> None:
        camera, position, lens, _ = points(sensor)
        outside = Point2f(position.x + 1.01, position.y)
        for ray, t in ((camera.ray_through(position, lens), -1.0), (camera.ray_through(outside, lens), 2.0)):
            assert np.array(camera.sample_wi(ray(Float(t)), lens)[1]).max() == 0


def points(sensor: dict[str, Any]) -> tuple[Any, Point2f, Point2f, Float]:
    """A camera, film positions, points on its lens, and distances."""
    place = T().look_at([1, 2, 3], [0, 0.5, 0], [0.1, 1, 0])
    if sensor["type"] == "orthographic":
        place = place @ T().scale([2, 2, 1])
    camera = djpt.load_dict({**sensor, "film": {"type": "hdrfilm", **CROP}, "to_world": place})
    u = np.random.default_rng(0).random((5, 4096), dtype=np.float32)
    return camera, Point2f(u[0], u[1]), Point2f(u[2], u[3]), Float(5 * u[4] + 0.1)


def images(scene: dict[str, Any], integrator: dict[str, Any], spp: int, seeds: int = 8) -> np.ndarray:
    loaded, plugin = djpt.load_dict(scene), djpt.load_dict(integrator)
    return np.stack([np.array(djpt.render(loaded, integrator=plugin, spp=spp, seed=3 + s)) for s in range(seeds)])


def assert_equal_means(a: np.ndarray, b: np.ndarray) -> None:
    """Of the images, and of their upper and lower halves."""
    half = a.shape[1] // 2
    for rows in (slice(None), slice(half), slice(half, None)):
        x, y = a[:, rows].mean(axis=(1, 2, 3)), b[:, rows].mean(axis=(1, 2, 3))
        error = np.sqrt(x.var(ddof=1) / len(x) + y.var(ddof=1) / len(y))
        assert abs(x.mean() - y.mean()) < 5 * error + 1e-7


@pytest.mark.sparse(18)
@pytest.mark.parametrize("name", first_of_each(name for name in NAMES if plugin_of(name) != "directionalarea"))
def test_same_mean_as_path(name: str) -> None:
    scene = floor_scene({"light": entry(name)}, size=16)
    light = {"type": "ptracer", "max_depth": 4}
    assert_equal_means(images(scene, light, 256), images(scene, {"type": "path", "max_depth": 4}, 128))


@pytest.mark.sparse(12)
@pytest.mark.parametrize("rfilter", ["box", "gaussian", "mitchell"])
@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: s["type"])
def test_sensors_and_filters(rfilter: str, sensor: dict[str, Any]) -> None:
    film = {
        "type": "hdrfilm",
        "width": 24,
        "height": 18,
        "crop_offset_x": 3,
        "crop_width": 16,
        "rfilter": {"type": rfilter},
        "sample_border": rfilter == "mitchell",
    }
    scene = floor_scene(sensor={**sensor, "film": film})
    if sensor["type"] == "orthographic":
        scene["sensor"]["to_world"] = scene["sensor"]["to_world"] @ T().scale([2.5, 2.5, 1])
    scene["lamp"]["bsdf"] = {"type": "diffuse", "reflectance": 0.0}
    a, b = images(scene, {"type": "ptracer", "max_depth": 3}, 256), images(scene, {"type": "path", "max_depth": 3}, 128)
    assert a.shape == b.shape == (8, 18, 16, 3)
    assert_equal_means(a, b)
    # At the border, filters reach beyond the film.
    for edge in (np.s_[:, :2], np.s_[:, -2:], np.s_[:, :, :2], np.s_[:, :, -2:]):
        assert_equal_means(a[edge], b[edge])


@pytest.mark.slow
def test_materials_and_normals() -> None:
    """Light that is refracted, and shading normals that differ from the geometry's."""
    scene = floor_scene(size=16)
    scene["ball"]["bsdf"] = {"type": "roughdielectric", "alpha": 0.3}
    scene["small"]["bsdf"] = {
        "type": "bumpmap",
        "heights": {"type": "bitmap", "data": np.random.default_rng(1).random((8, 16)).astype(np.float32), "raw": True},
        "scale": 0.05,
        "inner": {"type": "roughplastic", "alpha": 0.3},
    }
    light, path = ({"type": name, "max_depth": 6} for name in ("ptracer", "path"))
    assert_equal_means(images(scene, light, 512), images(scene, path, 512))


def test_image_is_the_same_for_any_number_of_threads() -> None:
    scene, light = djpt.load_dict(box(32)), djpt.load_dict({"type": "ptracer", "max_depth": 6})

    def render(seed: int = 4) -> np.ndarray:
        return np.array(djpt.render(scene, integrator=light, spp=32, seed=seed))

    first = assert_same_for_any_threads(render)
    assert (first != render(seed=5)).any()


def test_depths() -> None:
    """0: nothing; 1: the lights alone; hidden lights are hidden."""
    scene = djpt.load_dict(box(16))

    def render(**parameters: Any) -> np.ndarray:
        plugin = djpt.load_dict({"type": "ptracer", **parameters})
        return np.array(djpt.render(scene, integrator=plugin, spp=16))

    assert render(max_depth=0).max() == 0
    straight = np.array(djpt.render(scene, integrator=djpt.load_dict({"type": "path", "max_depth": 1}), spp=16))
    np.testing.assert_allclose(render(max_depth=1), straight, rtol=1e-5)
    assert render(max_depth=4, hide_emitters=True).max() < straight.max()


def test_image_is_linear_in_the_light() -> None:
    """With the same seed: no decision depends on the unit of radiance, roulette included."""
    radiance, images_ = np.array([3.0, 2.0, 1.0]), []
    for scale in (1.0, 2.0**-12, 2.0**12):
        scene = box(16)
        scene["light"]["emitter"]["radiance"]["value"] = (radiance * scale).tolist()
        images_.append(images(scene, {"type": "ptracer", "rr_depth": 2}, 16, 1) / scale)
    np.testing.assert_allclose(images_[1], images_[0], rtol=1e-5)
    np.testing.assert_allclose(images_[2], images_[0], rtol=1e-5)


def test_collimated_light_is_shown() -> None:
    """A beam of radiosity B onto a white floor that faces it: B / pi."""
    beam = {
        "type": "rectangle",
        "to_world": T().translate([0, 3, 0]).rotate([1, 0, 0], 90),
        "emitter": {"type": "directionalarea", "radiance": 2.0},
    }
    scene = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 10,
            "to_world": T().look_at([0, 2.5, 0], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
        },
        "beam": beam,
        "floor": {
            "type": "rectangle",
            "to_world": T().rotate([1, 0, 0], -90).scale(4),
            "bsdf": {"type": "diffuse", "reflectance": 1.0},
        },
    }
    image = images(scene, {"type": "ptracer", "max_depth": 2}, 4096, 2)
    assert image.mean() == pytest.approx(2 / np.pi, rel=0.02)


@pytest.mark.parametrize("hide_emitters", [False, True])
@pytest.mark.sparse(2)
def test_a_lamp_hides_what_is_behind_it(hide_emitters: bool) -> None:
    """The only lamp, before a ceiling that it doesn't light; hidden lamps hide nothing and reflect nothing."""
    scene = box(16)
    lamp = T().translate([0, 0.5, 0]).rotate([1, 0, 0], 90).scale(0.5)
    scene["light"].update(to_world=lamp, emitter={"type": "area", "radiance": 1.0})
    scene["sensor"]["to_world"] = T().look_at([0, -0.9, 3], [0, 0.6, 0], [0, 1, 0])
    light, path = ({"type": name, "max_depth": 5, "hide_emitters": hide_emitters} for name in ("ptracer", "path"))
    assert_equal_means(images(scene, light, 1024), images(scene, path, 1024))


def test_walls_hide_what_is_inside() -> None:
    """A closed room, seen from outside."""
    scene = djpt.scenes.furnace()
    for node in scene.values():
        if isinstance(node, dict):
            node.pop("emitter", None)
    scene["lamp"] = {"type": "point", "position": [0, 0.8, 0], "intensity": 2.0}
    scene["sensor"]["film"].update(width=16, height=16)
    light = {"type": "ptracer", "max_depth": 3}
    assert images(scene, light, 16, 1).mean() > 0.1
    scene["sensor"]["to_world"] = T().look_at([0, 0, 3.9], [0, 0, 0], [0, 1, 0])
    assert images(scene, light, 16, 1).max() == 0


@pytest.mark.slow
def test_a_lamp_in_coloured_glass() -> None:
    """Light fades from where it starts; the glass bends nothing, so the lamp's flux is seen on the floor."""
    lamp = {"type": "sphere", "center": [-0.9, 0, 0.1], "radius": 0.2, "emitter": {"type": "area", "radiance": 60.0}}
    scene = floor_scene({"lamp": lamp}, size=16)
    absorption = {"type": "rgb", "value": [0.2, 0.5, 1.5]}
    scene["ball"]["bsdf"] = {"type": "glass", "int_ior": 1.0, "ext_ior": 1.0, "absorption": absorption}
    del scene["small"]
    light, path = ({"type": name, "max_depth": 3} for name in ("ptracer", "path"))
    below = slice(10, 16)  # the floor before the ball
    a, b = images(scene, light, 1024)[:, below], images(scene, path, 8192)[:, below]
    assert_equal_means(a, b)
    assert a[..., 0].mean() > 1.5 * a[..., 2].mean()


def test_what_is_refused() -> None:
    light = djpt.load_dict({"type": "ptracer"})
    meters = (
        {"type": "radiancemeter", "origin": [0, 2, 4], "direction": [0, -1, -1]},
        {"type": "distant", "direction": [0, -1, -1]},
        {"type": "batch", "one": {"type": "perspective"}},
    )
    for sensor in meters:
        scene = floor_scene()
        scene["sensor"] = sensor
        with pytest.raises(RenderError, match=r"can't trace light to the sensor.*perspective"):
            djpt.render(djpt.load_dict(scene), integrator=light, spp=1)


def test_light_paths_are_points_of_one_sequence() -> None:
    """With `sobol` they cover a lamp evenly all together, whatever the size of the film."""
    noise = {}
    for sampler in ("independent", "sobol"):
        scene = djpt.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "ptracer", "max_depth": 2},
                "sensor": {
                    "type": "perspective",
                    "fov": 30,
                    "to_world": T().look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]),
                    "film": {"type": "hdrfilm", "width": 23, "height": 17, "rfilter": {"type": "gaussian"}},
                    "sampler": {"type": sampler},
                },
                "floor": {"type": "rectangle"},
                "lamp": {
                    "type": "rectangle",
                    "to_world": T().translate([0, 0, 2]).rotate([1, 0, 0], 180).scale(0.9),
                    "emitter": {"type": "directionalarea", "radiance": 1.0},
                },
            }
        )
        images = [djpt.render(scene, spp=64, seed=seed).numpy() for seed in range(4)]
        assert np.mean(images) == pytest.approx(0.5 / np.pi, rel=0.03)
        noise[sampler] = np.var(images, axis=0).mean()
    assert noise["sobol"] < 0.2 * noise["independent"]

"""Cameras with lenses that aren't ideal: fisheyes, panoramas, distortion."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import DjptError, SceneError
from djpt.jit.types import Float, Point2f, Point3f
from tests.cameras.test_sensors import FILMS, LOOK
from tests.cameras.wide_cameras import VIEW, WIDE, slopes_and_shifted
from tests.kit.chi_squared import uniform
from tests.kit.kernels import Watched

COUNT = 4096


def sensor_of(name: str, film: str = "wide", **entries: Any) -> Any:
    return djpt.load_dict({**WIDE[name], "film": {"type": "hdrfilm", **FILMS[film]}, **entries})


def points(sensor: Any, at: Point2f) -> Any:
    ray = sensor.ray_through(at, Point2f(0.5))
    return ray(Float(uniform(COUNT, 1, seed=1)[0] * 5 + 0.5))


@pytest.mark.parametrize("film", FILMS)
@pytest.mark.parametrize("name", WIDE)
def test_points_are_shown_where_rays_lead_to_them(name: str, film: str) -> None:
    sensor, at = sensor_of(name, film), Point2f(*uniform(COUNT))
    ds, importance = sensor.sample_wi(points(sensor, at), Point2f(0.5))
    np.testing.assert_allclose(np.array(ds.uv), np.array(at), atol=1e-5)
    assert np.mean(np.array(importance) > 0) > 0.999


@pytest.mark.parametrize("name", WIDE)
@pytest.mark.sparse(12)
def test_rays_follow_all_numbers(name: str) -> None:
    """Derivatives of rays and of places on the film, forwards, against central differences."""
    at, sensor = Point2f(*uniform(256)), sensor_of(name)
    seen = dr.detach(points(sensor, Point2f(*uniform(COUNT))))

    def answers(view: Any) -> tuple[Any, Any]:
        return view.ray_through(at, Point2f(0.5))(Float(2.5)), view.sample_direction(seen, Point2f(0.5))[0].uv

    params = djpt.traverse(sensor)
    for key in (name for name in sensor.motions if name != "attached_matrix" and name not in unused(sensor)):
        value, h = float(params[key][0]), 1e-2 if "azimuth" in key or "elevation" in key or "fov" in key else 1e-3
        bound = 89.0 if "elevation" in key else 179.0
        value = max(-bound, min(value, bound)) if "azimuth" in key or "elevation" in key else value
        slopes, shifted = slopes_and_shifted(sensor, key, value, h, answers)
        for slope, high, low in zip(slopes, *shifted, strict=True):
            expected = (high - low) / (2 * h)
            scale = np.abs(expected).max()
            assert scale > 0, key
            close = np.abs(slope - expected) < 2e-3 * scale + 2e-4 / h * np.abs(high).max() * 1e-3
            assert close.mean() > 0.99, (key, np.abs(slope - expected).max() / scale)


def unused(sensor: Any) -> tuple[str, ...]:
    """Those without effect on rays: the image circle only says where they end."""
    polynomial = getattr(sensor, "projection", "polynomial") == "polynomial"
    return ("image_circle", *(() if polynomial else ("k1", "k2", "k3", "k4")))


@pytest.mark.parametrize("name", ["distorted", "distorted in pixels", "rational"])
def test_distortion_is_that_of_opencv(name: str) -> None:
    cv2 = pytest.importorskip("cv2")
    sensor, at = sensor_of(name, to_world=T()), Point2f(*uniform(COUNT))
    p = points(sensor, at)
    ds, _ = sensor.sample_wi(p, Point2f(0.5))
    width, height = sensor.film().size()
    fx = width / (2 * np.tan(np.radians(sensor.x_fov[0]) / 2))
    cx, cy = (0.5 - sensor.principal_point_offset_x[0]) * width, (0.5 - sensor.principal_point_offset_y[0]) * height
    matrix = np.array([[fx, 0, cx], [0, fx / sensor.pixel_aspect[0], cy], [0, 0, 1]])
    coefficients = np.array([getattr(sensor, k)[0] for k in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")])
    # There x is to the right and y down.
    turned = np.array(p, np.float64).T * [-1, -1, 1]
    expected = cv2.projectPoints(turned, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]
    np.testing.assert_allclose(np.array(ds.uv).T * [width, height], expected, atol=1e-4)


def test_the_polynomial_fisheye_is_that_of_opencv() -> None:
    cv2 = pytest.importorskip("cv2")
    sensor, at = sensor_of("fisheye in pixels", to_world=T()), Point2f(*uniform(COUNT))
    p = points(sensor, at)
    ahead = np.array(p.z) > 0.05
    ds, _ = sensor.sample_wi(p, Point2f(0.5))
    width, height = sensor.film().size()
    entries = WIDE["fisheye in pixels"]
    matrix = np.array([[entries["fx"], 0, entries["cx"]], [0, entries["fy"], entries["cy"]], [0, 0, 1]], np.float64)
    coefficients = np.array([entries.get(k, 0.0) for k in ("k1", "k2", "k3", "k4")])
    turned = (np.array(p, np.float64).T * [-1, -1, 1])[ahead, None]
    expected = cv2.fisheye.projectPoints(turned, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]
    np.testing.assert_allclose((np.array(ds.uv).T * [width, height])[ahead], expected, atol=1e-4)


def test_a_panorama_shows_the_environment_map() -> None:
    """Pixel by pixel, but for the interpolation between texels."""
    texels = np.random.default_rng(2).random((16, 32, 3), np.float32)
    film = {"type": "hdrfilm", "width": 32, "height": 16, "rfilter": {"type": "box"}}
    scene = djpt.load_dict(
        {
            "type": "scene",
            "sky": {"type": "envmap", "bitmap": djpt.Bitmap(texels), "to_world": LOOK},
            "sensor": {"type": "panorama", "film": film, "to_world": LOOK},
            "integrator": {"type": "path"},
        }
    )
    image = np.array(djpt.render(scene, spp=1024))
    np.testing.assert_allclose(image.mean(axis=(0, 1)), texels.mean(axis=(0, 1)), rtol=0.02)
    assert np.corrcoef(image.ravel(), texels.ravel())[0, 1] > 0.85


def test_an_equisolid_fisheye_under_a_white_sky_measures_solid_angles() -> None:
    """Pixels have equal solid angles: a disk of angle theta covers pi (2 sin(theta / 2))^2 focal lengths squared."""
    film = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    disk = {
        "type": "disk",
        "to_world": T().translate([0, 0, 1]).rotate([1, 0, 0], 180),
        "emitter": {"type": "area", "radiance": 1.0},
    }
    camera = {"type": "fisheye", "projection": "equisolid", "fov": 160, "film": film}
    scene = djpt.load_dict({"type": "scene", "disk": disk, "sensor": camera, "integrator": {"type": "path"}})
    share = float(np.array(djpt.render(scene, spp=256)).mean())
    rim = np.radians(45)
    expected = np.pi * (2 * np.sin(rim / 2)) ** 2 / (2 * 2 * np.sin(np.radians(40))) ** 2
    assert share == pytest.approx(expected, rel=2e-3)


def described(camera: dict[str, Any], integrator: dict[str, Any]) -> dict[str, Any]:
    scene = djpt.cornell_box() | {"integrator": integrator}
    film = {"type": "hdrfilm", "width": 16, "height": 12, "rfilter": {"type": "box"}}
    scene["sensor"] = {**camera, "to_world": T().look_at([0, 0, 0.6], [0.3, -0.2, -1], [0, 1, 0]), "film": film}
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("name", [*WIDE, "blades", "all of it"])
def test_light_arrives_where_the_camera_looks(name: str) -> None:
    """The pictures of `ptracer` and `path`: the means of blocks of 4 x 4 pixels."""
    camera = WIDE.get(name) or {**VIEW[name], "fov": 80, "focus_distance": 1.2, "aperture_radius": 0.15}

    def blocks(kind: str, spp: int) -> np.ndarray:
        scene = djpt.load_dict(described(camera, {"type": kind, "max_depth": 3}))
        images = np.array([djpt.render(scene, spp=spp, seed=seed) for seed in range(8)])
        return images.reshape(8, 3, 4, 4, 4, 3).mean(axis=(2, 4))

    path, ptracer = blocks("path", 256), blocks("ptracer", 2048)
    difference = path.mean(axis=0) - ptracer.mean(axis=0)
    error = np.sqrt((path.var(axis=0, ddof=1) + ptracer.var(axis=0, ddof=1)) / 8)
    z = difference / (error + 1e-3 * path.mean(axis=0) + 1e-6)
    assert np.abs(z).max() < 6


@pytest.mark.parametrize("name", ["equidistant", "panorama", "distorted"])
def test_edits_compile_nothing(name: str) -> None:
    watched = Watched(described(WIDE[name], {"type": "path", "max_depth": 2}), spp=1)
    key, value = {"equidistant": ("x_focal", 0.4), "panorama": ("azimuth_to", 110.0), "distorted": ("k1", -0.1)}[name]
    watched.params[f"sensor.{key}"] = value
    watched.params["sensor.to_world"] = LOOK
    watched.params.update()
    assert watched.new() == 0


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"type": "fisheye", "projection": "equisoli"}, "did you mean 'equisolid'"),
        ({"type": "fisheye", "fov": 400}, r"'fov' must lie in \(0, 360\)"),
        ({"type": "fisheye", "k1": 0.1, "projection": "equisolid"}, "'projection' can't be given together with 'k1'"),
        ({"type": "fisheye", "k1": -0.5, "fov": 120}, "'fov' can't be 120: with these coefficients, the picture turns"),
        ({"type": "fisheye", "fx": 100, "fov": 90}, "'fov' can't be given together with a focal length in pixels"),
        ({"type": "panorama", "azimuth_to": 190}, "'azimuth_to' must be at most 360 more"),
        ({"type": "panorama", "elevation_to": 91}, r"'elevation_to' must lie in \[-90, 90\]"),
        ({"type": "panorama", "eye": "lef"}, "did you mean 'left'"),
        ({"type": "perspective", "fov": 90, "fx": 100}, "'fx' can't be given together with 'fov'"),
        ({"type": "perspective", "k7": 0.1}, "unknown key 'k7'"),
    ],
)
def test_errors(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(entries)


def test_coefficients_and_a_field_of_view() -> None:
    """The edge of the film is where the polynomial takes half of the field."""
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    focal = djpt.load_dict({"type": "fisheye", "k1": 0.1, "fov": 90, "film": film}).x_focal[0]
    half = np.pi / 4
    assert focal == pytest.approx(0.5 / (half * (1 + 0.1 * half**2)), rel=1e-6)


def test_the_eyes_of_a_stereo_panorama() -> None:
    """Each looks across the line between the eyes, and shows nothing that is between them."""
    eyes = [djpt.load_dict({"type": "panorama", "eye": eye, "eye_distance": 0.2}) for eye in ("left", "right")]
    rays = [eye.ray_through(Point2f(*uniform(64)), Point2f(0.5)) for eye in eyes]
    between = np.array(rays[0].o - rays[1].o)
    np.testing.assert_allclose(np.linalg.norm(between, axis=0), 0.2, rtol=1e-5)
    np.testing.assert_allclose((between * np.array(rays[0].d)).sum(axis=0), 0, atol=1e-6)
    # Straight ahead the left eye is on the left, where +x is.
    assert eyes[0].ray_through(Point2f(0.5), Point2f(0.5)).o.x[0] == pytest.approx(0.1)
    p = Point3f([0.05, 0.15], [0, 0], [0.05, 0])
    for eye in eyes:
        np.testing.assert_array_equal(np.array(eye.sample_wi(p, Point2f(0.5))[1]) > 0, [False, True])


@pytest.mark.parametrize("eye", ["left", "right"])
def test_the_importance_of_an_eye_integrates_to_one(eye: str) -> None:
    """Over a cylinder about the circle from which it looks."""
    sensor = djpt.load_dict(
        {"type": "panorama", "eye": eye, "eye_distance": 0.6, "elevation_from": -40, "elevation_to": 60}
    )
    radius, low, high, count = 1.0, -1.0, 2.0, 2**18
    u, v = uniform(count)
    p = Point3f(radius * np.cos(2 * np.pi * u), low + (high - low) * v, radius * np.sin(2 * np.pi * u))
    ds, importance = sensor.sample_wi(p, Point2f(0.5))
    cos = dr.abs(dr.dot(ds.d, Point3f(p.x, 0, p.z))) / radius
    total = np.array(importance * cos, np.float64) * 2 * np.pi * radius * (high - low)
    assert total.mean() == pytest.approx(1, abs=5 * total.std() / np.sqrt(count))


@pytest.mark.parametrize("name", ["left eye", "right eye"])
def test_the_density_of_an_eye_is_its_importance(name: str) -> None:
    sensor = sensor_of(name)
    ray = sensor.ray_through(Point2f(*uniform(COUNT)), Point2f(0.5))
    t = Float(uniform(COUNT, 1, seed=1)[0] * 5 + 0.1)
    _, importance = sensor.sample_wi(ray(t), Point2f(0.5))
    pdf, distance = sensor.pdf_ray(ray)
    shown = np.array(importance) > 0
    assert shown.mean() > 0.99
    expected = np.array(pdf / dr.square(t + distance))
    np.testing.assert_allclose(np.array(importance)[shown], expected[shown], rtol=1e-3)


def test_wrong_edits_are_refused() -> None:
    params = djpt.traverse(sensor_of("equidistant"))
    for key, value in (("x_focal", 0.0), ("k1", 0.1), ("near_clip", -1.0)):
        with pytest.raises(DjptError):
            params[key] = value

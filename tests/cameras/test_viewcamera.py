"""Lenses with aperture blades, tilt and shift."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Float, Point2f, Point3f
from tests.cameras.test_sensors import LOOK
from tests.cameras.test_wide import described
from tests.cameras.wide_cameras import LENS, VIEW, slopes_and_shifted
from tests.kit.chi_squared import uniform
from tests.kit.kernels import Watched

COUNT = 2**16


def aperture(count: int = COUNT, **entries: Any) -> np.ndarray:
    """Points drawn on an aperture of radius 1: their coordinates up and to the left."""
    sensor = djpt.load_dict({**LENS, **entries})
    point = sensor.aperture_point(Point2f(*uniform(count)))
    return np.array([point.y, point.x], np.float64)


@pytest.mark.parametrize("roundness", [None, 0.0, 0.35, 1.0])
@pytest.mark.parametrize("blades", [3, 6])
def test_points_fill_the_aperture_evenly(blades: int, roundness: float | None) -> None:
    """As many lie within the inscribed circle, half of it and a sector as these are large."""
    entries = {} if roundness is None else {"aperture_roundness": roundness}
    up, left = aperture(aperture_blades=blades, **entries)
    k, angle = roundness or 0.0, 2 * math.pi / blades
    whole = (1 - k) * blades / 2 * math.sin(angle) + k * math.pi
    height = math.cos(angle / 2)
    distance, phi = np.hypot(up, left), np.arctan2(left, up)
    assert djpt.load_dict({**LENS, "aperture_blades": blades, **entries}).aperture[0] == pytest.approx(whole, rel=1e-5)
    # The middle of the first blade is at half of its angle from the corner on top.
    across = np.abs(np.mod(phi, angle) - angle / 2)
    edge = np.sqrt((1 - k) * (height / np.cos(across)) ** 2 + k)
    assert (distance <= edge * (1 + 1e-5)).all() and (distance / edge).max() > 0.999
    sector = (across < angle / 8).mean()
    share = (1 - k) * height**2 * math.tan(angle / 8) + k * angle / 8
    for found, area in (
        ((distance < height).mean(), math.pi * height**2),
        ((distance < height / 2).mean(), math.pi * height**2 / 4),
        (sector, blades * share),
    ):
        assert found == pytest.approx(area / whole, abs=4 * 0.5 / math.sqrt(COUNT))


def test_a_turned_aperture() -> None:
    """Counterclockwise, seen from behind: from the top to the left."""
    up, left = aperture(aperture_blades=3, aperture_rotation=30)
    furthest = np.hypot(up, left).argmax()
    assert math.degrees(math.atan2(left[furthest], up[furthest])) % 120 == pytest.approx(30, abs=1)


@pytest.mark.parametrize("behind", [True, False])
@pytest.mark.sparse(2)
def test_a_blurred_light_is_the_polygon(behind: bool) -> None:
    """A small disk out of focus: the picture's area, and where it is bright and dark, but for the blur at its edge."""
    depth, focus, radius, small, size = (4.0, 2.0, 0.3, 0.03, 32) if behind else (2.0, 4.0, 0.3, 0.015, 32)
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    disk = {"type": "disk", "to_world": T().translate([0, 0, depth]).rotate([1, 0, 0], 180).scale(small)}
    camera = {"type": "thinlens", "fov": 12, "aperture_radius": radius, "focus_distance": focus, "film": film}
    camera |= {"aperture_blades": 5, "aperture_rotation": 10}
    scene = {"type": "scene", "disk": {**disk, "emitter": {"type": "area", "radiance": 1.0}}, "camera": camera}
    scene["integrator"] = {"type": "path", "max_depth": 1}
    image = np.array(djpt.render(djpt.load_dict(scene), spp=2**13), np.float64)[..., 0]
    reach = radius * abs(1 / depth - 1 / focus) / math.tan(math.radians(6))  # in halves of the film
    # Corners in the picture, x to the right and y up: turned to the left. Before the plane of focus, upside down.
    angles = np.radians(10 + 72 * np.arange(6))
    corners = np.array([-np.sin(angles), np.cos(angles)]).T * reach * (1 if behind else -1)
    place = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(place, -place)
    sides = [((b - a)[0] * (y - a[1]) - (b - a)[1] * (x - a[0])) / np.hypot(*(b - a)) for a, b in pairwise(corners)]
    inside, margin = np.min(sides, axis=0), 0.1 * reach + 1.5 / size
    level = image[inside > margin].mean()
    # The disk's share of all that can be seen through a point of the film.
    assert level == pytest.approx(
        math.pi * (small / (radius * abs(depth / focus - 1))) ** 2 / (2.5 * math.sin(math.radians(72))), rel=0.02
    )
    assert image.sum() / level * 4 / size**2 == pytest.approx(2.5 * math.sin(math.radians(72)) * reach**2, rel=0.02)
    assert (image[inside < -margin] == 0).all() and image[inside > margin].min() > 0.5 * level
    assert (inside < -margin).sum() > 100 < (inside > margin).sum()


def on_plane(sensor: Any, distance: float, tilt: float, swing: float, away: float = 0.0) -> Point3f:
    """Points of the plane of focus, before a camera at the origin that looks along +z; or of one further away."""
    x, y = (2 * u - 1 for u in uniform(256, seed=3))
    z = distance * (1 + away) + math.tan(math.radians(tilt)) * y - math.tan(math.radians(swing)) * x
    return Point3f(x, y, z)


def test_a_tilted_plane_is_sharp_all_over() -> None:
    """All points of the lens show its points at the same place; other planes' at different ones."""
    entries = {**VIEW["all of it"], "to_world": T(), "fov": 100}
    sensor = djpt.load_dict(entries)

    def blur(away: float) -> float:
        p = on_plane(sensor, 3.5, entries["tilt"], entries["swing"], away)
        places = [np.array(sensor.sample_wi(p, Point2f(*at))[0].uv) for at in np.array(uniform(8, seed=4)).T.tolist()]
        return float(np.ptp(np.array(places), axis=0).max())

    assert blur(0.0) < 2e-6 < 1e-3 < blur(0.05)


def test_a_picture_of_a_tilted_plane_is_that_of_a_pinhole() -> None:
    """With the lens tilted accordingly; without tilt it is blurred."""
    texels = np.random.default_rng(1).random((32, 32, 3), np.float32)
    light = {"type": "area", "radiance": {"type": "bitmap", "data": texels, "raw": True, "filter_type": "bilinear"}}
    board = {"type": "rectangle", "to_world": T().translate([0, 0, 4]).rotate([1, 0, 0], 230).scale(4)}
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}

    def picture(**camera: Any) -> np.ndarray:
        scene = {"type": "scene", "board": {**board, "emitter": light}, "integrator": {"type": "direct"}}
        sensor = djpt.load_dict({"fov": 40, "film": film, **camera})
        return np.array(djpt.render(djpt.load_dict(scene), sensor=sensor, spp=256))

    lens = {"type": "thinlens", "aperture_radius": 0.4, "focus_distance": 4.0}
    sharp = picture(type="perspective")
    assert sharp.min() > 0
    assert np.abs(picture(**lens, tilt=50) - sharp).mean() < 0.005 < 0.02 < np.abs(picture(**lens) - sharp).mean()


def test_a_shift_is_that_of_a_pinhole() -> None:
    shift = {"principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1}
    lens, pinhole = (
        djpt.load_dict({**LENS, **shift}),
        djpt.load_dict({"type": "perspective", "fov": 50, **shift, "to_world": LOOK}),
    )
    at = Point2f(*uniform(64))
    ray, expected = lens.ray_through(at, Point2f(0.5)), pinhole.ray_through(at, Point2f(0.5))
    np.testing.assert_allclose(np.array(ray.d), np.array(expected.d), atol=1e-6)


def test_neutral_entries_change_nothing() -> None:
    """A lens without tilt and shift, and with so many blades that it is round, has the rays of a thin lens."""
    at, lens = Point2f(*uniform(256)), Point2f(*uniform(256, seed=2))
    plain, neutral = djpt.load_dict(LENS), djpt.load_dict({**LENS, "tilt": 0.0})
    ray, expected = neutral.ray_through(at, lens), plain.ray_through(at, lens)
    np.testing.assert_allclose(np.array(ray.d), np.array(expected.d), atol=1e-6)
    np.testing.assert_allclose(np.array(ray.o), np.array(expected.o), atol=1e-6)
    assert type(plain) is djpt.sensors.ThinLens


@pytest.mark.parametrize("name", VIEW)
@pytest.mark.sparse(5)
def test_rays_follow_all_numbers(name: str) -> None:
    """Derivatives of rays and of places on the film, forwards, against central differences."""
    at, lens = Point2f(*uniform(256)), Point2f(*uniform(256, seed=2))
    sensor = djpt.load_dict(VIEW[name])
    ray = sensor.ray_through(Point2f(*uniform(256, seed=3)), lens)
    seen = dr.detach(ray(Float(uniform(256, 1, seed=1)[0] * 5 + 0.5)))

    def answers(view: Any) -> list[Any]:
        ray = view.ray_through(at, lens)
        return [ray.o, ray.d, view.sample_wi(seen, lens)[0].uv, view.through_lens(lens).sample_wi(seen, lens)[0].uv]

    params = djpt.traverse(sensor)
    for motion in sensor.motions[1:]:
        key = motion.lstrip("_")
        value, h = float(params[key][0]), 5e-2 if key in ("x_fov", "tilt", "swing", "aperture_rotation") else 1e-3
        start = value + (h if "roundness" in key and value == 0 else 0)
        slopes, shifted = slopes_and_shifted(sensor, key, value, h, answers, start)
        scale = max(np.abs(high - low).max() for high, low in zip(*shifted, strict=True)) / (2 * h)
        assert scale > 0, key
        for slope, high, low in zip(slopes, *shifted, strict=True):
            close = np.abs(slope - (high - low) / (2 * h)) < 3e-3 * scale + 2e-7 / h * np.abs(high).max()
            assert close.mean() > 0.99, (key, np.abs(slope - (high - low) / (2 * h)).max(), scale)


def test_edits_compile_nothing() -> None:
    watched = Watched(described(VIEW["all of it"], {"type": "path", "max_depth": 2}), spp=1)
    edits = {"aperture_blades": 5, "aperture_rotation": 30.0, "aperture_roundness": 0.1, "tilt": 5.0, "swing": 1.0}
    for key, value in edits.items():
        watched.params[f"sensor.{key}"] = value
    watched.params["sensor.principal_point_offset_x"] = 0.3
    watched.params.update()
    assert watched.new() == 0


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"aperture_blades": 2}, "'aperture_blades' must be 0 .a circle. or a whole number of at least 3, found 2"),
        ({"aperture_rotation": 10}, "'aperture_rotation' needs 'aperture_blades'"),
        ({"aperture_blades": 0, "aperture_roundness": 0.5}, "'aperture_roundness' needs 'aperture_blades'"),
        ({"aperture_blades": 5, "aperture_roundness": 1.5}, r"'aperture_roundness' must lie in \[0, 1\], found 1.5"),
        ({"tilt": 90}, r"'tilt' must lie in \(-90, 90\), found 90"),
        ({"tilt": 85, "focus_distance": 0.5}, "'tilt' must not turn the plane of focus until it cuts the lens"),
        ({"aperture_blade": 5}, "did you mean 'aperture_blades'"),
    ],
)
def test_errors(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict({**LENS, **entries})


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("aperture_blades", 2, "must be 0 .a circle. or a whole number of at least 3, found 2"),
        ("aperture_blades", 4.5, "a whole number of at least 3, found 4.5"),
        ("aperture_blades", 0, "load a lens without blades for a circle"),
        ("aperture_roundness", -0.1, r"must lie in \[0, 1\]"),
        ("tilt", -90.0, r"must lie in \(-90, 90\)"),
        ("aperture_radius", 50.0, "tilt: must not turn the plane of focus until it cuts the lens"),
    ],
)
def test_wrong_edits_are_refused(key: str, value: Any, message: str) -> None:
    params = djpt.traverse(djpt.load_dict(VIEW["all of it"]))
    with pytest.raises(ParameterError, match=message):
        params.update({key: value})

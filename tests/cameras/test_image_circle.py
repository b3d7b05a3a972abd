"""Lenses whose image is a circle on the film: what lies outside is black, whatever renders it."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.description import registry
from djpt.errors import SceneError
from djpt.jit.types import Color3f, Float, Point2f
from tests.kit.chi_squared import uniform
from tests.kit.kernels import Watched

SIZE = (16, 12)
CIRCLES: dict[str, dict[str, Any]] = {
    "orthographic": {"type": "fisheye", "projection": "orthographic", "fov_axis": "x"},
    "equidistant": {"type": "fisheye", "fov": 300, "image_circle": 200},
    "equisolid": {"type": "fisheye", "projection": "equisolid", "fov": 240, "image_circle": 220},
    "stereographic": {"type": "fisheye", "projection": "stereographic", "fov": 280, "image_circle": 200},
    "polynomial": {"type": "fisheye", "fx": 6, "k1": -0.1, "principal_point_offset_x": 0.1},
    "barrel": {"type": "perspective", "fov": 100, "k1": -0.3},
    "decentred barrel": {"type": "perspective", "fov": 100, "k1": -0.3, "k2": 0.02, "p1": 0.02, "p2": -0.01},
    "thinner medium": {"type": "perspective", "fov": 150, "ior": 0.8},
}
NESTED = {
    "aov": {"aovs": "distance:depth,place:position", "colour": {"type": "path", "max_depth": 3}},
    "moment": {"colour": {"type": "path", "max_depth": 3}},
    "sppm": {"max_depth": 3, "initial_radius": 0.2},
}
SHORT = {"bdpt", "mmlt", "path", "path_naive", "path_nee", "prb", "ptracer", "vcm", "volpath"}


def sensor(name: str, **film: Any) -> dict[str, Any]:
    width, height = SIZE
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}, **film}
    return {**CIRCLES[name], "film": film}


def described(name: str, integrator: dict[str, Any], mesh: bool = False, **film: Any) -> dict[str, Any]:
    """A ball, a lamp and a floor under a sky; or with a mesh, for schedules that search trees step by step."""
    scene = {
        "type": "scene",
        "sky": {"type": "constant", "radiance": 0.5},
        "ball": {"type": "sphere", "center": [0.3, 0, 2], "radius": 0.6},
        "floor": {"type": "rectangle", "to_world": T().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4)},
        "lamp": {"type": "sphere", "center": [0, 1.2, 1], "radius": 0.2, "emitter": {"type": "area", "radiance": 3.0}},
        "sensor": sensor(name, pixel_format="rgba", **film),
        "integrator": integrator,
    }
    if mesh:
        corners = np.random.default_rng(1).random((40, 3)) + np.array([-1, -0.5, 1])
        scene["soup"] = djpt.Mesh("soup", corners.astype(np.float32), np.arange(39).reshape(-1, 3).astype(np.uint32))
    return scene


def pixels(name: str) -> tuple[np.ndarray, np.ndarray]:
    """The pixels that lie wholly outside of the circle, and those inside."""
    camera, fine = djpt.load_dict(sensor(name)), 8
    width, height = SIZE
    u, v = ((np.arange(n * fine) + 0.5) / (n * fine) for n in SIZE)
    at = Point2f(*(x.ravel().astype(np.float32) for x in np.meshgrid(u, v)))
    shown = (np.array(camera.ray_through(at, Point2f(0.5)).maxt) > 0).reshape(height, fine, width, fine)
    return ~shown.any(axis=(1, 3)), shown.all(axis=(1, 3))


def integrators() -> list[str]:
    found = registry.registered("integrator").items()
    return [name for name, factory in found if registry.is_own(factory) and name != "volprim_rf_basic"]


QUICK = ("aov", "bdpt", "depth", "direct", "path", "prb_projective")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in integrators()]
)
def test_all_integrators_leave_the_outside_black(name: str) -> None:
    """All of their channels, alpha included; and see the sky inside."""
    depth = {"max_depth": 3} if name in SHORT else {}
    scene = djpt.load_dict(described("equidistant", {"type": name, **depth, **NESTED.get(name, {})}))
    image = np.array(djpt.render(scene, spp=4))
    outside, inside = pixels("equidistant")
    assert outside.sum() > 50 < inside.sum()
    assert (image[outside] == 0).all() and np.isfinite(image).all()
    assert image[inside][:, :3].mean() > 0.1 < image[inside][:, 3].mean()


@pytest.mark.parametrize("name", CIRCLES)
def test_the_circle_is_where_directions_end(name: str) -> None:
    camera, (outside, inside) = djpt.load_dict(sensor(name)), pixels(name)
    assert camera.has_image_circle and outside.sum() > 4 < inside.sum()
    scene = described(name, {"type": "raycast"}, sample_border=True)
    image = np.array(djpt.render(djpt.load_dict(scene), spp=16))
    # Without a hit the sky is seen, or nothing.
    assert (image[outside] == 0).all() and (image[inside][:, :3] > 0).all() and image[..., 3].max() == 1


@pytest.mark.parametrize("name", CIRCLES)
@pytest.mark.sparse(2)
def test_points_are_shown_where_rays_lead_to_them(name: str) -> None:
    """And nowhere else: what is shown at all has a ray that leads there."""
    camera, at = djpt.load_dict(sensor(name)), Point2f(*uniform(4096))
    ray = camera.ray_through(at, Point2f(0.5))
    shown = np.array(ray.maxt) > 0
    ds, importance = camera.sample_wi(ray(Float(uniform(4096, 1, seed=1)[0] * 5 + 0.5)), Point2f(0.5))
    np.testing.assert_allclose(np.array(ds.uv)[:, shown], np.array(at)[:, shown], atol=1e-5)
    assert ((np.array(importance) > 0)[shown]).mean() > 0.998
    np.testing.assert_array_equal(np.array(camera.sample_ray(0, 0, at, Point2f(0.5))[1])[0] > 0, shown)
    everywhere = np.random.default_rng(3).normal(size=(3, 4096)).astype(np.float32)
    ds, importance = camera.sample_wi(djpt.Point3f(everywhere), Point2f(0.5))
    seen = np.array(importance) > 0
    back = camera.ray_through(ds.uv, Point2f(0.5))
    towards = everywhere / np.linalg.norm(everywhere, axis=0)
    near = np.abs(np.array(back.d) - towards).max(axis=0) < 2e-3
    assert seen.any() and (near | (np.array(back.maxt) == 0))[seen].all() and near[seen].mean() > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("name", ["orthographic", "polynomial", "decentred barrel"])
@pytest.mark.parametrize("kind", ["ptracer", "bdpt"])
def test_light_arrives_where_the_camera_looks(name: str, kind: str) -> None:
    """The means of blocks of 4 x 4 pixels, in a room."""

    def blocks(kind: str, spp: int) -> np.ndarray:
        room = djpt.cornell_box() | {"integrator": {"type": kind, "max_depth": 3}}
        room["sensor"] = {**sensor(name), "to_world": T().look_at([0, 0, 0.6], [0.3, -0.2, -1], [0, 1, 0])}
        scene = djpt.load_dict(room)
        images = np.array([djpt.render(scene, spp=spp, seed=seed) for seed in range(8)])
        return images.reshape(8, 3, 4, 4, 4, 3).mean(axis=(2, 4))

    path, other = blocks("path", 256), blocks(kind, 1024)
    difference = path.mean(axis=0) - other.mean(axis=0)
    error = np.sqrt((path.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / 8)
    assert np.abs(difference / (error + 1e-3 * path.mean(axis=0) + 1e-6)).max() < 6


@pytest.mark.parametrize("kind", ["path", pytest.param("volpath", marks=pytest.mark.slow)])
def test_schedules_agree(kind: str) -> None:
    scene = djpt.load_dict(described("equidistant", {"type": kind, "max_depth": 3}, mesh=True))
    flat, *others = (np.array(djpt.render(scene, spp=4, schedule=name)) for name in ("flat", "wave", "machine"))
    for other in others:
        assert (np.abs(other - flat) < 1e-4).mean() > 0.99 and (other[pixels("equidistant")[0]] == 0).all()


@pytest.mark.parametrize(("kind", "mesh"), [("path", False), pytest.param("prb", True, marks=pytest.mark.slow)])
def test_derivatives_are_those_of_differences(kind: str, mesh: bool) -> None:
    """By the radiance of the sky, which would shine outside of the circle, and by a reflectance; in both modes."""
    weights = np.random.default_rng(2).random((SIZE[1], SIZE[0], 4)).astype(np.float32)
    weights[..., 3] = 0
    scene = djpt.load_dict(described("equidistant", {"type": kind, "max_depth": 3}, mesh))
    params = djpt.traverse(scene)
    for key in ("sky.radiance.value", "floor.bsdf.reflectance.value"):

        def loss(value: Any, key: str = key) -> Any:
            params[key] = value
            params.update()
            image = djpt.render(scene, params, spp=16, seed=3, seed_grad=3)
            return dr.sum(image * djpt.TensorXf(weights), axis=None)

        kind = Color3f if "floor" in key else Float
        high, low = (float(loss(kind(value)).array[0]) for value in (0.55, 0.45))
        expected = (high - low) / 0.1
        backward = kind(0.5)
        dr.enable_grad(backward)
        dr.backward(loss(backward))
        assert float(dr.sum(backward.grad, axis=None)[0]) == pytest.approx(expected, rel=1e-2)
        forward = kind(0.5)
        dr.enable_grad(forward)
        result = loss(forward)
        dr.forward(forward)
        assert float(result.grad.array[0]) == pytest.approx(expected, rel=1e-2)
        params[key] = kind(0.5)


def test_a_batch_of_lenses() -> None:
    """Only the part of the lens with a circle has dark corners."""
    film = {"type": "hdrfilm", "width": 32, "height": 12, "rfilter": {"type": "box"}, "pixel_format": "rgba"}
    scene = described("orthographic", {"type": "path", "max_depth": 2})
    views = {"circle": CIRCLES["orthographic"], "whole": {"type": "perspective", "fov": 60}}
    scene["sensor"] = {"type": "batch", "film": film, **views}
    image = np.array(djpt.render(djpt.load_dict(scene), spp=4))
    outside, _ = pixels("orthographic")
    assert (image[:, :16][outside] == 0).all() and (image[:, 16:, 3] == 1).all()


def test_edits_compile_nothing() -> None:
    """As long as corners of the film stay dark."""
    watched = Watched(described("equidistant", {"type": "path", "max_depth": 2}), spp=1)
    watched.params["sensor.image_circle"] = 120.0
    watched.params["sensor.x_focal"] = 0.2
    watched.params.update()
    assert watched.new() == 0


def test_a_film_without_dark_corners_has_no_circle() -> None:
    for entries in ({"fov_axis": "diagonal", "projection": "orthographic"}, {}, {"image_circle": 240.0}):
        assert not djpt.load_dict({"type": "fisheye", **entries}).has_image_circle


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"type": "fisheye", "fx": 20, "cx": 1000}, "the film shows nothing: it is at least .* focal lengths from"),
        ({"type": "fisheye", "image_circle": 0}, r"'image_circle' must lie in \(0, 360\], found 0"),
    ],
)
def test_errors(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(entries)

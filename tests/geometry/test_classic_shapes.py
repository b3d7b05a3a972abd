"""Shapes that Mitsuba lacks, against closed forms; and what holds for every shape."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Float, Point2f, Point3f, TensorXf, Vector3f
from tests.kit.axes import unit
from tests.kit.chi_squared import uniform

POSE = T().translate([0.2, 0.1, -0.3]).rotate(unit(1, 2, 3), 50)
LUMP = (np.linalg.norm(np.indices((9, 9, 9)) - 4.2, axis=0)[..., None] - 3).astype(np.float32)
SHAPES: dict[str, dict[str, Any]] = {
    "rectangle": {"type": "rectangle"},
    "cube": {"type": "cube"},
    "sphere": {"type": "sphere"},
    "disk": {"type": "disk"},
    "cylinder": {"type": "cylinder", "p1": [0.5, 0.3, 1]},
    "cone": {"type": "cone", "angle": 30, "length": 1.5, "axis": [0.1, 0.3, -1]},
    "paraboloid": {"type": "paraboloid", "vertex": [0, 0, -0.5], "axis": [0.1, 0.3, 1], "focal_length": 0.3},
    "plane": {"type": "plane"},
    "cuboid": {"type": "cuboid", "min": [-1, -0.5, 0], "max": [0.5, 1, 0.7]},
    "implicit": {"type": "implicit", "function": lambda p: dr.norm(p * Vector3f(1, 1.5, 1)) - 0.8, "lipschitz": 1.5},
    "torus": {"type": "torus", "major": 0.8, "minor": 0.3},
    "metaballs": {"type": "metaballs", "balls": [[-0.4, 0, 0, 0.9], [0.5, 0.1, 0, 0.8]]},
    "sdfgrid": {"type": "sdfgrid", "grid": TensorXf(LUMP)},
}
CLOSED = ["cube", "sphere", "cuboid", "implicit", "torus", "metaballs", "sdfgrid"]


def load(description: dict[str, Any], **others: Any) -> Any:
    return djpt.load_dict({"type": "scene", "shape": description, "light": {"type": "point"}, **others})


def shot(scene: Any, o: np.ndarray, d: np.ndarray) -> Any:
    return scene.ray_intersect(djpt.Ray3f(Point3f(o), Vector3f(d), maxt=Float(np.inf)))


def rays(count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    o = rng.normal(size=(3, count))
    o *= 4 / np.linalg.norm(o, axis=0)
    d = rng.uniform(-0.8, 0.8, (3, count)) - o
    return o, d / np.linalg.norm(d, axis=0)


@pytest.mark.sparse(6)
@pytest.mark.parametrize("name", [name for name in SHAPES if name != "sdfgrid"])
def test_partials_are_the_change_of_position_with_uv(name: str) -> None:
    """Two hits close together: p' - p = dp/du (u' - u) + dp/dv (v' - v)."""
    scene = load({**SHAPES[name], "to_world": POSE})
    o, d = rays()
    a, b = shot(scene, o, d), shot(scene, o + 1e-3, d)
    change, du, dv = (np.array(x, np.float64) for x in (b.p - a.p, a.dp_du, a.dp_dv))
    uv = np.array(b.uv - a.uv, np.float64)
    uv = np.nan_to_num(uv)
    predicted = du * uv[0] + dv * uv[1]
    # Not across edges and seams, nor at silhouettes and poles.
    facing = np.abs(np.array(dr.dot(a.n, -Vector3f(d)))) > 0.3
    change[:, ~np.array(b.is_valid())] = 0
    same = np.array(a.is_valid() & b.is_valid() & (dr.dot(a.n, b.n) > 0.999)) & facing & (np.abs(uv).max(axis=0) < 0.05)
    assert same.sum() > 300
    change, predicted = change[:, same], predicted[:, same]
    error = np.linalg.norm(change - predicted, axis=0) / np.linalg.norm(change, axis=0)
    assert np.quantile(error, 0.9) < 0.03


@pytest.mark.sparse(3)
@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("name", SHAPES)
def test_flipping_turns_the_normals_round(name: str, flip: bool) -> None:
    o, d = rays(1000)
    a, b = (shot(load({**SHAPES[name], "to_world": POSE, "flip_normals": f}), o, d) for f in (flip, not flip))
    valid = np.array(a.is_valid())
    n, turned = (np.broadcast_to(np.array(si.sh_frame.n), (3, 1000))[:, valid] for si in (a, b))
    np.testing.assert_allclose(n, -turned, atol=1e-6)
    if name in CLOSED:
        # Seen from outside: outward unless flipped.
        towards = np.array(dr.dot(a.sh_frame.n, -Vector3f(d)))[valid]
        assert np.mean((towards > 0) != flip) > 0.99


@pytest.mark.sparse(8)
@pytest.mark.parametrize("name", SHAPES)
def test_closed_shapes_are_those_with_an_inside(name: str) -> None:
    """Every ray crosses a closed surface an even number of times."""
    scene = load(SHAPES[name])
    assert scene.shapes()[0].closed == (name in CLOSED)
    o, d = rays(2000)
    crossings = np.zeros(2000)
    ray = djpt.Ray3f(Point3f(o), Vector3f(d), maxt=Float(np.inf))
    for _ in range(6):
        si = scene.ray_intersect(ray)
        crossings += np.array(si.is_valid())
        ray = dr.select(
            si.is_valid(), si.spawn_ray(Vector3f(d)), djpt.Ray3f(Point3f(100), Vector3f(1, 0, 0), maxt=Float(0))
        )
    odd = np.mean(crossings % 2 == 1)
    assert odd < 5e-3 if name in CLOSED else odd > 0.02


@pytest.mark.sparse(6)
@pytest.mark.parametrize("name", ["cuboid", "sphere", "torus", "metaballs", "sdfgrid", "implicit"])
def test_furnace_within(name: str) -> None:
    """Inside of a closed shape that shines inwards with 1 and reflects half, every direction shows 2."""
    inward = {**SHAPES[name], "flip_normals": True, "emitter": {"type": "area", "radiance": 1.0}}
    inward["bsdf"] = {"type": "diffuse", "reflectance": 0.5}
    center = {"torus": [0.8, 0, 0], "sdfgrid": [0.5, 0.5, 0.5]}.get(name, [-0.2, 0, 0.2 if name == "cuboid" else 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    view = T().look_at(center, [5, 3, 1], [0, 0, 1])
    sensor = {"type": "perspective", "near_clip": 1e-3, "to_world": view, "fov": 90, "film": film}
    path = {"type": "path", "max_depth": 12, "rr_depth": 100}
    scene = djpt.load_dict({"type": "scene", "shape": inward, "sensor": sensor, "integrator": path})
    image = np.array(djpt.render(scene, spp=512), np.float64)
    assert image.mean() == pytest.approx(2 - 2.0**-11, rel=0.01)


# ---------------------------------------------------------------- as lights


@pytest.mark.parametrize("height", [0.01, 30.0])
def test_light_from_an_infinite_plane(height: float) -> None:
    """Irradiance pi L at any height."""
    lamp = T().translate([0, 0, height]).rotate([1, 0, 0], 180)
    above = {"type": "plane", "to_world": lamp, "emitter": {"type": "area", "radiance": 2.0}}
    scene = djpt.load_dict({"type": "scene", "floor": {"type": "rectangle"}, "lamp": above})
    start = djpt.Ray3f(Point3f(0, 0, 0.005), Vector3f(0, 0, -1), maxt=Float(np.inf))
    si = scene.ray_intersect(start)
    ds, weight = scene.sample_emitter_direction(si, Point2f(*uniform(2**16)), True)
    assert np.array(weight * ds.d.z)[0].mean() == pytest.approx(2 * np.pi, rel=0.01)


@pytest.mark.parametrize("name", ["cone", "cuboid", "cylinder", "disk", "paraboloid"])
def test_areas_and_positions(name: str) -> None:
    """The area, and the mean of the positions, by counting hits of parallel rays: Cauchy's formula and moments."""
    areas = {"cone": np.pi * 1.5**2 * np.tan(np.pi / 6) / np.cos(np.pi / 6), "disk": np.pi,
             "cuboid": 2 * (1.5 * 1.5 + 2 * 1.5 * 0.7), "cylinder": 2 * np.pi * np.sqrt(1.34),
             "paraboloid": 0.24 * np.pi * ((1 + 1 / 0.3) ** 1.5 - 1)}  # fmt: skip
    shape = load({**SHAPES[name], "to_world": POSE}).shapes()[0]
    assert float(shape.surface_area()[0]) == pytest.approx(areas[name], rel=1e-5)
    u, v = uniform(2**14, seed=4)
    ps = shape.sample_position(0, Point2f(u, v))
    # A quarter of a shape's uv square holds the share of the area that its partials say.
    uv, du, dv = shape.uv_and_partials(ps.p, djpt.UInt32(0)) if name != "cuboid" else (ps.uv, None, None)
    if name == "cuboid":
        local = np.linalg.inv(POSE.matrix) @ np.concatenate([np.array(ps.p, np.float64), np.ones((1, 2**14))])
        on_top = np.mean(np.abs(local[2] - 0.7) < 1e-4)
        assert on_top == pytest.approx(1.5 * 1.5 / areas[name], abs=0.02)
        return
    density = np.linalg.norm(np.cross(np.array(du, np.float64).T, np.array(dv, np.float64).T), axis=1)
    inner = np.array(uv)[1 if name != "disk" else 0] < 0.5
    half = ((1 + 0.25 / 0.3) ** 1.5 - 1) / ((1 + 1 / 0.3) ** 1.5 - 1)
    share = {"cone": 0.25, "cylinder": 0.5, "disk": 0.25, "paraboloid": half}[name]
    assert inner.mean() == pytest.approx(share, abs=0.02)
    # E[1 / density] over uniform points is the area of the uv square over that of the shape: 1 / area.
    assert (1 / density).mean() == pytest.approx(1 / areas[name], rel=0.1)


# ---------------------------------------------------------------- planes and the rest of the scene


def test_a_plane_does_not_stretch_the_scene() -> None:
    scene = load({"type": "sphere", "center": [0, 0, 1]}, floor={"type": "plane"})
    low, high = scene.bbox()
    np.testing.assert_allclose([low, high], [[-1, -1, 0], [1, 1, 2]], atol=1e-6)


def test_a_plane_between_shapes_casts_shadows() -> None:
    description = {"type": "scene", "between": {"type": "plane", "to_world": T().translate([0, 0, 0.5])},
                   "floor": {"type": "rectangle"}, "light": {"type": "point", "position": [0, 0, 1]}}  # fmt: skip
    scene = djpt.load_dict(description)
    si = shot(scene, np.array([[0.0], [0.0], [0.2]]), np.array([[0.0], [0.0], [-1.0]]))
    _, weight = scene.sample_emitter_direction(si, Point2f(0.5, 0.5), True)
    assert not np.array(weight).any()


@pytest.mark.parametrize("name", ["implicit", "torus", "metaballs", "sdfgrid"])
def test_searches_end(name: str) -> None:
    """From so far away that the shortest step is below the distance of two numbers; and for rays that aren't any."""
    distance = np.array([1e5, 1e7, 1e12, 1e30, np.nan, np.inf])
    o = np.stack([np.full(6, 0.3), np.full(6, 0.3), distance])
    scene, d = load(SHAPES[name]), np.tile([[0.0], [0.0], [-1.0]], 6)
    assert not np.array(shot(scene, o, d).is_valid())[4:].any()
    assert not np.array(shot(scene, np.full((3, 6), np.nan), d).is_valid()).any()
    assert not np.array(shot(scene, o, np.full((3, 6), np.nan)).is_valid()).any()


# ---------------------------------------------------------------- edits and errors


@pytest.mark.parametrize(
    ("description", "edits"),
    [
        (SHAPES["cuboid"], {"min": [-2, -1, -1], "max": [1, 2, 0.5]}),
        (SHAPES["torus"], {"major": 1.2, "minor": 0.1}),
    ],
)
def test_edits(description: dict[str, Any], edits: dict[str, Any]) -> None:
    scene = load(description)
    params = djpt.traverse(scene)
    for key, value in edits.items():
        params[f"shape.{key}"] = value
    params.update()
    o, d = rays(1000)
    a, b = shot(scene, o, d), shot(load({**description, **edits}), o, d)
    np.testing.assert_array_equal(np.array(a.t), np.array(b.t))
    np.testing.assert_allclose(np.array(a.uv), np.array(b.uv), atol=1e-6)


def test_contradictory_edits_are_taken_back() -> None:
    for description, key, value in ((SHAPES["cuboid"], "max", [-3, 1, 1]), (SHAPES["torus"], "minor", 2.0)):
        scene = load(description)
        before = np.array([*scene.bbox()])
        params = djpt.traverse(scene)
        params[f"shape.{key}"] = value
        with pytest.raises(ParameterError, match="shape"):
            params.update()
        np.testing.assert_array_equal(np.array([*scene.bbox()]), before)


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({"type": "cone", "angle": 90}, "'angle' must lie in"),
        ({"type": "cone", "axis": [0, 0, 0]}, "'axis' has length 0"),
        ({"type": "cone", "to_world": T().scale([1, 2, 1])}, "'to_world' of a cone may only scale uniformly"),
        ({"type": "cuboid", "min": [0, 0, 2]}, "'max' must be greater than 'min'"),
        ({"type": "torus", "minor": 1.5}, "'minor' must be less than 'major'"),
        ({"type": "metaballs"}, "needs the key 'balls'"),
        ({"type": "metaballs", "balls": [[0, 0, 0]]}, "rows of x, y, z and a radius"),
        ({"type": "metaballs", "balls": [[0, 0, 0, -1]]}, "positive radii"),
        ({"type": "implicit"}, "needs the key 'function'"),
        ({"type": "implicit", "function": 3}, "must be a function"),
        ({"type": "implicit", "function": lambda p: p}, "must return one Float"),
        ({"type": "implicit", "function": lambda p: p.w}, "can't be called with a Point3f: "),
        ({"type": "implicit", "function": lambda p: p.x, "lipschitz": -1}, "'lipschitz' must be at least 0"),
    ],
)
def test_errors(description: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        load(description)

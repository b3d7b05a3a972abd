"""Intersections against float64 geometry written here, surface frames against Mitsuba's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Bool, Float, Point3f, Vector3f
from tests.kit.axes import unit

RAYS = 20000
Array = np.ndarray


# ---------------------------------------------------------------- brute force in local coordinates


def rectangle(o: Array, d: Array) -> Array:
    """All hits of rays with [-1, 1]^2 in the plane z = 0: distances (N, 1), NaN = none."""
    t = -o[:, 2] / d[:, 2]
    p = o + t[:, None] * d
    return np.where(np.abs(p[:, :2]).max(axis=1) <= 1, t, np.nan)[:, None]


def cube(o: Array, d: Array) -> Array:
    """Six rectangles."""
    hits = []
    for axis in range(3):
        for side in (-1, 1):
            t = (side - o[:, axis]) / d[:, axis]
            others = np.delete(o + t[:, None] * d, axis, axis=1)
            hits.append(np.where(np.abs(others).max(axis=1) <= 1, t, np.nan))
    return np.stack(hits, axis=1)


def sphere(o: Array, d: Array) -> Array:
    """Roots of |o + t d|^2 = 1."""
    a, b, c = (d * d).sum(1), (o * d).sum(1), (o * o).sum(1) - 1
    root = np.sqrt(np.where(b * b - a * c >= 0, b * b - a * c, np.nan))
    return np.stack([(-b - root) / a, (-b + root) / a], axis=1)


LOCAL: dict[str, Callable[[Array, Array], Array]] = {"rectangle": rectangle, "cube": cube, "sphere": sphere}


def random_transform(rng: np.random.Generator, affine: bool) -> T:
    """A rotation, translation and scale; sheared and perhaps mirrored if `affine`."""
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if np.linalg.det(rotation) < 0:
        rotation[:, 0] *= -1
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * rng.uniform(0.3, 2)
    if affine:
        matrix[:3, :3] = matrix[:3, :3] @ (np.eye(3) + rng.uniform(-0.4, 0.4, (3, 3)))
        if rng.random() < 0.5:
            matrix[:3, 0] *= -1
    matrix[:3, 3] = rng.uniform(-3, 3, 3)
    return T(matrix)


def random_rays(rng: np.random.Generator, to_world: T, kind: str) -> tuple[Array, Array]:
    """Origins and directions (N, 3), rounded to float32; in the shape's neighbourhood."""
    inside = rng.uniform(-0.95, 0.95, (RAYS, 3))
    if kind == "inside":
        o = inside * 0.55
        d = rng.normal(size=(RAYS, 3))
    elif kind == "outside":
        o = rng.normal(size=(RAYS, 3))
        o *= rng.uniform(2, 9, (RAYS, 1)) / np.linalg.norm(o, axis=1, keepdims=True)
        d = inside * 1.3 - o
    else:  # grazing: almost in the plane of a face, or past a rim
        o = rng.normal(size=(RAYS, 3))
        o[:, 2] = rng.choice([-1, 0, 1], RAYS) + rng.normal(size=RAYS) * 0.02
        o[:, :2] *= 3
        d = inside - o
        d[:, 2] = rng.normal(size=RAYS) * 0.02
    m = to_world.matrix
    world_o = o @ m[:3, :3].T + m[:3, 3]
    world_d = (d @ m[:3, :3].T) * rng.uniform(0.2, 5, (RAYS, 1))  # directions need not have unit length
    return world_o.astype(np.float32).astype(float), world_d.astype(np.float32).astype(float)


def expected_hits(name: str, to_world: T, o: Array, d: Array) -> tuple[Array, Array]:
    """(first t > 0 or inf, is the answer sure in float32?)."""
    inverse = np.linalg.inv(to_world.matrix)
    local_o, local_d = o @ inverse[:3, :3].T + inverse[:3, 3], d @ inverse[:3, :3].T
    with np.errstate(all="ignore"):

        def nearest(origin: Array) -> Array:
            t = LOCAL[name](origin, local_d)
            return np.where(t > 0, t, np.inf).min(axis=1, initial=np.inf)

        first = nearest(local_o)
        # Sure: moving the ray by rounding to any side changes next to nothing.
        sure = np.full(len(o), True)
        error = 3e-6 * (1 + np.abs(local_o).max(axis=1, keepdims=True))
        for shift in (*np.eye(3), *-np.eye(3)):
            moved = nearest(local_o + shift * error)
            sure &= np.isclose(moved, first, rtol=3e-3, atol=0) | (np.isinf(moved) & np.isinf(first))
    return first, sure


def wide(x: Any) -> Array:
    """All lanes of a Dr.Jit array, as float64, also of one that is the same everywhere."""
    values = np.array(x, float)
    return np.broadcast_to(values, (*values.shape[:-1], RAYS))


def load(name: str, **parameters: Any) -> Any:
    shape = {"type": name, **parameters}
    return djpt.load_dict({"type": "scene", "shape": shape, "light": {"type": "point"}})


def ray(o: Array, d: Array, maxt: Any = np.inf) -> Any:
    maxt = np.broadcast_to(maxt, len(o)).astype(np.float32)
    return djpt.Ray3f(Point3f(o.T.astype(np.float32)), Vector3f(d.T.astype(np.float32)), maxt=Float(maxt))


CASES = [(name, seed) for name in LOCAL for seed in range(3)]


@pytest.mark.sparse(4)
@pytest.mark.parametrize("kind", ["inside", "outside", "grazing"])
@pytest.mark.parametrize(("name", "seed"), CASES)
def test_distances(name: str, seed: int, kind: str) -> None:
    rng = np.random.default_rng([seed, len(name)])
    to_world = random_transform(rng, affine=name != "sphere")
    o, d = random_rays(rng, to_world, kind)
    expected, sure = expected_hits(name, to_world, o, d)
    assert sure.mean() > (0.25 if kind == "grazing" else 0.9)
    scene = load(name, to_world=to_world)
    pi = scene.ray_intersect_preliminary(ray(o, d))
    t, valid = np.array(pi.t, float)[sure], np.array(pi.is_valid())[sure]
    expected = expected[sure]
    np.testing.assert_array_equal(valid, np.isfinite(expected))
    np.testing.assert_allclose(t[valid], expected[valid], rtol=6e-3)
    assert np.quantile(np.abs(t[valid] / expected[valid] - 1), 0.9) < 1e-4
    assert 0.02 < valid.mean() <= 1


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_maxt_and_shadow_test(name: str, seed: int) -> None:
    """`ray_test` is true exactly where something is hit; nothing beyond maxt counts."""
    rng = np.random.default_rng([seed, len(name)])
    to_world = random_transform(rng, affine=name != "sphere")
    o, d = random_rays(rng, to_world, "outside")
    scene = load(name, to_world=to_world)
    t = np.array(scene.ray_intersect_preliminary(ray(o, d)).t)
    np.testing.assert_array_equal(np.array(scene.ray_test(ray(o, d))), np.isfinite(t))
    finite = np.where(np.isfinite(t), t, 1)
    for factor, reached in ((1.01, True), (0.99, False)):
        short = ray(o, d, finite * factor)
        valid = np.array(scene.ray_intersect_preliminary(short).is_valid())
        hits_front = np.isfinite(t) & reached
        np.testing.assert_array_equal(valid, hits_front)
        np.testing.assert_array_equal(np.array(scene.ray_test(short)), valid)
    for end in (0.0, -1.0):
        nowhere = ray(o, d, np.full(RAYS, end))
        assert not np.array(scene.ray_intersect_preliminary(nowhere).is_valid()).any()
        assert not np.array(scene.ray_test(nowhere)).any()


@pytest.mark.parametrize("name", LOCAL)
def test_inactive_lanes_hit_nothing(name: str) -> None:
    rng = np.random.default_rng(0)
    o, d = random_rays(rng, T(), "outside")
    scene, even = load(name), Bool(np.arange(RAYS) % 2 == 0)
    assert not np.array(scene.ray_intersect(ray(o, d), even).is_valid())[1::2].any()
    assert not np.array(scene.ray_test(ray(o, d), even))[1::2].any()


@pytest.mark.parametrize("name", LOCAL)
def test_hit_points_lie_on_the_surface(name: str) -> None:
    rng = np.random.default_rng(4)
    to_world = random_transform(rng, affine=name != "sphere")
    o, d = random_rays(rng, to_world, "outside")
    si = load(name, to_world=to_world).ray_intersect(ray(o, d))
    valid = np.array(si.is_valid())
    inverse = np.linalg.inv(to_world.matrix)
    local = np.array(si.p, float).T[valid] @ inverse[:3, :3].T + inverse[:3, 3]
    if name == "sphere":
        away = np.linalg.norm(local, axis=1) - 1
    elif name == "cube":
        away = np.abs(local).max(axis=1) - 1
    else:
        away = local[:, 2]
    assert np.abs(away).max() < 2e-5


# ---------------------------------------------------------------- the surface, against Mitsuba

FIELDS = ("t", "p", "n", "uv", "dp_du", "dp_dv", "wi")
MIRROR = T().translate([0.2, 0.1, 0]).rotate(unit(1, 2, 0), 40).scale([-1, 0.7, 1.4])
TURNED = T().translate([0.2, 0.1, 0]).rotate(unit(1, 2, 3), 70).scale(0.8)
POSES = {
    "turned": TURNED,
    "mirrored": MIRROR,
    "sheared": T([[1, 0.4, 0, 0], [0, 1, 0.3, 0], [0, 0, 0.8, 0], [0, 0, 0, 1]]),
}


def poses() -> list[Any]:
    """Shape, transform, flip."""
    return [
        pytest.param(
            name,
            pose,
            flip,
            id=f"{name}-{key}{'-flipped' if flip else ''}",
        )
        for name in LOCAL
        for key, pose in POSES.items()
        for flip in (False, True)
        if name != "sphere" or key == "turned"
    ]


@pytest.mark.sparse(24)
@pytest.mark.parametrize(("name", "pose", "flip"), poses())
def test_surface_is_mitsubas(name: str, pose: T, flip: bool) -> None:
    mi = pytest.importorskip("mitsuba")
    shape = {"type": name, "to_world": pose, "flip_normals": flip}
    o, d = random_rays(np.random.default_rng(3), pose, "outside")
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    mine = load(name, to_world=pose, flip_normals=flip).ray_intersect(ray(o, d))
    description = djpt.validation.to_mitsuba({"type": "scene", "shape": shape})
    mi.set_variant("llvm_ad_rgb")
    scene = mi.load_dict(description)  # kept: what it returns refers to it
    other = scene.ray_intersect(mi.Ray3f(mi.Point3f(o.T.astype(np.float32)), mi.Vector3f(d.T.astype(np.float32))))
    valid = np.array(mine.is_valid())
    both = valid & np.array(other.is_valid())
    assert np.mean(valid != np.array(other.is_valid())) < 1e-3
    for field in FIELDS:
        a, b = wide(getattr(mine, field))[..., both], wide(getattr(other, field))[..., both]
        error = np.abs(a - b)
        if field == "uv":
            error = np.minimum(error, 1 - error)  # a seam
        assert np.quantile(error, 0.999) < 5e-4, field
    for axis in "stn":
        a, b = (wide(getattr(si.sh_frame, axis))[:, both] for si in (mine, other))
        assert np.quantile(np.abs(a - b), 0.999) < 1e-3, f"sh_frame.{axis}"


@pytest.mark.sparse(3)
@pytest.mark.parametrize(("name", "pose", "flip"), poses())
def test_frames_are_orthonormal(name: str, pose: T, flip: bool) -> None:
    o, d = random_rays(np.random.default_rng(3), pose, "outside")
    si = load(name, to_world=pose, flip_normals=flip).ray_intersect(ray(o, d))
    valid = np.array(si.is_valid())
    s, t, n = (wide(getattr(si.sh_frame, axis))[:, valid] for axis in "stn")
    for a, b, value in ((s, s, 1), (t, t, 1), (n, n, 1), (s, t, 0), (t, n, 0), (n, s, 0)):
        np.testing.assert_allclose((a * b).sum(axis=0), value, atol=2e-6)
    np.testing.assert_allclose(np.cross(s.T, t.T), n.T, atol=3e-6)
    # Tangents and normals belong together.
    tangents = [wide(v)[:, valid] for v in (si.dp_du, si.dp_dv)]
    cross = np.cross(*(v.T for v in tangents))
    along = (cross / np.linalg.norm(cross, axis=1, keepdims=True) * n.T).sum(axis=1)
    np.testing.assert_allclose(np.abs(along), 1, atol=1e-3)


def test_several_shapes_nearest_first() -> None:
    """Overlapping shapes of all kinds: the first hit is the minimum over the shapes alone."""
    rng = np.random.default_rng(11)
    names = ["cube", "rectangle", "sphere", "cube", "rectangle", "sphere", "rectangle", "cube"]
    transforms = [random_transform(rng, affine=name != "sphere") for name in names]
    # Two of them share axes with the world, as walls do.
    transforms[1], transforms[3] = T().translate([0, 0, 1]), T().translate([1, 0, 0]).scale(0.5)
    shapes = {f"{name}{i}": {"type": name, "to_world": transforms[i]} for i, name in enumerate(names)}
    scene = djpt.load_dict({"type": "scene", **shapes, "light": {"type": "point"}})
    o, d = rng.uniform(-4, 4, (RAYS, 3)).astype(np.float32), rng.normal(size=(RAYS, 3)).astype(np.float32)
    o, d = o.astype(float), d.astype(float)
    alone = [expected_hits(name, at, o, d) for name, at in zip(names, transforms, strict=True)]
    t = np.stack([first for first, _ in alone])
    sure = np.stack([sure for _, sure in alone]).all(axis=0)
    nearest = t.min(axis=0)
    gap = np.partition(t, 1, axis=0)[1] > nearest * (1 + 1e-3)
    pi = scene.ray_intersect_preliminary(ray(o, d))
    valid = np.array(pi.is_valid())
    np.testing.assert_array_equal(valid[sure], np.isfinite(nearest)[sure])
    hit = sure & valid
    np.testing.assert_allclose(np.array(pi.t, float)[hit], nearest[hit], rtol=1e-3)
    clear = hit & gap
    np.testing.assert_array_equal(np.array(pi.shape_index)[clear], t.argmin(axis=0)[clear])
    np.testing.assert_array_equal(np.array(scene.ray_test(ray(o, d)))[sure], np.isfinite(nearest)[sure])


# ---------------------------------------------------------------- special rays


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("name", LOCAL)
def test_rays_along_the_axes(name: str, axis: int) -> None:
    """Zero components of the direction: divisions by zero that must not matter."""
    o, d = np.full((1, 3), 0.25), np.zeros((1, 3))
    o[0, axis], d[0, axis] = -5, 1
    pi = load(name).ray_intersect_preliminary(ray(o, d))
    with np.errstate(all="ignore"):
        t = LOCAL[name](o, d)
        expected = np.where(t > 0, t, np.inf).min()
    if name == "rectangle" and axis < 2:
        expected = np.inf  # beside the plane
    assert float(pi.t[0]) == pytest.approx(expected, rel=1e-6)


def test_ray_in_the_plane_of_a_rectangle_misses() -> None:
    pi = load("rectangle").ray_intersect_preliminary(ray(np.array([[-5.0, 0, 0]]), np.array([[1.0, 0, 0]])))
    assert not pi.is_valid()[0]


@pytest.mark.parametrize("name", LOCAL)
def test_spawned_rays_leave_the_surface(name: str) -> None:
    """A ray from a hit point, away from the shape, doesn't meet it again."""
    rng = np.random.default_rng(5)
    to_world = T().translate([30, -20, 10]) @ random_transform(rng, affine=name != "sphere")
    o, d = random_rays(rng, to_world, "outside")
    scene = load(name, to_world=to_world)
    si = scene.ray_intersect(ray(o, d))
    back = dr.normalize(-Vector3f(d.T.astype(np.float32)))
    again = scene.ray_test(si.spawn_ray(back)) & si.is_valid()
    assert np.mean(np.array(again)) < 1e-4


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("distance", [2.0, 100.0])
def test_small_and_large_spheres(radius: float, distance: float) -> None:
    """Precision is relative: the error of the distance stays small against the radius."""
    rng = np.random.default_rng(6)
    o = rng.normal(size=(2000, 3))
    o *= distance * radius / np.linalg.norm(o, axis=1, keepdims=True)
    d = rng.uniform(-0.5, 0.5, (2000, 3)) * radius - o
    o, d = o.astype(np.float32).astype(float), (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    t = np.array(load("sphere", radius=radius).ray_intersect_preliminary(ray(o, d)).t, float)
    expected = sphere(o / radius, d.astype(float)).min(axis=1) * radius
    np.testing.assert_allclose(t, expected, atol=3e-6 * distance * radius)


@pytest.mark.parametrize("bad", [T().scale([1, 2, 1]), T([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])])
def test_a_stretched_sphere_is_refused(bad: T) -> None:
    with pytest.raises(SceneError, match="uniformly"):
        load("sphere", to_world=bad)
    params = djpt.traverse(load("sphere"))
    with pytest.raises(ParameterError, match="uniformly"):
        params["shape.to_world"] = bad


def test_a_cube_must_stay_a_box() -> None:
    scene = load("cube")
    params = djpt.traverse(scene)
    corners = np.array(params["shape.vertex_positions"])
    corners[0] += 0.5
    with pytest.raises(ParameterError, match="box"):
        params["shape.vertex_positions"] = djpt.Float(corners)
        params.update()


def test_bounding_box() -> None:
    low, high = load("cube", to_world=T().translate([1, 2, 3]).rotate([0, 0, 1], 45)).bbox()
    np.testing.assert_allclose(low, [1 - 2**0.5, 2 - 2**0.5, 2])
    np.testing.assert_allclose(high, [1 + 2**0.5, 2 + 2**0.5, 4])

"""What emitters claim of themselves: densities, weights, power, and the rays that leave them.

All parameter sets of tests/kit/emitters.py are tested, and all shapes of tests/kit/plugins.py that can shine.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import EmitterFlags, has_flag
from djpt.description import registry
from djpt.jit.types import Float, Point2f, Point3f, TensorXf, UInt32
from tests.kit.arrays import in_numpy, rows
from tests.kit.chi_squared import SIGNIFICANCE, SPHERE, p_value, uniform
from tests.kit.emitters import NAMES, RAYS_UNLIKE_MITSUBA, SETS, UNLIKE_MITSUBA, entry, plugin_of
from tests.kit.lit_floor import floor_scene
from tests.kit.one_light import lit, looked_at, reference
from tests.kit.plugins import examples

COUNT = 2**18
RAYS = 2**16

HIDDEN = [name for name in NAMES if plugin_of(name) == "directionalarea"]
"""Lights that only their own rays show."""

ESTIMATED = [name for name in NAMES if "bitmap" in name or "checkerboard" in name or plugin_of(name) == "sunsky"]
"""Lights whose power is known by the luminance: of textures, of their mean over uv."""


OWN_TESTS = {"timed_sunsky"}
"""Emitters whose rays need a time: see `tests.lights.test_timed_sunsky`."""


def test_every_emitter_has_a_set() -> None:
    own = {name for name, factory in registry.registered("emitter").items() if registry.is_own(factory)}
    assert own - OWN_TESTS == set(SETS)


# ---------------------------------------------------------------- directions


def lights() -> list[Any]:
    """All shapes that shine, and all sets of emitters."""
    shining = [
        pytest.param({**p.values[1], "emitter": {"type": "area", "radiance": 2.0}}, id=p.id) for p in examples("shape")
    ]
    return shining + [pytest.param(name, id=name) for name in NAMES if name not in HIDDEN]


def scene_of(light: dict[str, Any] | str) -> Any:
    """One of `lights` over an all but empty scene."""
    return lit(light=entry(light) if isinstance(light, str) else light)


@pytest.mark.parametrize("light", lights())
class TestDirections:
    @pytest.mark.sparse(84)
    def test_directions_follow_the_density(self, light: dict[str, Any] | str) -> None:
        """Of the directions that bring light: what light sampling draws is what a ray in that direction finds."""
        scene = scene_of(light)
        ds, weight = scene.sample_emitter_direction(reference(), Point2f(*uniform(COUNT)), False)
        if np.array(ds.delta).any():
            pytest.skip("a delta emitter has no density")
        # The density is that of a narrow cone: look there closely.
        focus = Frame3f.from_normal(dr.normalize(dr.detach(dr.mean(ds.d, axis=1))))
        towards = focus.to_local(ds.d)
        dr.eval(towards, weight)
        lowest = float(np.array(towards.z).min())
        domain = SPHERE if lowest < 0.9 else type(SPHERE)(
            (1 - 1.2 * (1 - lowest), 0), (1, 2 * np.pi), SPHERE.point, SPHERE.coordinates
        )  # fmt: skip

        def density(local: Any) -> Any:
            at, radiance, _ = looked_at(scene, focus.to_world(local))
            return dr.select(dr.max(radiance) > 0, scene.pdf_emitter_direction(reference(), at), 0)

        p, integral = p_value(domain, towards, dr.max(weight) > 0, density, fine=96)
        assert integral <= 1 + 5e-3
        assert p > SIGNIFICANCE

    @pytest.mark.sparse(12)
    def test_weights_are_radiance_over_density(self, light: dict[str, Any] | str) -> None:
        scene = scene_of(light)
        ds, weight = scene.sample_emitter_direction(reference(), Point2f(*uniform(4096, seed=3)), False)
        if np.array(ds.delta).any():
            pytest.skip("a delta emitter has no density")
        _, radiance, _ = looked_at(scene, ds.d)
        again, inverse, bright = scene.pdf_emitter_direction(reference(), ds), ds.pdf * ds.weight, dr.max(weight) > 0
        dr.eval(ds, weight, radiance, again, inverse, bright)
        lit_up = np.broadcast_to(np.array(bright), (4096,))
        assert lit_up.mean() > 0.1
        product = in_numpy(weight) * np.array(ds.pdf)
        radiance = np.broadcast_to(in_numpy(radiance), (3, 4096))
        # Rays that graze an edge may miss.
        agree = np.isclose(product, radiance, rtol=1e-3).all(axis=0)
        assert agree[lit_up].mean() > 0.995
        again, pdf, inverse = (np.broadcast_to(np.array(x), (4096,)) for x in (again, ds.pdf, inverse))
        np.testing.assert_allclose(again[lit_up], pdf[lit_up], rtol=2e-3)
        np.testing.assert_allclose(inverse[lit_up], 1, rtol=1e-4)

    @pytest.mark.sparse(3)
    def test_record_is_consistent(self, light: dict[str, Any] | str) -> None:
        scene = scene_of(light)
        ds, _ = scene.sample_emitter_direction(reference(), Point2f(*uniform(1024, seed=4)), False)
        dr.eval(ds)
        np.testing.assert_allclose(np.linalg.norm(in_numpy(ds.d), axis=0), 1, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(in_numpy(ds.n), axis=0), 1, atol=1e-5)
        if np.isfinite(np.array(ds.dist)).all():
            np.testing.assert_allclose(in_numpy(ds.d) * np.array(ds.dist), in_numpy(ds.p), rtol=1e-4, atol=1e-4)


def rim_of_a_sphere(rng: np.random.Generator) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """A light, directions (N, 3) from the origin that graze it or just miss it, and their densities by float64."""
    centre, radius = np.array([-2, 3, 2.5]), 0.5
    distance = np.linalg.norm(centre)
    w = centre / distance
    s = np.cross(w, [0, 0, 1])
    s /= np.linalg.norm(s)
    sin = radius / distance * (1 + rng.uniform(-1e-5, 1e-5, (COUNT, 1)))
    phi = 2 * np.pi * rng.random((COUNT, 1))
    d = np.sqrt(1 - sin**2) * w + sin * (np.cos(phi) * s + np.sin(phi) * np.cross(w, s))
    d = d.astype(np.float32).astype(np.float64)
    d /= np.linalg.norm(d, axis=1)[:, None]

    middle = d @ centre
    reach = np.sqrt(np.maximum(0, radius**2 - distance**2 + middle**2))
    n = ((middle - reach)[:, None] * d - centre) / radius
    # Uniform in uv.
    area = 2 * np.pi**2 * radius**2 * np.sqrt(1 - n[:, 2] ** 2)
    with np.errstate(divide="ignore"):
        density = np.where(reach > 0, (middle - reach) ** 2 / (area * reach / radius), 0)
    white = {"type": "bitmap", "data": TensorXf(np.ones((2, 2, 3), np.float32)), "raw": True}
    shape = {"type": "sphere", "center": centre.tolist(), "radius": radius}
    return {**shape, "emitter": {"type": "area", "radiance": white}}, d, density


def rim_of_a_cylinder(rng: np.random.Generator) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """The same for a cylinder, whose points are drawn by area."""
    p0, p1, radius = np.array([-2, 3, 2.5]), np.array([-1.5, 3, 2]), 0.4
    axis = (p1 - p0) / np.linalg.norm(p1 - p0)
    across = p0 - axis * p0.dot(axis)
    far = np.linalg.norm(across)
    x, y = across / far, np.cross(axis, across / far)
    # The normals of planes through the origin that graze it along a line, and directions in these planes.
    cos = radius / far * (1 + rng.uniform(-1e-5, 1e-5, (COUNT, 1)))
    n = cos * x + np.sqrt(1 - cos**2) * y
    q = p0 + (p1 - p0) * rng.uniform(0.2, 0.8, (COUNT, 1))
    d = q - n * (q * n).sum(axis=1, keepdims=True)
    d = (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32).astype(np.float64)
    d /= np.linalg.norm(d, axis=1)[:, None]

    flat = d - axis * (d @ axis)[:, None]
    squared = (flat**2).sum(axis=1)
    middle = flat @ across / squared
    reach = np.sqrt(np.maximum(0, radius**2 - far**2 + middle**2 * squared))
    dist = middle - reach / np.sqrt(squared)
    area = 2 * np.pi * radius * np.linalg.norm(p1 - p0)
    with np.errstate(divide="ignore"):
        density = np.where(reach > 0, dist**2 / (area * np.sqrt(squared) * reach / radius), 0)
    shape = {"type": "cylinder", "p0": p0.tolist(), "p1": p1.tolist(), "radius": radius}
    return {**shape, "emitter": {"type": "area"}}, d, density


@pytest.mark.narrow
@pytest.mark.parametrize("rim", [rim_of_a_sphere, rim_of_a_cylinder])
def test_densities_where_rays_graze_a_curved_light(rim: Any) -> None:
    """Rounding decides which of these rays hit, and where: so the mean of the densities counts, not each of them."""
    light, d, exact = rim(np.random.default_rng(3))
    scene = lit(light=light)
    at, radiance, _ = looked_at(scene, djpt.Vector3f(*d.T.astype(np.float32)))
    found = np.array(dr.select(dr.max(radiance) > 0, scene.pdf_emitter_direction(reference(), at), 0), np.float64)
    # A few rays meet the surface from behind, by rounding.
    assert found.mean() == pytest.approx(exact.mean(), rel=0.05)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.sparse(9)
def test_no_point_of_space_gives_nonsense(name: str) -> None:
    """At the light itself, behind it, far away: weights are finite and not negative."""
    scene = lit(light=entry(name))
    rng = np.random.default_rng(2)
    points = np.concatenate([[[-2, 3, 2.5], [0, 0, 0], [1e6, -1e6, 1e6]], rng.normal(0, 4, (500, 3))]).T
    p = Point3f(*rows(points))
    emitter = scene.emitter_ptr(UInt32(0))
    ds, weight = emitter.sample_direction(djpt.Interaction3f(p=p), Point2f(*uniform(503)))
    density = emitter.pdf_direction(djpt.Interaction3f(p=p), ds)
    dr.eval(weight, density)
    found = in_numpy(weight)
    assert np.isfinite(found).all()
    assert found.min() >= 0
    pdf = np.array(density)
    assert np.isfinite(pdf).all()
    assert pdf.min() >= 0


@pytest.mark.parametrize("name", HIDDEN)
def test_hidden_lights_are_hidden(name: str) -> None:
    scene = lit(light=entry(name))
    ds, weight = scene.sample_emitter_direction(reference(), Point2f(*uniform(64)), False)
    assert not np.array(weight).any()
    assert not np.array(ds.pdf).any()
    shape = scene.shapes()[0]
    ps = shape.sample_position(0, Point2f(*uniform(64)))
    _, radiance, valid = looked_at(scene, dr.normalize(ps.p))
    assert np.array(valid).any()
    assert not np.array(radiance).any()


# ---------------------------------------------------------------- rays

GROUND, REACH = -1.0, 12.0
"""Height of a plane that receives light, and how large the scene is."""


BALL = {"type": "sphere", "radius": REACH, "center": [0, GROUND, 0], "bsdf": {"type": "null"}}
RADIUS = REACH * (1 + 1500 * 2.0**-24) * math.sqrt(3)
"""Of the sphere about the box about the scene."""


def room(light: dict[str, Any]) -> Any:
    """A light in a transparent ball, which makes the scene as large as a receiving plane needs."""
    return djpt.load_dict({"type": "scene", "light": light, "ball": BALL})


def rays_of(scene: Any, count: int = RAYS, seed: int = 0) -> tuple[Any, np.ndarray, list[Any]]:
    """Rays of the first emitter, their weights (3, count), and the numbers that made them."""
    u = uniform(count, 4, seed)
    ray, weight = scene.emitter_ptr(UInt32(0)).sample_ray(0, 0, Point2f(u[0], u[1]), Point2f(u[2], u[3]))
    dr.eval(ray, weight)
    return ray, np.broadcast_to(in_numpy(weight), (3, count)), u


@pytest.mark.sparse(4)
@pytest.mark.parametrize("name", NAMES)
def test_mean_weight_is_the_power(name: str) -> None:
    scene = room(entry(name))
    _, weight, _ = rays_of(scene)
    per_ray = weight.mean(axis=0)
    mean, sigma = per_ray.mean(), per_ray.std(ddof=1) / math.sqrt(RAYS)
    power = scene.emitters()[0].power()
    assert abs(mean - power) <= (0.25 * mean if name in ESTIMATED else 3 * sigma + 1e-5 * mean)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("area-rectangle", math.pi * 5 * 4 * 0.7**2),
        ("area-sphere", math.pi * 8 * math.pi),
        ("area-disk", math.pi * 8 * math.pi * 0.7**2),
        ("area-cube", math.pi * 9 * 8 * (0.5 * 0.3 + 0.3 * 0.2 + 0.2 * 0.5)),
        ("constant-default", 4 * math.pi**2 * RADIUS**2),
        ("directional-turned", 2 * math.pi * RADIUS**2),
        ("directionalarea-rectangle", 3 * 4 * 0.7**2),
        ("point-turned", 4 * math.pi * 12),
        ("projector-default", math.pi * (43.266615 / math.sqrt(2) / 50) ** 2),
        ("spot-sharp", 2 * math.pi * 20 * (1 - math.cos(math.radians(25)))),
        ("spot-wide", 2 * math.pi * 20 * (1 - 2 / math.pi)),
    ],
)
def test_power_in_closed_form(name: str, expected: float) -> None:
    assert room(entry(name)).emitters()[0].power() == pytest.approx(expected, rel=2e-6)


@pytest.mark.sparse(4)
@pytest.mark.parametrize("name", [name for name in NAMES if name not in {*UNLIKE_MITSUBA, *RAYS_UNLIKE_MITSUBA}])
def test_rays_are_mitsubas(name: str) -> None:
    mi = pytest.importorskip("mitsuba")
    if "checkerboard" in name:
        pytest.skip("Mitsuba 3.9.1 draws no rays for a checkerboard")
    ray, weight, u = rays_of(room(entry(name)), 4096)
    described = djpt.validation.to_mitsuba({"type": "scene", "light": entry(name), "ball": BALL})
    with djpt.validation.bridge._variant():
        scene = mi.load_dict(described)
        other, expected = scene.emitters()[0].sample_ray(0, 0, mi.Point2f(*u[:2]), mi.Point2f(*u[2:]))
        dr.eval(other, expected)
        theirs = [np.broadcast_to(in_numpy(x), (3, 4096)) for x in (other.o, other.d, expected)]
    # Mitsuba moves rays off the surface that they leave.
    scale = 1 + np.abs(theirs[0]).max()
    np.testing.assert_allclose(np.broadcast_to(in_numpy(ray.o), (3, 4096)), theirs[0], atol=1e-4 * scale)
    length = np.linalg.norm(theirs[1], axis=0)
    close = np.abs(np.broadcast_to(in_numpy(ray.d), (3, 4096)) - theirs[1] / length).max(axis=0) < 1e-4
    assert close.mean() > 0.998
    agree = np.isclose(weight, theirs[2], rtol=1e-3, atol=1e-5 * theirs[2].max()).all(axis=0)
    assert agree.mean() > 0.998


@pytest.mark.sparse(20)
@pytest.mark.parametrize("name", [name for name in NAMES if name not in HIDDEN])
def test_rays_bring_the_light_that_is_sampled(name: str) -> None:
    """What a disk of the ground receives: by rays from the light, and by directions towards the light."""
    scene = room(entry(name))
    radius = 2.5
    count = 2**18
    ray, weight, _ = rays_of(scene, count, seed=1)
    t = (GROUND - ray.o.y) * dr.rcp(ray.d.y)
    at = ray(t)
    # From above: the disk has one side.
    lands = (t > 0) & (ray.d.y < 0) & (dr.square(at.x) + dr.square(at.z) < radius**2)
    first = weight * np.broadcast_to(np.array(lands, np.float64), (count,))

    u = uniform(count, 4, seed=2)
    r, phi = radius * dr.sqrt(u[0]), 2 * math.pi * u[1]
    p = Point3f(r * dr.cos(phi), Float(GROUND), r * dr.sin(phi))
    ds, light = scene.emitter_ptr(UInt32(0)).sample_direction(p, Point2f(u[2], u[3]))
    # Lights hide nothing of themselves here: those that could are convex, and only their front sends light.
    second = in_numpy(light * (dr.select(ds.d.y > 0, ds.d.y, 0) * (math.pi * radius**2)))
    second = np.broadcast_to(second, (3, count))
    assert first.mean() > 0
    for a, b in zip(first, second, strict=True):
        sigma = math.sqrt((a.var() + b.var()) / count)
        assert abs(a.mean() - b.mean()) <= 4 * sigma + 1e-5 * b.mean()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.sparse(4)
def test_bounds_hold_the_light(name: str) -> None:
    """Rays start in the box, and leave within theta_o + theta_e of the axis."""
    scene = room(entry(name))
    emitter = scene.emitters()[0]
    bounds = emitter.bounds()
    flags = emitter.flags()
    at_infinity = has_flag(flags, EmitterFlags.Infinite) or (
        has_flag(flags, EmitterFlags.DeltaDirection) and not emitter.on_shape
    )
    assert (bounds is None) == at_infinity
    if bounds is None:
        return
    ray, weight, _ = rays_of(scene, 4096)
    o, d = (np.broadcast_to(in_numpy(x), (3, 4096)).T for x in (ray.o, ray.d))
    assert (o >= bounds.low - 1e-5).all()
    assert (o <= bounds.high + 1e-5).all()
    assert np.linalg.norm(bounds.axis) == pytest.approx(1)
    widest = min(bounds.theta_o + bounds.theta_e, math.pi)
    assert (d @ bounds.axis)[weight.max(axis=0) > 0].min() >= math.cos(widest) - 1e-5
    assert bounds.power == emitter.power()


def test_a_mesh_knows_where_its_normals_point() -> None:
    """A flat mesh is as narrow as a rectangle, a bent one as wide as its normals; `flip_normals` turns both."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 1]])
    for bend, flip in ((0.0, False), (1.0, False), (0.5, True)):
        positions = corners * [1, 1, bend]
        faces = [[0, 1, 2], [0, 2, 3]]
        mesh = djpt.Mesh("m", positions, faces, props={"emitter": {"type": "area"}, "flip_normals": flip})
        scene = djpt.load_dict({"type": "scene", "mesh": mesh})
        bounds = scene.emitters()[0].bounds()
        normals = np.array([np.cross(*(positions[f[1:]] - positions[f[0]])) for f in np.array(faces)])
        normals *= (-1 if flip else 1) / np.linalg.norm(normals, axis=1, keepdims=True)
        between = math.acos(min(1.0, float(normals[0] @ normals[1])))
        assert bounds.theta_o == pytest.approx(between / 2, abs=1e-5)
        np.testing.assert_allclose(normals @ bounds.axis, math.cos(between / 2), atol=1e-6)


@pytest.mark.parametrize("shape", ["plane", "torus"])
def test_shapes_without_area_send_no_rays(shape: str) -> None:
    scene = lit(light={"type": shape, "emitter": {"type": "area"}})
    emitter = scene.emitters()[0]
    assert 0 < emitter.power() < math.inf
    with pytest.raises(djpt.SceneError, match="light: no rays can be drawn"):
        emitter.sample_ray(0, 0, Point2f(0.5), Point2f(0.5))


def test_unseen_lights_are_named() -> None:
    """One warning for integrators that go from the camera to the light."""
    scene = floor_scene({"beam": entry("directionalarea-rectangle")}, size=4)
    with pytest.warns(UserWarning, match=r"can't show light .* one direction only: beam\.emitter stays black"):
        djpt.render(djpt.load_dict(scene), spp=1)


@pytest.mark.parametrize("shape", ["sphere", "rectangle", "disk", "cylinder", "cube"])
def test_points_of_the_lamp_itself(shape: str) -> None:
    """Light is finite, and so is the direction to it, if the point that is lit is the one that is drawn."""
    lamp = {"type": shape, "emitter": {"type": "area", "radiance": 1.0}}
    scene = djpt.load_dict({"type": "scene", "lamp": lamp})
    rng = np.random.default_rng(0)
    samples = djpt.Point2f(rng.random((2, 4096)).astype(np.float32))
    drawn = scene.shapes()[0].sample_position(0.0, samples)
    it = dr.zeros(djpt.SurfaceInteraction3f, 4096)
    it.p, it.n = drawn.p, drawn.n
    ds, weight = scene.sample_emitter_direction(it, samples, False)
    assert np.isfinite(np.array(ds.d)).all() and np.isfinite(np.array(weight)).all()

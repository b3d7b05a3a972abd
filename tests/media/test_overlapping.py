"""Bodies that overlap: the one of the highest priority fills the space, and interfaces follow from what is around."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt import ScalarTransform4f as T
from djpt.errors import RenderError, SceneError
from djpt.jit.types import UInt32
from djpt.scene.surroundings import index_around
from tests.kit.media_scenes import colour

AIR, WATER, GLASS = 1.0, 1.33, 1.5


def interface(inside: float, outside: float = AIR, **more: Any) -> dict[str, Any]:
    return {"type": "dielectric", "int_ior": inside, "ext_ior": outside, **more}


def slab(low: float, high: float, bsdf: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A wide box from one z to another."""
    place = T().translate([0, 0, (low + high) / 2]).scale([50, 50, (high - low) / 2])
    return {"type": "cube", "to_world": place, "bsdf": bsdf, **more}


def as_mesh(shape: dict[str, Any]) -> djpt.Mesh:
    """A slab of triangles, which stand in a tree."""
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float32)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))], np.uint32)
    props = {**{key: value for key, value in shape.items() if key != "type"}, "face_normals": True}
    return djpt.Mesh("slab", vertex_positions=corners, faces=faces, props=props)


def ball(radius: float, bsdf: dict[str, Any], x: float = 0.0, **more: Any) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, 0, 0], "radius": radius, "bsdf": bsdf, **more}


def rendered(scene: dict[str, Any], spp: int = 256, integrator: Any = None, seed: int = 0) -> np.ndarray:
    loaded = djpt.load_dict({"type": "scene", **scene})
    return np.array(djpt.render(loaded, spp=spp, seed=seed, integrator=integrator), np.float64)


def fresnel(cos_i: float, n_i: float, n_t: float) -> tuple[float, float]:
    """The reflectance of an interface, and the cosine behind it."""
    cos_t = np.sqrt(1 - (n_i / n_t) ** 2 * (1 - cos_i**2))
    parallel = (n_t * cos_i - n_i * cos_t) / (n_t * cos_i + n_i * cos_t)
    perpendicular = (n_i * cos_i - n_t * cos_t) / (n_i * cos_i + n_t * cos_t)
    return (parallel**2 + perpendicular**2) / 2, cos_t


def stack(cos: float, indices: list[float], depths: list[float], absorption: list[float]) -> float:
    """The fraction of light that passes layers between half spaces of air, all reflections between them included."""
    passed, back = 1.0, 0.0  # of what has been added so far: transmittance, and reflectance seen from behind
    before = AIR
    for k, index in enumerate([*indices, AIR]):
        r, cos_t = fresnel(cos, before, index)
        # Add an interface behind a stack: a geometric series between the two.
        series = 1 / (1 - back * r)
        passed, back = passed * series * (1 - r), r + (1 - r) ** 2 * back * series
        if k < len(indices):
            left = np.exp(-absorption[k] * depths[k] / cos_t)
            passed, back = passed * left, back * left**2
        cos, before = cos_t, index
    return passed


def beam(angle: float) -> dict[str, Any]:
    """An orthographic camera that looks down at the origin from an angle to the z axis, and a lamp below."""
    a = np.radians(angle)
    eye = [10 * np.sin(a), 0, 10 * np.cos(a)]
    lamp = {"type": "rectangle", "to_world": T().translate([0, 0, -8]).scale(200)}
    return {
        "sensor": {
            "type": "orthographic",
            "to_world": T().look_at(origin=eye, target=[0, 0, 0], up=[0, 1, 0]).scale(0.1),
            "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
        },
        "lamp": {**lamp, "emitter": {"type": "area", "radiance": 1.0}},
    }


@pytest.mark.parametrize("kind", ["cube", "mesh"])
@pytest.mark.parametrize("integrator", ["path", "volpath"])
@pytest.mark.parametrize("angle", [0.0, 50.0])
@pytest.mark.parametrize("wins", ["glass", "water"])
def test_slabs_that_overlap_pass_what_layers_do(wins: str, angle: float, integrator: str, kind: str) -> None:
    """Water from -1 to 0.4 and glass from 0 to 1: one of them fills what they share."""
    water: Any = slab(-1, 0.4, interface(WATER, absorption=0.3), priority=1.0 if wins == "water" else 0.0)
    glass = slab(0, 1, interface(GLASS, absorption=0.1), priority=0.5)
    water = as_mesh(water) if kind == "mesh" else water
    scene = {**beam(angle), "water": water, "glass": glass, "integrator": {"type": integrator}}
    border = 0.4 if wins == "water" else 0.0
    expected = stack(np.cos(np.radians(angle)), [GLASS, WATER], [1 - border, border + 1], [0.1, 0.3])
    image = rendered(scene, spp=1024)
    error = image[..., 0].std() / np.sqrt(image[..., 0].size)
    assert abs(image.mean() - expected) < 4 * error + 1e-4
    # The interface that isn't between air and water or glass matters.
    wrong = stack(np.cos(np.radians(angle)), [GLASS, AIR, WATER], [1 - border, 0, border + 1], [0.1, 0, 0.3])
    assert abs(image.mean() - wrong) > 8 * error


def test_edits_and_frozen_functions_know_the_indices() -> None:
    scene = {**beam(0.0), "water": slab(-1, 0.4, interface(WATER), priority=0.0), "integrator": {"type": "path"}}
    scene["glass"] = slab(0, 1, interface(GLASS), priority=0.5)
    loaded = djpt.load_dict({"type": "scene", **scene})
    render = dr.freeze(lambda scene, seed: djpt.render(scene, spp=1024, seed=seed))
    params = djpt.traverse(loaded)
    for index in (GLASS, 2.4):
        params["glass.bsdf.eta"] = index
        params.update()
        expected = stack(1.0, [index, WATER], [1, 1], [0, 0])
        for seed in (0, 1):
            image = np.array(render(loaded, dr.opaque(UInt32, seed)), np.float64)
            error = image[..., 0].std() / np.sqrt(image[..., 0].size)
            assert abs(image.mean() - expected) < 4 * error + 1e-4


def lit(**bodies: Any) -> dict[str, Any]:
    """Bodies before a wall with a pattern, under a sky."""
    pattern = {"type": "checkerboard", "color0": 0.1, "color1": 0.9, "to_uv": T().scale([12, 12, 1])}
    wall = {"type": "rectangle", "to_world": T().translate([0, 0, -3]).scale(6)}
    return {
        "sensor": {
            "type": "perspective",
            "fov": 32,
            "to_world": T().look_at(origin=[0, 1, 5], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 32, "height": 24, "rfilter": {"type": "box"}},
        },
        "sky": {"type": "constant"},
        "wall": {**wall, "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": pattern}}},
        "integrator": {"type": "volpath", "max_depth": 24},
        **bodies,
    }


def assert_same_samples(scene: dict[str, Any], other: dict[str, Any]) -> None:
    """Assert that two scenes have the same picture, but where rounding has turned a decision."""
    a, b = rendered(scene, spp=32), rendered(other, spp=32)
    assert (np.abs(a - b).max(axis=2) > 1e-3 * a.max(axis=2)).mean() < 0.05
    assert b.mean() == pytest.approx(a.mean(), rel=2e-3)


@pytest.mark.parametrize("kind", ["dielectric", "roughdielectric"])
def test_a_drop_in_glass_has_the_interface_of_both(kind: str) -> None:
    """The water's own BSDF is that of water in air; in a glass ball it is the one of water in glass."""
    water = {"type": kind, "int_ior": WATER, **({"alpha": 0.2} if kind == "roughdielectric" else {})}
    milk = {"type": "homogeneous", "sigma_t": 3.0, "albedo": colour(0.9, 0.8, 0.7)}
    exact = lit(glass=ball(1, interface(GLASS)), water=ball(0.7, {**water, "ext_ior": GLASS}, interior=milk))
    bodies = {"glass": ball(1, interface(GLASS), priority=0), "water": ball(0.7, {**water, "ext_ior": AIR})}
    bodies["water"] |= {"priority": 1, "interior": milk}
    assert_same_samples(exact, lit(**bodies))


@pytest.mark.parametrize("integrator", ["path", "volpath"])
def test_hidden_surfaces_cast_no_shadows(integrator: str) -> None:
    """A point light and a grey ball in one piece of glass, and a surface between them that isn't there."""
    scene = lit(
        glass=ball(1, interface(GLASS), priority=1),
        lamp={"type": "point", "position": [0, 0.8, 0.2], "intensity": 5.0},
        grey=ball(0.3, {"type": "diffuse"}),
        integrator={"type": integrator, "max_depth": 8},
    )
    alone = rendered(scene, spp=32)
    hidden = rendered({**scene, "hidden": ball(0.6, interface(WATER), priority=0)}, spp=32)
    assert hidden.mean() == pytest.approx(alone.mean(), rel=2e-3)
    assert alone.mean() > 1.05 * rendered({**scene, "hidden": ball(0.6, interface(WATER), priority=2)}, spp=32).mean()


def test_what_a_stronger_body_hides_isnt_there() -> None:
    """Neither to paths and shadow rays through glass, nor to light that is scattered."""
    milk = {"type": "homogeneous", "sigma_t": 3.0, "albedo": colour(0.9, 0.8, 0.7)}
    inner = ball(0.6, interface(GLASS, absorption=2.0), 0.2, priority=1)
    for body in (
        ball(1, interface(GLASS, absorption=0.2), priority=2),
        ball(1, interface(WATER), priority=2, interior=milk),
        ball(1, {"type": "null"}, priority=2, interior=milk),
    ):
        assert_same_samples(lit(body=body), lit(body=body, inner=inner))


def test_a_cache_of_light_knows_what_fills_a_place() -> None:
    milk = {"type": "homogeneous", "sigma_t": 8.0, "albedo": 0.95}
    milk_ball = ball(0.9, interface(WATER), priority=1, interior=milk)
    scene = lit(
        milk=milk_ball, glass=ball(1, interface(GLASS), priority=0), lump=ball(0.3, interface(1.9), priority=-1)
    )
    exact, cached = (rendered(scene, integrator=djpt.load_dict({"type": t})) for t in ("volpathmis", "volpathcache"))
    assert cached.mean() == pytest.approx(exact.mean(), rel=0.01)


def test_fog_ends_where_glass_begins() -> None:
    """A ball of glass that sticks out of fog, without a priority of its own above that of the fog, and with it."""
    fog = {"type": "homogeneous", "sigma_t": 1.5, "albedo": 0.5}
    cloud = ball(1.2, {"type": "null"}, -0.5, interior=fog)
    glass = ball(0.8, interface(1.0001), 0.5, priority=1)
    # Glass of the index of air is a hole in the fog: its interior is the vacuum.
    hole = ball(0.8, {"type": "null"}, 0.5, priority=1)
    image, expected = rendered(lit(cloud=cloud, body=glass)), rendered(lit(cloud=cloud, body=hole))
    assert image.mean() == pytest.approx(expected.mean(), rel=0.01)
    assert rendered(lit(cloud=cloud, body={**hole, "priority": -1})).mean() < 0.99 * image.mean()


def test_a_camera_in_a_body_knows_what_it_is_in() -> None:
    """From within water that overlaps the glass before it, straight through both to a lamp."""
    scene = beam(0.0)
    scene["sensor"] = {
        **scene["sensor"],
        "to_world": T().look_at(origin=[0, 0, -0.5], target=[0, 0, 1], up=[0, 1, 0]).scale(0.1),
    }
    scene["lamp"]["to_world"] = T().translate([0, 0, 8]).rotate([0, 1, 0], 180).scale(200)
    scene |= {"water": slab(-5, 0.4, interface(WATER, absorption=0.3), priority=1), "integrator": {"type": "path"}}
    scene["glass"] = slab(0, 1, interface(GLASS), priority=0)
    loaded = djpt.load_dict({"type": "scene", **scene})
    assert index_around(loaded, [0, 0, 0.2]) == pytest.approx(WATER)
    r1, r2 = fresnel(1, WATER, GLASS)[0], fresnel(1, GLASS, AIR)[0]
    passed = (1 - r1) * (1 - r2) / (1 - r1 * r2) * np.exp(-0.3 * 0.9)
    # Radiance is larger in the water, by the square of its index; light that is sent back twice is lost below.
    assert rendered(scene, spp=1024).mean() == pytest.approx(passed * WATER**2, rel=0.01)


@pytest.mark.parametrize("distance", [5.0, 3e4])
def test_searches_for_surfaces_end(distance: float) -> None:
    """Also for rays that end among hidden surfaces, or come from afar: smoke that absorbs nothing is invisible."""
    smoke = ball(1, {"type": "null"}, interior={"type": "homogeneous", "sigma_t": 1.0, "albedo": 1.0})
    hole = {"type": "cube", "to_world": T().translate([0, 0, 1]).scale(0.5), "bsdf": {"type": "null"}, "priority": 1}
    sensor = {
        "type": "perspective",
        "fov": float(np.degrees(4 / distance)),
        "far_clip": 1e6,
        "to_world": T().look_at(origin=[0, 0.3 * distance, distance], target=[0, 0, 0], up=[0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
    }
    scene = {"sensor": sensor, "sky": {"type": "constant"}, "smoke": smoke, "hole": hole}
    image = rendered({**scene, "integrator": {"type": "volpath", "max_depth": -1, "rr_depth": 1000}}, 1024)
    assert image.mean() == pytest.approx(1, rel=0.002)


def test_of_bodies_with_the_same_priority_the_first_is_around() -> None:
    small, large = ball(0.5, interface(WATER), priority=0), ball(1, interface(GLASS), priority=0)
    for first, second, index in ((small, large, WATER), (large, small, GLASS)):
        scene = djpt.load_dict({"type": "scene", **lit(a=first, b=second)})
        assert index_around(scene, [0.1, 0.2, 0.1]) == pytest.approx(index)
        assert index_around(scene, [0.1, 0.2, 0.1], {}) == pytest.approx(WATER)


def test_derivatives_follow_the_bodies() -> None:
    """The derivative by an absorption and an albedo is that of the difference of two images of the same seed."""
    milk = {"type": "homogeneous", "sigma_t": 3.0, "albedo": 0.7}
    scene = lit(
        milk=ball(0.8, interface(WATER), priority=1, interior=milk),
        glass=ball(0.6, interface(GLASS, absorption=0.5), 0.7, priority=0),
    )
    loaded = djpt.load_dict({"type": "scene", **scene})
    params = djpt.traverse(loaded)
    key = "milk.interior_medium.albedo.value.value"
    step = 0.01

    def mean(change: float) -> float:
        params[key] = type(params[key])(0.7 + change)
        params.update()
        return float(np.array(djpt.render(loaded, spp=256, seed=3)).mean())

    expected = (mean(step) - mean(-step)) / (2 * step)
    params[key] = type(params[key])(0.7)
    dr.enable_grad(params[key])
    params.update()
    image = djpt.render(loaded, params, spp=256, seed=3)
    dr.backward(dr.mean(image, axis=None))
    assert float(dr.sum(dr.grad(params[key]), axis=None)[0]) == pytest.approx(expected, rel=0.05)


def test_what_doesnt_follow_bodies_is_refused() -> None:
    scene = lit(glass=ball(1, interface(GLASS), priority=0))
    for integrator in ("bdpt", "ptracer", "sppm", "guided", "whitted", "direct"):
        with pytest.raises(RenderError, match="doesn't follow bodies that overlap"):
            rendered(
                {**scene, "lamp": {"type": "point", "position": [0, 3, 0]}}, 1, djpt.load_dict({"type": integrator})
            )
    with pytest.raises(RenderError, match="machine"):
        djpt.render(djpt.load_dict({"type": "scene", **scene}), spp=1, schedule="machine")


@pytest.mark.parametrize(
    ("shape", "why"),
    [
        ({"type": "rectangle", "bsdf": interface(GLASS), "priority": 0}, "must be closed"),
        (ball(1, {"type": "diffuse"}, priority=0), "can't have the BSDF"),
        (ball(1, interface(GLASS), priority=0, exterior={"type": "homogeneous"}), "can't have an 'exterior'"),
        ({"type": "shapegroup", "inner": ball(1, interface(GLASS), priority=0)}, "can't be instanced"),
    ],
)
def test_shapes_that_arent_bodies_are_refused(shape: dict[str, Any], why: str) -> None:
    with pytest.raises(SceneError, match=why):
        djpt.load_dict({"type": "scene", "shape": shape})


def test_scenes_without_priorities_are_as_before() -> None:
    scene = djpt.load_dict({"type": "scene", **lit(glass=ball(1, interface(GLASS)))})
    assert not scene.geometry.overlaps
    assert not scene.media

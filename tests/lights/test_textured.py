"""Area lights whose radiance varies: what they sample, with which density, and what is seen by their light."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import pytest
from scipy.stats import chi2

import djpt
from djpt.core.frame import Frame3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.description import registry
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Float, Point2f, TensorXf
from djpt.textures.bitmap import Bitmap
from tests.kit.chi_squared import SIGNIFICANCE, SPHERE, Domain, p_value, uniform
from tests.kit.emitters import RECTANGLE, UNLIKE_MITSUBA, entry
from tests.kit.kernels import kernels
from tests.kit.lit_floor import floor_scene
from tests.kit.one_light import TEXELS, TURNED, bitmap, lit, looked_at, reference
from tests.kit.plugins import EXAMPLES, SHEARED
from tests.kit.renders import ours, theirs

COUNT = 2**16
CONE = {"type": "cone", "apex": [0.5, 0.2, 1.2], "axis": [0, 1, 1], "angle": 30}


def shining(shape: dict[str, Any], texture: dict[str, Any]) -> dict[str, Any]:
    return {**shape, "emitter": {"type": "area", "radiance": texture}}


# ---------------------------------------------------------------- points of shapes


def known_by_uv() -> list[Any]:
    return [
        pytest.param({**values, "type": name}, id=f"{name}{i or ''}")
        for name, factory in registry.registered("shape").items()
        if registry.is_own(factory) and registry.lookup("shape", name).has_parameterization
        for i, values in enumerate(EXAMPLES[name])
    ]


def test_these_shapes_are_known_by_uv() -> None:
    names = {p.values[0]["type"] for p in known_by_uv()}
    assert names == {"rectangle", "disk", "sphere", "cylinder", "cone", "paraboloid"}


@pytest.mark.sparse(6)
@pytest.mark.parametrize("description", known_by_uv())
def test_points_have_their_uv(description: dict[str, Any]) -> None:
    """A ray onto the point at uv finds that uv, and dp/du, dp/dv that span the area of the density."""
    scene = lit(shape=description, light={"type": "constant"})
    # uv other than 0 and 1, where they wrap around.
    uv = Point2f(*(0.98 * x + 0.01 for x in uniform(4096)))
    ps = scene.shapes()[0].at_uv(uv)
    si = scene.ray_intersect(djpt.Ray3f(ps.p + 1e-2 * ps.n, -ps.n, maxt=Float(2e-2)))
    found = np.array(si.valid)
    assert found.mean() > 0.995
    assert np.abs(np.array(si.p - ps.p))[:, found].max() < 1e-4
    assert np.abs(np.array(si.uv - uv))[:, found].max() < 1e-3
    np.testing.assert_array_equal(np.array(ps.uv), np.array(uv))
    assert (np.broadcast_to(np.array(dr.dot(si.n, ps.n)), found.shape)[found] > 0.999).all()
    stretch = np.array(dr.norm(dr.cross(si.dp_du, si.dp_dv)) * ps.pdf)
    np.testing.assert_allclose(stretch[found], 1, rtol=2e-3)


# ---------------------------------------------------------------- directions

LIGHTS = {
    "rectangle": shining({"type": "rectangle", "to_world": SHEARED @ T().rotate([1, 0, 0], 180)}, bitmap()),
    "flipped rectangle": shining({"type": "rectangle", "to_world": SHEARED, "flip_normals": True}, bitmap()),
    "nearest": shining(EXAMPLES["rectangle"][0] | {"type": "rectangle"}, bitmap(filter_type="nearest")),
    "to_uv": shining(EXAMPLES["rectangle"][0] | {"type": "rectangle"}, bitmap(to_uv=TURNED)),
    "disk": shining(EXAMPLES["disk"][0] | {"type": "disk"}, bitmap()),
    "sphere": shining({"type": "sphere", "center": [0.5, 0.2, 2.0]}, bitmap()),
    "from within a sphere": shining({"type": "sphere", "radius": 3.0, "flip_normals": True}, bitmap(wrap_mode="clamp")),
    "cylinder": shining(EXAMPLES["cylinder"][0] | {"type": "cylinder"}, bitmap()),
    "cone": shining(CONE, bitmap()),
    "cube": shining(EXAMPLES["cube"][0] | {"type": "cube"}, bitmap()),
    "mesh": shining(EXAMPLES["ply"][0] | {"type": "ply"}, bitmap()),
    "checkerboard": shining(
        EXAMPLES["disk"][0] | {"type": "disk"}, {"type": "checkerboard", "color0": 3.0, "color1": 0.0}
    ),
}


def around(towards: Any) -> Any:
    """The part of the sphere about +z in which directions lie."""
    lowest = float(np.array(towards.z).min())
    low = max(-1.0, 1 - 1.2 * (1 - lowest))
    return Domain((low, 0), (1, 2 * np.pi), SPHERE.point, SPHERE.coordinates)


SMOOTH = ("rectangle", "flipped rectangle", "nearest", "to_uv", "cube", "mesh")
"""Their densities have no poles, as those of curved surfaces have where these are seen from the side."""


@pytest.mark.sparse(6)
@pytest.mark.parametrize("name", SMOOTH)
def test_directions_follow_the_density(name: str) -> None:
    scene = lit(light=LIGHTS[name])
    ds, weight = scene.sample_emitter_direction(reference(), Point2f(*uniform(2**18)), False)
    focus = Frame3f.from_normal(dr.normalize(dr.detach(dr.mean(ds.d, axis=1))))
    towards = focus.to_local(ds.d)

    def density(local: Any) -> Any:
        at, radiance, _ = looked_at(scene, focus.to_world(local))
        return dr.select(dr.max(radiance) > 0, scene.pdf_emitter_direction(reference(), at), 0)

    p, integral = p_value(around(towards), towards, dr.max(weight) > 0, density, fine=96)
    assert integral <= 1 + 5e-3
    assert p > SIGNIFICANCE


@pytest.mark.sparse(12)
@pytest.mark.parametrize("description", LIGHTS.values(), ids=LIGHTS)
def test_light_arrives_from_where_it_is_seen(description: dict[str, Any]) -> None:
    """Integrals of the radiance over cells of the sphere, by light sampling and by directions drawn uniformly."""
    scene = lit(light=description)
    ds, weight = scene.sample_emitter_direction(reference(), Point2f(*uniform(2**18)), True)
    focus = Frame3f.from_normal(dr.normalize(dr.detach(dr.mean(ds.d, axis=1))))
    towards = focus.to_local(ds.d)
    domain, bins = around(towards), (8, 10)
    z, phi = (low + np.array(u, np.float64) * (high - low) for u, low, high in zip(
        uniform(2**19, seed=2), domain.low, domain.high, strict=True))  # fmt: skip
    _, radiance, _ = looked_at(scene, focus.to_world(domain.point(z, phi)))
    area = np.prod(domain.high - domain.low)

    def integrals(place: Any, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """In each cell, and the variances."""
        edges = [
            np.linspace(*ends, n + 1) for ends, n in zip(zip(domain.low, domain.high, strict=True), bins, strict=True)
        ]
        sums = [np.histogram2d(*place, edges, weights=value**k)[0] / len(value) for k in (1, 2)]
        return sums[0], (sums[1] - sums[0] ** 2) / len(value)

    by_light, its_variance = integrals(domain.coordinates(towards), np.array(weight, np.float64)[0])
    by_chance, variance = integrals((z, phi), area * np.array(radiance, np.float64)[0])
    slack = (2e-3 * by_chance) ** 2 + (1e-5 * by_chance.max()) ** 2
    squares = (by_light - by_chance) ** 2 / (variance + its_variance + slack)
    # Cells with a handful of samples aren't normal.
    common = by_chance**2 > 100 * variance
    assert common.sum() > 20
    assert chi2.sf(squares[common].sum(), common.sum()) > SIGNIFICANCE
    total = np.sqrt(variance.sum() + its_variance.sum() + (2e-3 * by_chance.sum()) ** 2)
    assert abs(by_light.sum() - by_chance.sum()) < 4 * total


@pytest.mark.sparse(6)
@pytest.mark.parametrize("description", LIGHTS.values(), ids=LIGHTS)
def test_weights_are_radiance_over_density(description: dict[str, Any]) -> None:
    scene = lit(light=description)
    ds, weight = scene.sample_emitter_direction(reference(), Point2f(*uniform(4096, seed=3)), False)
    lit_up = np.array(dr.max(weight) > 0)
    assert lit_up.mean() > 0.1
    _, radiance, _ = looked_at(scene, ds.d)
    # What is seen may lie on the other side of an edge, and float32 knows uv only so well.
    agree = np.isclose(np.array(weight) * np.array(ds.pdf), np.array(radiance), rtol=1e-2, atol=1e-3).all(axis=0)
    assert agree[lit_up].mean() > 0.98
    again = np.array(scene.pdf_emitter_direction(reference(), ds))
    np.testing.assert_allclose(again[lit_up], np.array(ds.pdf)[lit_up], rtol=2e-3)
    np.testing.assert_allclose(np.array(ds.pdf * ds.weight)[lit_up], 1, rtol=1e-4)


@pytest.mark.parametrize("kind", ["bilinear", "nearest"])
def test_directions_are_mitsubas(kind: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    place = T().translate([0.3, 0.1, 2]).rotate([1, 0, 0], 160).scale([2, 1, 1])
    light = {"type": "rectangle", "to_world": place}
    mine = lit(light=shining(light, bitmap(filter_type=kind)))
    described = shining({"type": "rectangle", "to_world": mi.ScalarTransform4f(place.matrix.tolist())},
                        bitmap(filter_type=kind))  # fmt: skip
    other = mi.load_dict({"type": "scene", "light": described})
    sample = uniform(4096)
    ds, weight = mine.emitters()[0].sample_direction(djpt.Interaction3f(), Point2f(*sample))
    it = dr.zeros(mi.SurfaceInteraction3f)
    expected, value = other.emitters()[0].sample_direction(it, mi.Point2f(*sample))
    for a, b in ((ds.p, expected.p), (ds.d, expected.d), (ds.uv, expected.uv), (ds.dist, expected.dist)):
        np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-4)
    # Where bright and dark texels meet, rounding of uv counts.
    for mine_, theirs_ in ((ds.pdf, expected.pdf), (weight, value)):
        assert np.isclose(np.array(mine_), np.array(theirs_), rtol=1e-3, atol=1e-3).mean() > 0.995
    pdf, density = (
        mine.emitters()[0].pdf_direction(djpt.Interaction3f(), ds),
        other.emitters()[0].pdf_direction(it, expected),
    )
    assert np.isclose(np.array(pdf), np.array(density), rtol=1e-3, atol=1e-3).mean() > 0.995


# ---------------------------------------------------------------- rays from the light


@pytest.mark.sparse(6)
@pytest.mark.parametrize("description", LIGHTS.values(), ids=LIGHTS)
def test_rays_carry_the_power(description: dict[str, Any]) -> None:
    """The mean weight is pi times the integral of radiance over area; rays start on the surface, on its front."""
    scene = lit(light=description)
    emitter, shape = scene.emitters()[0], scene.shapes()[0]
    ray, weight = emitter.sample_ray(0, 0, Point2f(*uniform(COUNT)), Point2f(*uniform(COUNT, seed=1)))
    found = np.array(weight, np.float64)
    ps = shape.sample_position(0, Point2f(*uniform(COUNT, seed=2)))
    radiance = np.array(emitter.radiance.eval(ps), np.float64) * math.pi * float(shape.surface_area()[0])
    sigma = np.hypot(found.std(axis=1), radiance.std(axis=1)) / math.sqrt(COUNT)
    assert (np.abs(found.mean(axis=1) - radiance.mean(axis=1)) < 4 * sigma + 1e-3 * radiance.mean(axis=1)).all()
    si = scene.ray_intersect(djpt.Ray3f(ray.o + 1e-2 * ray.d, -ray.d, maxt=Float(2e-2)))
    hit = np.array(si.valid)
    assert hit.mean() > 0.95
    assert np.abs(np.array(si.p - ray.o))[:, hit].max() < 2e-3
    assert (np.array(dr.dot(si.sh_frame.n, ray.d)) > 0)[hit].mean() > 0.999


def test_rays_are_mitsubas() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    mine = lit(light=shining({"type": "rectangle", "to_world": SHEARED}, bitmap())).emitters()[0]
    place = mi.ScalarTransform4f(SHEARED.matrix.tolist())
    other = mi.load_dict({"type": "scene", "light": shining({"type": "rectangle", "to_world": place}, bitmap())})
    first, second = uniform(4096), uniform(4096, seed=1)
    ray, weight = mine.sample_ray(0, 0, Point2f(*first), Point2f(*second))
    expected, value = other.emitters()[0].sample_ray(0.0, 0.5, mi.Point2f(*first), mi.Point2f(*second))
    np.testing.assert_allclose(np.array(ray.d), np.array(expected.d), atol=1e-4)
    # Mitsuba moves the origin off the surface.
    np.testing.assert_allclose(np.array(ray.o), np.array(expected.o), atol=2e-3)
    assert np.isclose(np.array(weight), np.array(value), rtol=1e-3, atol=1e-3).mean() > 0.995


# ---------------------------------------------------------------- images


def seen(scene: dict[str, Any]) -> dict[str, Any]:
    """The light itself fills the picture."""
    scene["sensor"]["to_world"] = T().look_at(origin=[0, 0, 0], target=[-2, 3, 2.5], up=[0, 1, 0])
    return scene


@pytest.mark.parametrize("kind", ["bitmap", "nearest bitmap", "turned bitmap"])
@pytest.mark.sparse(4)
def test_the_light_itself_shows_its_texture(kind: str) -> None:
    """No BSDF looks at uv here: the light does."""
    pytest.importorskip("mitsuba")
    mine, other = (
        render(seen(floor_scene({"light": entry(f"area-{kind} rectangle")})), 16, 2) for render in (ours, theirs)
    )
    assert mine.std() > 0.5
    assert (np.abs(mine - other) < 1e-2 * (1 + other)).mean() > 0.99


def means(render: Any, scene: dict[str, Any], seeds: int, spp: int) -> tuple[np.ndarray, np.ndarray]:
    """Of the image's channels, over the seeds: mean, and its standard deviation."""
    values = np.array([render(scene, spp, seed).mean(axis=(0, 1), dtype=np.float64) for seed in range(seeds)])
    return values.mean(axis=0), values.std(axis=0, ddof=1) / math.sqrt(seeds)


@pytest.mark.slow
@pytest.mark.parametrize("name", UNLIKE_MITSUBA)
def test_images_have_the_mean_of_paths_that_find_the_light(name: str) -> None:
    """Mitsuba without light sampling is the reference."""
    pytest.importorskip("mitsuba")
    by_light = floor_scene({"light": entry(name)}, size=32, integrator={"type": "path", "max_depth": 2})
    by_chance = floor_scene(
        {"light": entry(name)}, size=32, integrator={"type": "direct", "emitter_samples": 0, "bsdf_samples": 32}
    )
    renderer = djpt.validation.mitsuba_renderer(by_chance, optimize=False)
    mine, sigma = means(ours, by_light, 8, 64)
    other, theirs_sigma = means(lambda scene, spp, seed: renderer(spp, seed), by_chance, 8, 32)
    assert (theirs_sigma < 0.05 * other).all()
    assert (np.abs(mine - other) < 4 * np.hypot(sigma, theirs_sigma)).all()


def test_one_bright_texel_makes_little_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compared with points all over the light."""
    texels = np.full((32, 32, 1), 0.01, np.float32)
    texels[20, 9] = 2000
    scene = floor_scene(
        {"light": shining(RECTANGLE, bitmap(texels))}, size=32, integrator={"type": "path", "max_depth": 2}
    )

    def noise() -> tuple[float, float]:
        images = np.array([ours(scene, 16, seed) for seed in range(16)], np.float64)
        return images.mean(), float(np.sqrt(images.var(axis=0).mean())) / images.mean()

    mean, small = noise()
    monkeypatch.setattr(Bitmap, "prepare_sampling", lambda self: None)
    scene["light"]["emitter"]["radiance"] = bitmap(texels)
    other, large = noise()
    assert mean == pytest.approx(other, rel=0.2)
    assert large > 5 * small


# ---------------------------------------------------------------- edits and errors


def test_edits_reach_the_density() -> None:
    """An edited light looks like one that was loaded that way, also with another size and another `to_uv`."""
    scene = djpt.load_dict(floor_scene({"light": shining(RECTANGLE, bitmap())}, size=16))
    params = djpt.traverse(scene)
    assert {key for key in params if key.startswith("light.emitter")} == {
        "light.emitter.sampling_weight", "light.emitter.radiance.data", "light.emitter.radiance.to_uv"
    }  # fmt: skip
    key = "light.emitter.radiance."
    rng = np.random.default_rng(6)
    for shape, to_uv in (((5, 7, 3), None), ((9, 3, 3), None), ((9, 3, 3), TURNED), ((5, 7, 3), T())):
        texels = (5 * rng.random(shape) ** 4).astype(np.float32)
        params[f"{key}data"] = texels
        if to_uv is not None:
            params[f"{key}to_uv"] = to_uv
        params.update()
        now = params[f"{key}to_uv"]
        fresh = djpt.load_dict(floor_scene({"light": shining(RECTANGLE, bitmap(texels, to_uv=now))}, size=16))
        np.testing.assert_allclose(
            np.array(djpt.render(scene, spp=4, seed=1)), np.array(djpt.render(fresh, spp=4, seed=1)), rtol=1e-4
        )


def test_an_edit_compiles_no_kernel() -> None:
    scene = djpt.load_dict(floor_scene({"light": shining(RECTANGLE, bitmap())}, size=16))
    params = djpt.traverse(scene)
    key = "light.emitter.radiance.data"

    def draw() -> Any:
        return np.array(djpt.render(scene, spp=4))

    before = kernels(draw)
    for factor in (0.5, 0.0, 2.0):
        params[key] = TensorXf(factor * np.roll(TEXELS, 1, axis=0))
        params.update()
        assert kernels(draw) <= before


def test_a_light_without_any_light() -> None:
    """It is black, not NaN, and can be made brighter."""
    scene = djpt.load_dict(floor_scene({"light": shining(RECTANGLE, bitmap(0 * TEXELS))}, size=16))
    np.testing.assert_array_equal(np.array(djpt.render(scene, spp=4)), 0)
    params = djpt.traverse(scene)
    params["light.emitter.radiance.data"] = TEXELS
    params.update()
    bright = djpt.load_dict(floor_scene({"light": shining(RECTANGLE, bitmap())}, size=16))
    np.testing.assert_array_equal(np.array(djpt.render(scene, spp=4)), np.array(djpt.render(bright, spp=4)))


def test_negative_radiance_is_refused() -> None:
    texels = TEXELS.copy()
    texels[1, 2, 0] = -0.5
    with pytest.raises(SceneError, match=r"'radiance' must be at least 0, found -0\.5"):
        lit(light=shining(RECTANGLE, bitmap(texels)))
    params = djpt.traverse(lit(light=shining(RECTANGLE, bitmap())))
    with pytest.raises(ParameterError, match=r"radiance\.data.* must be at least 0, found -0\.5"):
        params["light.emitter.radiance.data"] = texels


def test_paint_needs_no_density() -> None:
    assert djpt.load_dict({"type": "diffuse", "reflectance": bitmap(TEXELS / 6)}).reflectance.distribution is None


def test_one_texture_for_a_light_and_a_wall() -> None:
    scene = floor_scene(
        {"picture": bitmap(TEXELS / 6), "light": shining(RECTANGLE, {"type": "ref", "id": "picture"})}, size=16
    )
    scene["floor"]["bsdf"] = {"type": "diffuse", "reflectance": {"type": "ref", "id": "picture"}}
    loaded = djpt.load_dict(scene)
    params = djpt.traverse(loaded)
    params["picture.data"] = 0.5 * TEXELS[::-1] / 6
    params.update()
    scene["picture"] = bitmap(0.5 * TEXELS[::-1] / 6)
    np.testing.assert_allclose(
        np.array(djpt.render(loaded, spp=4)), np.array(djpt.render(djpt.load_dict(scene), spp=4)), rtol=1e-5
    )


@pytest.mark.parametrize("shapes", [((5, 7, 3), (5, 7, 3)), ((5, 7, 3), (6, 8, 3)), ((5, 7, 3), (40, 3, 1))], ids=str)
@pytest.mark.sparse(4)
def test_lights_keep_their_pictures_apart(shapes: Any) -> None:
    """Two lights that are traced as one, or as two."""
    pytest.importorskip("mitsuba")

    def scene() -> dict[str, Any]:
        there = T().look_at(origin=[2, 3, 1.5], target=[0, 0, 0], up=[0, 1, 0]).scale(0.5)
        places = ({}, {"to_world": there})
        lamps = [
            shining(
                {**RECTANGLE, **place}, bitmap((5 * np.random.default_rng(k).random(shape) ** 3).astype(np.float32))
            )
            for k, (shape, place) in enumerate(zip(shapes, places, strict=True))
        ]
        return floor_scene({"first": lamps[0], "second": lamps[1]}, size=32)

    mine, other = ours(scene(), 8, 1), theirs(scene(), 8, 1)
    assert djpt.validation.agreement(mine, other, 1e-3).share >= 0.95

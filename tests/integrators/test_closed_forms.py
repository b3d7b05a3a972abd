"""Radiance that formulas give: the table of closed forms, cut off and bounce by bounce, and light on a whole floor.

An image passes if Welch's test of its mean, and then that of all pixels, finds nothing but noise (false alarms: 1e-4
each), or if it is right to 1e-4 of the radiance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation.closed_forms import CASES
from djpt.validation.closed_forms.cases import ALBEDO, GREY, area, camera, floor, parallel_rectangle
from djpt.validation.statistics import Batches, mean_test, pixel_test
from tests.kit.renders import ours

pytestmark = pytest.mark.cuda

Array = np.ndarray
Keys = dict[str, Any]
BATCHES = 16
UNIFORM, COSINE = {"type": "path_naive", "hemisphere": "uniform"}, {"type": "path_naive", "hemisphere": "cosine"}
# Russian roulette only in `path_nee`, which has its own parameter for it.
BY_CHANCE: list[Keys] = [{**UNIFORM, "rr_depth": 99}, {**COSINE, "rr_depth": 99}, {"type": "prb_basic"}]
BY_LIGHT_SAMPLES: list[Keys] = [
    {"type": "path_nee"},
    {"type": "path_nee", "russian_roulette": 1.0},
    {"type": "path", "rr_depth": 99},
    {"type": "prb", "rr_depth": 99},
    {"type": "distributed", "split": 1, "light_samples": 2},
]
FROM_LIGHTS: list[Keys] = [{"type": "ptracer", "rr_depth": 99}, {"type": "bdpt", "rr_depth": 99}]


def render(scene: Keys, integrator: Keys, depth: int, spp: int) -> Batches:
    """Independent images, `spp` samples per pixel in all."""
    loaded, limit = djpt.load_dict(scene), {} if integrator["type"] == "direct" else {"max_depth": depth}
    plugin, result = djpt.load_dict({**integrator, **limit}), Batches()
    for k in range(BATCHES):
        result.add(np.array(djpt.render(loaded, integrator=plugin, spp=max(1, spp // BATCHES), seed=11 + k)))
    return result


def check(images: Batches, expected: Array | float, exact: float = 1e-4) -> None:
    """Assert that the mean is `expected` (per pixel and channel, or for all), up to noise or `exact` of the largest."""
    known = Batches()
    for _ in range(2):
        known.add(np.broadcast_to(expected, images.shape))
    difference = images.mean - known.mean
    for test, error in ((mean_test, difference.mean(axis=(0, 1))), (pixel_test, difference)):
        result = test(images, known, 1e-4, equal_variance=False)
        assert result.passed or np.abs(error).max() <= exact * known.mean.max(), f"{result}, off by {error.mean()}"


# ---------------------------------------------------------------- the table: its terms


DEPTHS = {"slab of glass": (1, 2, 3, 6, 9, 16), "thin pane": (1, 2), "mirrored lamp": (1, 2)}
"""Where paths end; in the other cases: 1, 2, 5."""

SETTINGS: list[Keys] = [*BY_CHANCE, *BY_LIGHT_SAMPLES, *FROM_LIGHTS, {"type": "whitted"}, {"type": "direct"}]
CUT_OFF = [
    pytest.param(name, integrator, depth, marks=pytest.mark.slow if depth == 1 else ())
    for name, case in CASES.items()
    if case.terms and name != "facing plates"
    for depth in DEPTHS.get(name, (1, 2, 5))
    for integrator in SETTINGS
    # Direct light needs two edges.
    if integrator["type"] in case.integrators and (depth == 2 or integrator["type"] != "direct")
]


@pytest.mark.sparse(104)
@pytest.mark.parametrize(("name", "integrator", "depth"), CUT_OFF, ids=str)
def test_paths_end(name: str, integrator: Keys, depth: int) -> None:
    """The light of paths of at most `depth` edges."""
    case = CASES[name]
    check(render(case.scene(), integrator, depth, 1024), sum(case.terms[:depth]), case.exact)


@pytest.mark.sparse(4)
@pytest.mark.parametrize(
    ("name", "integrator"),
    [
        *(("shining sphere", integrator) for integrator in [*BY_CHANCE, *BY_LIGHT_SAMPLES[:-1]]),
        ("integrating sphere", BY_LIGHT_SAMPLES[2]),
    ],
    ids=str,
)
def test_bounces(name: str, integrator: Keys) -> None:
    """The light of paths of 1, 2, .. edges, each in channels of its own."""
    case = CASES[name]
    images = render(case.scene(), {**integrator, "bounces": True}, case.depth, 512)
    check(images, np.repeat([case.radiance, *case.terms], 3), case.exact)


@pytest.mark.parametrize("name", ["shining sphere", "shining box"])
@pytest.mark.sparse(2)
def test_furnaces_by_direct_light(name: str) -> None:
    case = CASES[name]
    for samples in ({"shading_samples": 2}, {"emitter_samples": 0, "bsdf_samples": 1}):
        check(render(case.scene(), {"type": "direct", **samples}, 2, 512), sum(case.terms[:2]), case.exact)


@pytest.mark.parametrize("integrator", ["whitted", "direct"])
def test_first_reflection_in_a_sphere(integrator: str) -> None:
    case = CASES["integrating sphere"]
    check(render(case.scene(), {"type": integrator}, 4, 16), sum(case.terms[:2]))


# ---------------------------------------------------------------- rooms without an end


@pytest.mark.sparse(3)
@pytest.mark.parametrize("integrator", ["path_nee", "path", "guided", "ptracer", "bdpt"])
def test_endless_integrating_sphere(integrator: str) -> None:
    """I rho / (pi R^2 (1 - rho)), with roulette and nothing else to end a path."""
    case = CASES["integrating sphere"]
    check(render(case.scene(), {"type": integrator}, -1, 1024), case.terms[1] / (1 - GREY))


def test_endless_furnace_under_roulette() -> None:
    scene = djpt.scenes.furnace(0.5, 1.0)
    scene["integrator"] = {"type": "path", "max_depth": -1, "rr_depth": 2}
    scene["sensor"]["film"].update(width=24, height=24)
    assert ours(scene, 64).mean() == pytest.approx(2.0, rel=6e-3)


def test_gradient_of_a_furnace() -> None:
    """With n edges: d/da of e sum_{k<n} a^k = e sum k a^(k-1), and d/de = sum a^k."""
    albedo, radiance, depth = 0.5, 1.0, 4
    scene = djpt.scenes.furnace(albedo, radiance)
    scene["integrator"] = {"type": "prb", "max_depth": depth, "rr_depth": 1000}
    scene["sensor"]["film"].update(width=16, height=16)
    loaded = djpt.load_dict(scene)
    params = djpt.traverse(loaded)
    names = [name for name in params if name.endswith(("reflectance.value", "radiance.value"))]
    for name in names:
        dr.enable_grad(params[name])
    params.update()
    dr.backward(dr.mean(djpt.render(loaded, params, spp=256).array))
    by_albedo, by_radiance = (
        sum(float(np.sum(np.array(dr.grad(params[name])))) for name in names if kind in name)
        for kind in ("reflectance", "radiance")
    )
    assert by_albedo == pytest.approx(sum(k * albedo ** (k - 1) for k in range(1, depth)) * radiance, rel=1e-2)
    assert by_radiance == pytest.approx(sum(albedo**k for k in range(depth)), rel=1e-2)


@pytest.mark.parametrize("albedo", [0.0, 0.4, 1.0])
def test_convex_body_under_a_constant_sky(albedo: float) -> None:
    """A sphere returns a e from everywhere: it vanishes against the sky at a = 1."""
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": albedo}}
    sky = {"type": "constant", "radiance": 2.0}
    scene = {"type": "scene", "ball": ball, "sky": sky, "sensor": camera((0, 0, 0), (0, 0, 5), size=16, fov=10.0)}
    scene["integrator"] = {"type": "path", "max_depth": 3, "rr_depth": 1000}
    image = ours(scene, 512)
    assert image.mean() == pytest.approx(2.0 * albedo, rel=3e-3, abs=1e-7)


# ---------------------------------------------------------------- one point of a floor


def on_the_floor(integrator: Keys, **lights: Any) -> Keys:
    return floor(**lights) | {"integrator": integrator}


PATH: Keys = {"type": "path", "max_depth": 2}


@pytest.mark.parametrize("count", [2, 5])
def test_point_light_with_several_samples(count: int) -> None:
    """Their mean. Mitsuba 3.9.1 adds up the samples of lights without extent."""
    integrator = {"type": "direct", "emitter_samples": count, "bsdf_samples": 0}
    scene = on_the_floor(integrator, light={"type": "point", "position": [0, 0, 2.0], "intensity": 3.0})
    expected = ALBEDO / math.pi * 3.0 / 2.0**2
    np.testing.assert_allclose(ours(scene, 4), expected, rtol=1e-3)


@pytest.mark.parametrize("integrator", [PATH, {"type": "direct"}], ids=str)
def test_box_overhead(integrator: Keys) -> None:
    """L = a e F of its lower face, a corner of which is over the point."""
    a, b, c = 1.5, 0.8, 0.7
    # Flat: the side faces hardly shine down.
    to_world = T().translate([a / 2, b / 2, c + 1e-4]).scale([a / 2, b / 2, 1e-4])
    scene = on_the_floor(integrator, lamp={"type": "cube", "to_world": to_world, "emitter": area(4.0)})
    assert ours(scene, 1024).mean() == pytest.approx(ALBEDO * 4.0 * parallel_rectangle(a, b, c), rel=5e-3)


@pytest.mark.parametrize(("height", "aside", "radius"), [(3.0, 0.0, 2.5), (1, 1, 1e-3)])
def test_large_and_small_spheres(height: float, aside: float, radius: float) -> None:
    """F = (r / d)^2 cos for a sphere all above the horizon."""
    lamp = {"type": "sphere", "center": [aside, 0, height], "radius": radius, "emitter": area(4.0)}
    squared = height**2 + aside**2
    factor = radius**2 / squared * height / math.sqrt(squared)
    assert ours(on_the_floor(PATH, lamp=lamp), 1024).mean() == pytest.approx(ALBEDO * 4.0 * factor, rel=4e-3)


def test_light_shines_from_its_front_only() -> None:
    place = T().translate([0.75, 0.4, 0.7]).rotate([1, 0, 0], 180).scale([0.75, 0.4, 1])
    lamp = {"type": "rectangle", "to_world": place, "flip_normals": True, "emitter": area(4.0)}
    assert (ours(on_the_floor(PATH, lamp=lamp), 16) == 0).all()


# ---------------------------------------------------------------- a square of a floor, under every integrator


def sphere(x: Array, y: Array) -> Array:
    """Form factor of a floor point to a sphere of radius 0.4 about (0.2, 0.1, 1.2): (r / d)^2 cos."""
    squared = (x - 0.2) ** 2 + (y - 0.1) ** 2 + 1.2**2
    return 0.4**2 / squared * 1.2 / np.sqrt(squared)


def disk(x: Array, y: Array) -> Array:
    """To a disk of radius 0.5 about (0.2, 0.1, 1): Howell's *Catalog*, B-13."""
    aside, height, radius = (x - 0.2) ** 2 + (y - 0.1) ** 2, 1.0, 0.5
    sum_ = aside + height**2 + radius**2
    return (1 - (sum_ - 2 * radius**2) / np.sqrt(sum_**2 - 4 * radius**2 * aside)) / 2


@np.vectorize
def rectangle(x: float, y: float) -> float:
    """To a rectangle [-0.3, 0.7] x [-0.5, 0.5] at height 1: four with a corner over the point, some negative."""

    def from_corner(a: float, b: float) -> float:
        return math.copysign(parallel_rectangle(abs(a), abs(b), 1.0), a * b)

    x0, x1, y0, y1 = -0.3 - x, 0.7 - x, -0.5 - y, 0.5 - y
    return from_corner(x1, y1) - from_corner(x0, y1) - from_corner(x1, y0) + from_corner(x0, y0)


def point(x: Array, y: Array) -> Array:
    """A point light of intensity 3 at (0.2, 0.1, 1): cos / r^2, times I / (pi e)."""
    squared = (x - 0.2) ** 2 + (y - 0.1) ** 2 + 1
    return 3.0 / (math.pi * 4.0) / squared**1.5


def sunlight(x: Array, y: Array) -> Array:
    """Parallel light of irradiance 2, 60 degrees from the zenith: cos / pi, by e."""
    return np.full_like(x, 2.0 * 0.5 / math.pi / 4.0)


def sky(x: Array, y: Array) -> Array:
    """All that is above."""
    return np.ones_like(x)


DOWN = T().translate([0.2, 0.1, 1.0]).rotate([1, 0, 0], 180).scale(0.5)


LAMPS: dict[Callable[[Array, Array], Array], Keys] = {
    sphere: {"type": "sphere", "center": [0.2, 0.1, 1.2], "radius": 0.4, "emitter": area(4.0)},
    disk: {"type": "disk", "to_world": DOWN, "emitter": area(4.0)},
    rectangle: {
        "type": "rectangle",
        "to_world": T().translate([0.2, 0, 1]).rotate([1, 0, 0], 180).scale(0.5),
        "emitter": area(4.0),
    },
    point: {"type": "point", "position": [0.2, 0.1, 1.0], "intensity": 3.0},
    sunlight: {"type": "directional", "direction": [math.sqrt(0.75), 0, -0.5], "irradiance": 2.0},
    sky: {"type": "constant", "radiance": 4.0},
}
"""Form factor F of the light that is seen from the floor -> the light, of radiance e = 4."""


DELTA = (point, sunlight)


SIZE = 6


def floor_under(lamp: Keys) -> Keys:
    """The square [-1, 1]^2 of a diffuse floor, seen straight from above and from below the lamp."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    to_world = T().look_at([0, 0, 0.5], [0, 0, 0], [0, 1, 0])
    floor = {"type": "rectangle", "to_world": T().scale(1.5), "bsdf": {"type": "diffuse", "reflectance": ALBEDO}}
    sensor = {"type": "orthographic", "to_world": to_world, "film": film}
    return {"type": "scene", "sensor": sensor, "floor": floor, "lamp": lamp}


def on_the_film(factor: Callable[[Array, Array], Array], samples: int = 16) -> Array:
    """The pixels' averages of a function of the floor's x and y, by the midpoint rule: (SIZE, SIZE, 1).

    Columns follow x, rows go against y.
    """
    middles = 2 * (np.arange(SIZE * samples) + 0.5) / (SIZE * samples) - 1
    y, x = np.meshgrid(-middles, middles, indexing="ij")
    return factor(x, y).reshape(SIZE, samples, SIZE, samples).mean(axis=(1, 3))[..., None]


def those_that_see(factor: Callable[[Array, Array], Array]) -> list[Keys]:
    more = [{"type": "direct"}, *FROM_LIGHTS]
    if factor in DELTA:
        return [*BY_LIGHT_SAMPLES, {"type": "whitted"}, *more]
    return [*BY_CHANCE, *BY_LIGHT_SAMPLES, *more]


@pytest.mark.sparse(64)
@pytest.mark.parametrize(
    ("factor", "integrator"),
    [(factor, integrator) for factor in LAMPS for integrator in those_that_see(factor)],
    ids=lambda x: getattr(x, "__name__", str(x)),
)
def test_light_on_a_floor(factor: Callable[[Array, Array], Array], integrator: Keys) -> None:
    """L = a e F, pixel by pixel."""
    spp = 16384 if integrator["type"] != "distributed" else 4096
    check(render(floor_under(LAMPS[factor]), integrator, 2, spp), ALBEDO * 4.0 * on_the_film(factor))


@pytest.mark.parametrize("shape", ["rectangle", "disk"])
def test_whitted_lamp_is_a_point(shape: str) -> None:
    """A lamp's light comes from its middle: a e A / (pi h^2) below it."""
    lamp = {"type": shape, "to_world": T().translate([0, 0, 2]).rotate([1, 0, 0], 180).scale(0.5), "emitter": area(4.0)}
    scene = floor_under(lamp)
    scene["sensor"] = camera((0, 0, 0), (0.5, 0, 1))
    surface = 1.0 if shape == "rectangle" else math.pi / 4
    check(render(scene, {"type": "whitted"}, 1, 16), ALBEDO * 4.0 * surface / (math.pi * 2**2))

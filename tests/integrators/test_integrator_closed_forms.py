"""Scenes whose radiance is known by formula, under every integrator that should find it.

`test_closed_forms.py` has more scenes, for `path`. An image passes if Welch's test of its mean, and then that of all
pixels, finds nothing but noise (false alarms: 1e-4 each), or if it is right to 1e-4 of the radiance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.transforms import ScalarTransform4f as T
from djpt.validation.statistics import Batches, mean_test, pixel_test
from tests.integrators.test_closed_forms import ALBEDO, area, look_at, parallel_rectangle

Array = np.ndarray
Keys = dict[str, Any]

BATCHES = 16

UNIFORM, COSINE = {"type": "path_naive", "hemisphere": "uniform"}, {"type": "path_naive", "hemisphere": "cosine"}
# Roulette only in `path_nee`, whose is its own.
BY_CHANCE: list[Keys] = [{**UNIFORM, "rr_depth": 99}, {**COSINE, "rr_depth": 99}, {"type": "prb_basic"}]
BY_LIGHT_SAMPLES: list[Keys] = [
    {"type": "path_nee"},
    {"type": "path_nee", "russian_roulette": 1.0},
    {"type": "path", "rr_depth": 99},
    {"type": "prb", "rr_depth": 99},
    {"type": "distributed", "split": 1, "light_samples": 2},
]
FROM_LIGHTS: list[Keys] = [{"type": "ptracer", "rr_depth": 99}]


def render(scene: Keys, integrator: Keys, depth: int, spp: int) -> Batches:
    """Independent images, `spp` samples per pixel in all."""
    loaded, limit = djpt.load_dict(scene), {} if integrator["type"] == "direct" else {"max_depth": depth}
    plugin, result = djpt.load_dict({**integrator, **limit}), Batches()
    for k in range(BATCHES):
        result.add(np.array(djpt.render(loaded, integrator=plugin, spp=max(1, spp // BATCHES), seed=11 + k)))
    return result


def check(images: Batches, expected: Array | float, exact: float = 1e-4) -> None:
    """The images' mean is `expected` (per pixel and channel, or for all), up to noise or to `exact` of the largest."""
    known = Batches()
    for _ in range(2):
        known.add(np.broadcast_to(expected, images.shape))
    difference = images.mean - known.mean
    for test, error in ((mean_test, difference.mean(axis=(0, 1))), (pixel_test, difference)):
        result = test(images, known, 1e-4, equal_variance=False)
        assert result.passed or np.abs(error).max() <= exact * known.mean.max(), f"{result}, off by {error.mean()}"


# ---------------------------------------------------------------- furnaces


def shining_sphere(albedo: float, size: int = 12) -> Keys:
    """The inside of a diffuse sphere that shines with radiance 1."""
    shell = {
        "type": "sphere",
        "radius": 2.0,
        "flip_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": albedo},
        "emitter": area(1.0),
    }
    sensor = look_at((0, 0, 0), (0.3, 0.2, 1), size=size, fov=60.0)
    return {"type": "scene", "sensor": sensor, "shell": shell}


def shining_box(albedo: float, size: int = 12) -> Keys:
    """The built-in furnace, small."""
    scene = djpt.scenes.furnace(albedo, 1.0)
    scene["sensor"]["film"].update(width=size, height=size)
    return scene


FURNACES: list[tuple[Callable[..., Keys], Keys]] = [
    *((shining_sphere, integrator) for integrator in (*BY_CHANCE, *BY_LIGHT_SAMPLES, *FROM_LIGHTS)),
    # Without `path_nee`: in the corners of the box its variance is infinite.
    *((shining_box, integrator) for integrator in (*BY_CHANCE, *BY_LIGHT_SAMPLES[2:], *FROM_LIGHTS)),
]

NEAR = 3e-4
"""How exact the sphere is: a ray that leaves its wall at a low angle comes back so soon that the distance by which it
is moved off the wall counts. Half of a radiance of 1 + a comes from MIS weights, which look at the distance."""


@pytest.mark.parametrize(("furnace", "integrator"), FURNACES, ids=lambda x: getattr(x, "__name__", str(x)))
@pytest.mark.parametrize("depth", [1, 2, 5])
def test_furnace(furnace: Callable[..., Keys], integrator: Keys, depth: int) -> None:
    """1 + a + .. + a^(depth - 1)."""
    albedo = 0.7
    check(render(furnace(albedo), integrator, depth, 512), sum(albedo**k for k in range(depth)), NEAR)


@pytest.mark.parametrize("furnace", [shining_sphere, shining_box])
def test_furnace_by_direct_light(furnace: Callable[..., Keys]) -> None:
    for samples in ({"shading_samples": 2}, {"emitter_samples": 0, "bsdf_samples": 1}):
        check(render(furnace(0.7), {"type": "direct", **samples}, 2, 512), 1.7, NEAR)


@pytest.mark.parametrize("integrator", [*BY_CHANCE, *BY_LIGHT_SAMPLES[:-1]], ids=str)
def test_bounces_of_a_furnace(integrator: Keys) -> None:
    """Light that was scattered k times: a^k."""
    depth, albedo = 5, 0.7
    images = render(shining_sphere(albedo), {**integrator, "bounces": True}, depth, 512)
    terms = [albedo**k for k in range(depth)]
    check(images, np.repeat([sum(terms), *terms], 3), NEAR)


# ---------------------------------------------------------------- a point light in a sphere


def lamp_in_a_sphere(albedo: float) -> Keys:
    """In the centre of a diffuse sphere of radius 2, intensity 3."""
    scene = shining_sphere(albedo)
    del scene["shell"]["emitter"]
    return {**scene, "lamp": {"type": "point", "position": [0, 0, 0], "intensity": 3.0}}


@pytest.mark.parametrize("integrator", [*BY_LIGHT_SAMPLES, *FROM_LIGHTS], ids=str)
@pytest.mark.parametrize("depth", [1, 2, 3, 6])
def test_integrating_sphere(integrator: Keys, depth: int) -> None:
    """I / (pi R^2) (a + a^2 + .. + a^(depth - 1)), the same everywhere; a / (1 - a) in the limit.

    The lamp's irradiance I / R^2 is constant, so the radiance after one reflection is a / pi of it. A uniform
    radiance L on the wall of a sphere has the irradiance pi L at every point, so each further reflection is a times
    the one before.
    """
    albedo = 0.8
    expected = 3.0 / (math.pi * 2.0**2) * sum(albedo**k for k in range(1, depth))
    check(render(lamp_in_a_sphere(albedo), integrator, depth, 512), expected)


@pytest.mark.parametrize("integrator", [{"type": "path_nee"}, {"type": "path"}, {"type": "ptracer"}], ids=str)
def test_endless_integrating_sphere(integrator: Keys) -> None:
    """I a / (pi R^2 (1 - a)), with roulette and nothing else to end a path."""
    albedo = 0.6
    expected = 3.0 / (math.pi * 2.0**2) * albedo / (1 - albedo)
    check(render(lamp_in_a_sphere(albedo), integrator, -1, 1024), expected)


@pytest.mark.parametrize("integrator", [{"type": "whitted"}, {"type": "direct"}], ids=str)
def test_first_reflection_in_a_sphere(integrator: Keys) -> None:
    check(render(lamp_in_a_sphere(0.8), integrator, 4, 16), 0.8 * 3.0 / (math.pi * 2.0**2))


def test_bounces_in_a_sphere() -> None:
    depth, albedo = 5, 0.8
    images = render(lamp_in_a_sphere(albedo), {"type": "path", "bounces": True, "rr_depth": 99}, depth, 256)
    terms = [0.0, *(3.0 / (math.pi * 2.0**2) * albedo**k for k in range(1, depth))]
    check(images, np.repeat([sum(terms), *terms], 3))


# ---------------------------------------------------------------- lights over a floor


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
    scene["sensor"] = look_at((0, 0, 0), (0.5, 0, 1))
    surface = 1.0 if shape == "rectangle" else math.pi / 4
    check(render(scene, {"type": "whitted"}, 1, 16), ALBEDO * 4.0 * surface / (math.pi * 2**2))


# ---------------------------------------------------------------- glass and mirrors

ABOVE, BELOW = 2.0, 5.0
ALONG: list[Keys] = [{"type": "whitted"}, *BY_CHANCE, *BY_LIGHT_SAMPLES[1:4], {"type": "distributed", "split": 1}]
"""Integrators that follow mirrors and panes to where there is light."""


def fresnel(angle: float, ior: float) -> float:
    """Reflectance of unpolarised light at an interface; `angle` in degrees, outside."""
    outside, inside = math.cos(math.radians(angle)), math.sqrt(1 - (math.sin(math.radians(angle)) / ior) ** 2)
    perpendicular = (outside - ior * inside) / (outside + ior * inside)
    parallel = (ior * outside - inside) / (ior * outside + inside)
    return (perpendicular**2 + parallel**2) / 2


def pane(angle: float, **shape: Any) -> Keys:
    """A pane z < 0 between a sky of radiance ABOVE and a black floor that shines with BELOW."""
    a = math.radians(angle)
    return {
        "type": "scene",
        "sensor": look_at((0, 0, 0), (3 * math.sin(a), 0, 3 * math.cos(a)), up=(0, 1, 0)),
        "sky": {"type": "constant", "radiance": ABOVE},
        "pane": shape,
        "floor": {
            "type": "rectangle",
            "to_world": T().translate([0, 0, -1]).scale(20.0),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": area(BELOW),
        },
    }


@pytest.mark.parametrize("integrator", ALONG, ids=str)
@pytest.mark.parametrize("depth", [1, 2, 3, 6, 9, 16])
def test_slab_of_glass(depth: int, integrator: Keys) -> None:
    """Light that was reflected inside 0, 1, .. times, as far as `depth` goes.

    Up: R + T^2 R (1 + R^2 + ..), the k-th term after 4 + 2 k edges (the first after 2, R alone). Down:
    T^2 (1 + R^2 + ..), after 3 + 2 k edges.
    """
    r = fresnel(50.0, 1.5)
    t = 1 - r
    up = r * (depth >= 2) + t**2 * r * sum(r ** (2 * k) for k in range(99) if 4 + 2 * k <= depth)
    down = t**2 * sum(r ** (2 * k) for k in range(99) if 3 + 2 * k <= depth)
    slab = pane(
        50.0,
        type="cube",
        to_world=T().translate([0, 0, -0.1]).scale([20, 20, 0.1]),
        bsdf={"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    )
    check(render(slab, integrator, depth, 1024), ABOVE * up + BELOW * down)


@pytest.mark.parametrize("integrator", [*ALONG, {"type": "direct"}], ids=str)
def test_thin_pane(integrator: Keys) -> None:
    """All reflections inside at once: R' = 2 R / (1 + R), T' = 1 - R'."""
    r = fresnel(50.0, 1.5)
    up = 2 * r / (1 + r)
    bsdf = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
    scene = pane(50.0, type="rectangle", to_world=T().scale(20.0), bsdf=bsdf)
    check(render(scene, integrator, 2, 1024), ABOVE * up + BELOW * (1 - up))


@pytest.mark.parametrize("integrator", [*ALONG, {"type": "direct"}], ids=str)
def test_lamp_in_a_mirror(integrator: Keys) -> None:
    """rho e; black without an edge to reach the lamp."""
    bsdf = {"type": "conductor", "material": "none", "specular_reflectance": 0.6}
    scene = pane(45.0, type="rectangle", to_world=T().scale(20.0), bsdf=bsdf)
    scene["lamp"] = {
        "type": "rectangle",
        "to_world": T().look_at(origin=[-2, 0, 2], target=[0, 0, 0], up=[0, 1, 0]).scale(0.2),
        "emitter": area(7.0),
    }
    for depth in (1, 2):
        if integrator["type"] != "direct" or depth == 2:
            check(render(scene, integrator, depth, 16), 0.6 * 7.0 * (depth - 1))

"""Light on a diffuse floor: form factors and inverse squares, under every integrator that should find them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation.closed_forms.cases import ALBEDO, area, camera, parallel_rectangle
from tests.kit.closed_forms import (
    BY_CHANCE,
    BY_LIGHT_SAMPLES,
    FROM_LIGHTS,
    Array,
    Keys,
    check,
    on_the_floor,
    render,
)
from tests.kit.renders import ours

# ---------------------------------------------------------------- one point of a floor


@pytest.mark.parametrize(("height", "aside"), [(1.0, 0.0), (2.0, 0.0), (1.0, 1.0), (0.5, 3.0)])
@pytest.mark.parametrize("integrator", ["path", "direct", "prb"])
def test_point_light(integrator: str, height: float, aside: float) -> None:
    """L = a / pi I cos / r^2: inverse square and cosine, without noise."""
    light = {"type": "point", "position": [aside, 0, height], "intensity": 3.0}
    scene = on_the_floor(light=light)
    scene["integrator"] = {"type": integrator}
    squared = height**2 + aside**2
    expected = ALBEDO / math.pi * 3.0 * height / math.sqrt(squared) / squared
    np.testing.assert_allclose(ours(scene, 4), expected, rtol=1e-3)


@pytest.mark.parametrize("count", [2, 5])
def test_point_light_with_several_samples(count: int) -> None:
    """Their mean. Mitsuba 3.9.1 adds up the samples of lights without extent."""
    scene = on_the_floor(light={"type": "point", "position": [0, 0, 2.0], "intensity": 3.0})
    scene["integrator"] = {"type": "direct", "emitter_samples": count, "bsdf_samples": 0}
    expected = ALBEDO / math.pi * 3.0 / 2.0**2
    np.testing.assert_allclose(ours(scene, 4), expected, rtol=1e-3)


def over_a_corner(shape: str) -> tuple[dict[str, Any], float]:
    """A rectangular lamp over one quadrant, as a rectangle or as the lower face of a box."""
    a, b, c = 1.5, 0.8, 0.7
    if shape == "rectangle":
        to_world = T().translate([a / 2, b / 2, c]).rotate([1, 0, 0], 180).scale([a / 2, b / 2, 1])
    else:
        # Flat: the side faces hardly shine down.
        to_world = T().translate([a / 2, b / 2, c + 1e-4]).scale([a / 2, b / 2, 1e-4])
    return {"type": shape, "to_world": to_world}, parallel_rectangle(a, b, c)


@pytest.mark.parametrize("integrator", ["path", "direct"])
@pytest.mark.parametrize("shape", ["rectangle", "cube"])
def test_rectangular_light(shape: str, integrator: str) -> None:
    """L = a e F."""
    lamp, factor = over_a_corner(shape)
    scene = on_the_floor(lamp={**lamp, "emitter": area(4.0)})
    scene["integrator"] = {"type": integrator, **({"max_depth": 2} if integrator == "path" else {})}
    assert ours(scene, 1024).mean() == pytest.approx(ALBEDO * 4.0 * factor, rel=5e-3)


@pytest.mark.parametrize(
    ("height", "aside", "radius"), [(2.0, 0.0, 0.5), (1.0, 1.5, 0.6), (3.0, 0.0, 2.5), (1, 1, 1e-3)]
)
def test_spherical_light(height: float, aside: float, radius: float) -> None:
    """F = (r / d)^2 cos for a sphere all above the horizon."""
    lamp = {"type": "sphere", "center": [aside, 0, height], "radius": radius, "emitter": area(4.0)}
    squared = height**2 + aside**2
    factor = radius**2 / squared * height / math.sqrt(squared)
    image = ours(on_the_floor(lamp=lamp), 1024)
    assert image.mean() == pytest.approx(ALBEDO * 4.0 * factor, rel=4e-3)


def test_light_shines_from_its_front_only() -> None:
    lamp, _ = over_a_corner("rectangle")
    scene = on_the_floor(lamp={**lamp, "flip_normals": True, "emitter": area(4.0)})
    assert (ours(scene, 16) == 0).all()


def test_floor_under_half_a_sky() -> None:
    """A wall (black, endless) hides half of the sky from the foot of it: L = a e / 2."""
    black = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": 0.0}}
    turned = T().translate([-1e-3, 0, 0]).rotate([0, 1, 0], 90).scale(1000.0)
    wall = {"type": "rectangle", "to_world": turned, "bsdf": black}
    scene = on_the_floor(sky={"type": "constant", "radiance": 1.0}, wall=wall)
    assert ours(scene, 1024).mean() == pytest.approx(ALBEDO / 2, rel=5e-3)


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


@pytest.mark.sparse(16)
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

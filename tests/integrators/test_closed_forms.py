"""Scenes whose radiance is known by formula: these rank above any other renderer."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.scenes import furnace
from djpt.transforms import ScalarTransform4f as T
from tests.kit.renders import ours

ALBEDO = 0.6


def look_at(target: Any, origin: Any, up: Any = (0, 1, 0), size: int = 8, fov: float = 1e-3) -> dict[str, Any]:
    """A camera of narrow view: all its pixels see one point."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    return {"type": "perspective", "fov": fov, "to_world": T().look_at(origin, target, up), "film": film}


def plane(**more: Any) -> dict[str, Any]:
    """A large diffuse floor z = 0 that faces up."""
    bsdf = {"type": "diffuse", "reflectance": ALBEDO}
    return {"type": "rectangle", "to_world": T().scale(1000.0), "bsdf": bsdf, **more}


def on_the_floor(spot: Any = (0, 0, 0), depth: int = 2, **lights: Any) -> dict[str, Any]:
    """A camera that looks at `spot` of the floor from the side, under some lights."""
    x, y, _ = spot
    sensor = look_at(spot, (x + 3, y + 3, 2.0), up=(0, 0, 1))
    integrator = {"type": "path", "max_depth": depth}
    return {"type": "scene", "integrator": integrator, "sensor": sensor, "floor": plane(), **lights}


def area(radiance: float) -> dict[str, Any]:
    return {"type": "area", "radiance": radiance}


# ---------------------------------------------------------------- furnaces


@pytest.mark.parametrize("depth", [1, 2, 3, 6])
@pytest.mark.parametrize("integrator", ["path", "prb"])
def test_furnace_cut_off(integrator: str, depth: int) -> None:
    """Radiance e (1 - a^n) / (1 - a)."""
    albedo, radiance = 0.7, 2.0
    scene = furnace(albedo, radiance)
    scene["integrator"] = {"type": integrator, "max_depth": depth, "rr_depth": 1000}
    scene["sensor"]["film"].update(width=24, height=24)
    image = ours(scene, 64)
    assert image.mean() == pytest.approx(radiance * (1 - albedo**depth) / (1 - albedo), rel=4e-3)
    if depth == 1:
        np.testing.assert_allclose(image, radiance, rtol=1e-6)


def test_endless_furnace_under_roulette() -> None:
    scene = furnace(0.5, 1.0)
    scene["integrator"] = {"type": "path", "max_depth": -1, "rr_depth": 2}
    scene["sensor"]["film"].update(width=24, height=24)
    assert ours(scene, 64).mean() == pytest.approx(2.0, rel=6e-3)


def test_gradient_of_a_furnace() -> None:
    """With n edges: d/da of e sum_{k<n} a^k = e sum k a^(k-1), and d/de = sum a^k."""
    albedo, radiance, depth = 0.5, 1.0, 4
    scene = furnace(albedo, radiance)
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


@pytest.mark.parametrize("albedo", [0.0, 0.8])
def test_inside_a_shining_sphere(albedo: float) -> None:
    """A convex furnace; its emitter is sampled from inside."""
    radiance, depth, expected = 1.5, 5, 0.0
    expected = radiance * sum(albedo**k for k in range(depth))
    shell = {
        "type": "sphere",
        "radius": 2.0,
        "flip_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": albedo},
        "emitter": area(radiance),
    }
    integrator = {"type": "path", "max_depth": depth, "rr_depth": 1000}
    scene = {"type": "scene", "integrator": integrator, "shell": shell}
    scene["sensor"] = look_at((0, 0, 0), (0.3, 0.2, 1), size=32, fov=60.0)
    image = ours(scene, 256)
    assert image.mean() == pytest.approx(expected, rel=2e-3)


# ---------------------------------------------------------------- light on a floor


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


def parallel_rectangle(a: float, b: float, c: float) -> float:
    """Form factor of a small patch to a rectangle a x b in a parallel plane at distance c, one corner above it.

    J. Howell, *A Catalog of Radiation Heat Transfer Configuration Factors*, B-3.
    """
    x, y = a / c, b / c
    p, q = math.sqrt(1 + x * x), math.sqrt(1 + y * y)
    return (x / p * math.atan(y / p) + y / q * math.atan(x / q)) / (2 * math.pi)


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


# ---------------------------------------------------------------- under the sky


@pytest.mark.parametrize("albedo", [0.0, 0.4, 1.0])
def test_convex_body_under_a_constant_sky(albedo: float) -> None:
    """A sphere returns a e from everywhere: it vanishes against the sky at a = 1."""
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": albedo}}
    sky = {"type": "constant", "radiance": 2.0}
    scene = {"type": "scene", "ball": ball, "sky": sky, "sensor": look_at((0, 0, 0), (0, 0, 5), size=16, fov=10.0)}
    scene["integrator"] = {"type": "path", "max_depth": 3, "rr_depth": 1000}
    image = ours(scene, 512)
    assert image.mean() == pytest.approx(2.0 * albedo, rel=3e-3, abs=1e-7)


def test_floor_under_half_a_sky() -> None:
    """A wall (black, endless) hides half of the sky from the foot of it: L = a e / 2."""
    black = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": 0.0}}
    turned = T().translate([-1e-3, 0, 0]).rotate([0, 1, 0], 90).scale(1000.0)
    wall = {"type": "rectangle", "to_world": turned, "bsdf": black}
    scene = on_the_floor(sky={"type": "constant", "radiance": 1.0}, wall=wall)
    assert ours(scene, 1024).mean() == pytest.approx(ALBEDO / 2, rel=5e-3)

"""Rooms whose walls all shine, or are lit alike: every integrator finds the radiance that a geometric series gives."""

from __future__ import annotations

import math
from collections.abc import Callable

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.scenes import furnace
from djpt.validation.closed_forms.cases import area, camera
from tests.kit.closed_forms import (
    BY_CHANCE,
    BY_LIGHT_SAMPLES,
    FROM_LIGHTS,
    Keys,
    check,
    render,
)
from tests.kit.renders import ours

pytestmark = pytest.mark.cuda

# ---------------------------------------------------------------- shining walls


def shining_sphere(albedo: float, size: int = 12) -> Keys:
    """The inside of a diffuse sphere that shines with radiance 1."""
    shell = {
        "type": "sphere",
        "radius": 2.0,
        "flip_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": albedo},
        "emitter": area(1.0),
    }
    sensor = camera((0, 0, 0), (0.3, 0.2, 1), size=size, fov=60.0)
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


@pytest.mark.sparse(11)
@pytest.mark.parametrize(("furnace", "integrator"), FURNACES, ids=lambda x: getattr(x, "__name__", str(x)))
@pytest.mark.parametrize("depth", [pytest.param(1, marks=pytest.mark.slow), 2, 5])
def test_furnace(furnace: Callable[..., Keys], integrator: Keys, depth: int) -> None:
    """1 + a + .. + a^(depth - 1)."""
    albedo = 0.7
    check(render(furnace(albedo), integrator, depth, 512), sum(albedo**k for k in range(depth)), NEAR)


@pytest.mark.parametrize("furnace", [shining_sphere, shining_box])
def test_furnace_by_direct_light(furnace: Callable[..., Keys]) -> None:
    for samples in ({"shading_samples": 2}, {"emitter_samples": 0, "bsdf_samples": 1}):
        check(render(furnace(0.7), {"type": "direct", **samples}, 2, 512), 1.7, NEAR)


@pytest.mark.sparse(4)
@pytest.mark.parametrize("integrator", [*BY_CHANCE, *BY_LIGHT_SAMPLES[:-1]], ids=str)
def test_bounces_of_a_furnace(integrator: Keys) -> None:
    """Light that was scattered k times: a^k."""
    depth, albedo = 5, 0.7
    images = render(shining_sphere(albedo), {**integrator, "bounces": True}, depth, 512)
    terms = [albedo**k for k in range(depth)]
    check(images, np.repeat([sum(terms), *terms], 3), NEAR)


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
    scene["sensor"] = camera((0, 0, 0), (0.3, 0.2, 1), size=32, fov=60.0)
    image = ours(scene, 256)
    assert image.mean() == pytest.approx(expected, rel=2e-3)


# ---------------------------------------------------------------- a point light in a sphere


def lamp_in_a_sphere(albedo: float) -> Keys:
    """In the centre of a diffuse sphere of radius 2, intensity 3."""
    scene = shining_sphere(albedo)
    del scene["shell"]["emitter"]
    return {**scene, "lamp": {"type": "point", "position": [0, 0, 0], "intensity": 3.0}}


@pytest.mark.sparse(5)
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


@pytest.mark.sparse(3)
@pytest.mark.parametrize(
    "integrator", [{"type": t} for t in ("path_nee", "path", "guided", "ptracer", "bdpt")], ids=str
)
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


# ---------------------------------------------------------------- under the sky


@pytest.mark.parametrize("albedo", [0.0, 0.4, 1.0])
def test_convex_body_under_a_constant_sky(albedo: float) -> None:
    """A sphere returns a e from everywhere: it vanishes against the sky at a = 1."""
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": albedo}}
    sky = {"type": "constant", "radiance": 2.0}
    scene = {"type": "scene", "ball": ball, "sky": sky, "sensor": camera((0, 0, 0), (0, 0, 5), size=16, fov=10.0)}
    scene["integrator"] = {"type": "path", "max_depth": 3, "rr_depth": 1000}
    image = ours(scene, 512)
    assert image.mean() == pytest.approx(2.0 * albedo, rel=3e-3, abs=1e-7)

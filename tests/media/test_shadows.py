"""Shadows of media: the light on a floor under a box of absorbing matter, in closed form, for each kind of light."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.media_scenes import NULL, fog

LOW, HIGH = np.array([-1, -1, 0.2]), np.array([1, 1, 2.2])
"""The corners of the box."""

SIZE, HALF, PARTS = 24, 4.0, 8
"""The pixels of a row, half the width of what is seen of the floor, and the parts of a pixel's side."""

TO_LIGHT = np.array([-0.5, -0.6, 0.6])
FAR, NEAR = 10 * TO_LIGHT, np.array([-2.0, -2.4, 2.4])
GRID = {"type": "gridvolume", "data": np.ones((4, 4, 4, 1), np.float32)}

LIGHTS: dict[str, dict[str, Any]] = {
    "directional": {"type": "directional", "direction": (-TO_LIGHT).tolist(), "irradiance": 1.0},
    "far point": {"type": "point", "position": FAR.tolist(), "intensity": 50.0},
    "near point": {"type": "point", "position": NEAR.tolist(), "intensity": 50.0},
}

MEDIA: dict[str, dict[str, Any]] = {
    "homogeneous": fog(1.0, 0.0),
    "heterogeneous": {
        "type": "heterogeneous",
        "albedo": 0.0,
        "sigma_t": {**GRID, "to_world": T().translate(LOW.tolist()).scale((HIGH - LOW).tolist())},
    },
}


def floor_under(medium: dict[str, Any], light: dict[str, Any], integrator: str) -> Any:
    """The floor, seen straight from above."""
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 3},
        "sensor": {
            "type": "orthographic",
            "to_world": T().look_at([0, 0, 10], [0, 0, 0], [0, 1, 0]) @ T().scale(HALF),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
        },
        "light": light,
        "floor": {"type": "rectangle", "to_world": T().scale(20), "bsdf": {"type": "diffuse", "reflectance": 0.5}},
        "box": {"type": "cube", "to_world": T().translate([0, 0, 1.2]), "bsdf": NULL, "interior": medium},
    }


def inside(o: np.ndarray, d: np.ndarray, length: np.ndarray | float = np.inf) -> np.ndarray:
    """The length of rays within the box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = (LOW - o) / d, (HIGH - o) / d
    begin, end = np.fmin(near, far).max(axis=-1), np.fmax(near, far).min(axis=-1)
    return np.maximum(0, np.minimum(end, length) - np.maximum(begin, 0))


def expected(name: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The light that points of the floor outside of the box reflect upwards without it, and its length in the way."""
    if name == "directional":
        d = np.broadcast_to(TO_LIGHT / np.linalg.norm(TO_LIGHT), points.shape)
        irradiance, distance = d[..., 2], np.full(points.shape[:-1], np.inf)
    else:
        way = (FAR if name == "far point" else NEAR) - points
        distance = np.linalg.norm(way, axis=-1)
        d = way / distance[..., None]
        irradiance = 50 * d[..., 2] / distance**2
    return 0.5 / np.pi * irradiance, inside(points, d, distance)


def points() -> np.ndarray:
    """Points of the floor, PARTS^2 for each pixel; seen from above with +y upwards, +x points to the right."""
    places = (np.arange(SIZE * PARTS) + 0.5) / (SIZE * PARTS) * 2 * HALF - HALF
    x, y = np.meshgrid(places, -places)
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def of_pixels(values: np.ndarray) -> np.ndarray:
    """Means of values at these points, as the film has them."""
    return values.reshape(SIZE, PARTS, SIZE, PARTS, *values.shape[2:]).mean(axis=(1, 3))


def is_clear() -> np.ndarray:
    """True for the pixels that don't show the box."""
    centres = of_pixels(points())
    return (np.abs(centres[..., :2]) > 1.2).any(axis=-1)


CASES = [(medium, light, "volpath") for medium in MEDIA for light in LIGHTS]
CASES += [("homogeneous", light, "volpathmis") for light in LIGHTS]


@pytest.mark.sparse(8)
@pytest.mark.parametrize(("medium", "light", "integrator"), CASES)
def test_the_shadow_of_a_box(medium: str, light: str, integrator: str) -> None:
    scene = djpt.load_dict(floor_under(MEDIA[medium], LIGHTS[light], integrator))
    image = djpt.render(scene, spp=256).numpy()[..., 0]
    unshaded, length = expected(light, points())
    found, clear = of_pixels(unshaded * np.exp(-length)), is_clear()
    dark = clear & (found < 0.7 * found.max())
    assert np.median(np.abs(image[clear] / found[clear] - 1)) < 0.01
    assert image[clear].mean() == pytest.approx(found[clear].mean(), rel=5e-3)
    assert image[dark].mean() == pytest.approx(found[dark].mean(), rel=2e-2)


@pytest.mark.parametrize("integrator", ["volpath", "volpathmis"])
def test_derivatives_of_the_shadow_of_flakes(integrator: str) -> None:
    """By the scale of an extinction that depends on the direction: L exp(-tau) has the derivative -tau L exp(-tau)."""
    areas, key = np.array([0.2, 0.6, 0.9]), "box.interior_medium.scale"
    flakes = {"type": "sggx", "S": {**GRID, "data": np.float32([*areas**2, 0, 0, 0]).reshape(1, 1, 1, 6)}}
    scene = djpt.load_dict(floor_under(fog(1.0, 0.0, phase=flakes), LIGHTS["directional"], integrator))
    params = djpt.traverse(scene)
    dr.enable_grad(params[key])
    params.update()
    image = djpt.render(scene, params, spp=256)
    dr.set_grad(params[key], 1.0)
    slope = np.array(dr.forward_to(image))[..., 0]
    unshaded, length = expected("directional", points())
    tau = length * np.linalg.norm(areas * TO_LIGHT) / np.linalg.norm(TO_LIGHT)
    dark = is_clear() & (of_pixels(length) > 0.5)
    assert dark.sum() > 20
    assert np.array(image)[dark, 0].mean() == pytest.approx(of_pixels(unshaded * np.exp(-tau))[dark].mean(), rel=5e-3)
    assert slope[dark].mean() == pytest.approx(of_pixels(-tau * unshaded * np.exp(-tau))[dark].mean(), rel=1e-2)

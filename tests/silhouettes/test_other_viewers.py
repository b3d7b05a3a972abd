"""Derivatives by what other surfaces than the camera's see of a shape that moves, and by the edges of its textures."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float, TensorXf

LIFT, PUSH = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)


def film(size: int) -> dict[str, Any]:
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"}


def ball_over_a_disk(depth: int) -> Any:
    """The camera sees the disk alone, and this a ball under a bright sky."""
    description = {
        "type": "scene",
        "integrator": {"type": "prb_projective", "max_depth": depth, "guiding": "none"},
        "sensor": {
            "type": "perspective",
            "fov": 14,
            "to_world": T().look_at([2, 0, 0.5], [0, 0, 0], [0, 0, 1]),
            "film": film(4),
        },
        "disk": {"type": "disk", "to_world": T().scale(1.5)},
        "ball": {
            "type": "sphere",
            "center": [0.5, 0, 1.4],
            "radius": 0.8,
            "bsdf": {"type": "diffuse", "reflectance": 0.6},
        },
        "sky": {"type": "constant"},
    }
    return djpt.load_dict(description, optimize=False)


def shift(params: Any, start: Any, direction: tuple[float, float, float], theta: Float) -> None:
    key = "ball.to_world"
    params[key] = djpt.Transform4f().translate([x * theta for x in direction]) @ djpt.Transform4f(start)
    params.update()


def by_forward_mode(scene: Any, direction: tuple[float, float, float], spp: int, seed: int) -> np.ndarray:
    """The derivative of the image by the place of the ball."""
    params = djpt.traverse(scene)
    start, theta = params["ball.to_world"], Float(0)
    dr.enable_grad(theta)
    shift(params, start, direction, theta)
    dr.set_grad(theta, 1)
    change = np.array(dr.forward_to(djpt.render(scene, params, spp=spp, seed=seed)))
    shift(params, start, direction, Float(0))
    return change


def by_differences(scene: Any, direction: tuple[float, float, float], step: float, spp: int, seed: int) -> np.ndarray:
    """The derivative by central differences with two steps, by plain paths."""
    params = djpt.traverse(scene)
    start = params["ball.to_world"]
    path = djpt.load_dict({"type": "path", "max_depth": scene.integrator().max_depth})
    images = []
    for h in (step, -step, step / 2, -step / 2):
        shift(params, start, direction, Float(h))
        images.append(np.array(djpt.render(scene, integrator=path, spp=spp, seed=seed)))
    shift(params, start, direction, Float(0))
    return (8 * (images[2] - images[3]) - (images[0] - images[1])) / (6 * step)


@pytest.mark.parametrize(
    ("direction", "spp"),
    [(LIFT, 1 << 13), *(pytest.param(way, 1 << 15, marks=pytest.mark.slow) for way in (LIFT, PUSH))],
)
def test_light_that_a_body_reflects(direction: tuple[float, float, float], spp: int) -> None:
    """A point of the ball sees less of the sky behind the disk as it moves: 30 % of the derivative is by that edge."""
    scene = ball_over_a_disk(3)
    found = [by_forward_mode(scene, direction, spp, seed).mean() for seed in range(1, 33, 2)]
    expected = np.mean([by_differences(scene, direction, 0.1, spp // 2, seed).mean() for seed in range(8)])
    error = np.std(found, ddof=1) / np.sqrt(len(found))
    assert error < 0.04 * abs(expected)
    assert np.mean(found) == pytest.approx(expected, abs=4 * error)


COLUMNS = np.linspace(0.2, 0.9, 4, dtype=np.float32)[None, :, None].repeat(3, axis=2)


@pytest.mark.parametrize(
    ("size", "samples", "seeds"),
    [
        (8, 1 << 20, 16),
        (256, 1 << 20, 8),
        *(pytest.param(size, 1 << 22, 16, marks=pytest.mark.slow) for size in (8, 64, 256)),
    ],
)
def test_edges_of_textures_at_any_size(size: int, samples: int, seeds: int) -> None:
    """Rounding, or the narrow ends of edges near the outline, leave out nothing: 23 % of the jumps once were."""
    texture = {"type": "bitmap", "data": TensorXf(COLUMNS), "raw": True, "filter_type": "nearest"}
    place = T().look_at([1.5, -2.5, 6], [0, 0, 0.3], [0, 1, 0])
    description = {
        "type": "scene",
        "integrator": {"type": "direct_projective"},
        "sensor": {"type": "perspective", "fov": 38, "to_world": place, "film": film(size)},
        "ball": {
            "type": "sphere",
            "center": [0.2, 0.1, 0.4],
            "radius": 0.8,
            "bsdf": {"type": "diffuse", "reflectance": texture},
        },
        "sky": {"type": "constant", "radiance": 0.8},
    }
    scene = djpt.load_dict(description, optimize=False)
    # Of the right half, where the texture begins anew.
    weights = np.where(np.arange(size) < size / 2, 0.0, 1.0)[None, :, None]
    spp = samples // size**2
    found = [(by_forward_mode(scene, PUSH, spp // 8, 2 * seed + 1) * weights).mean() for seed in range(seeds)]
    expected = [(by_differences(scene, PUSH, 0.04, spp, seed) * weights).mean() for seed in range(4)]
    error = np.hypot(*(np.std(values, ddof=1) / np.sqrt(len(values)) for values in (found, expected)))
    assert np.mean(found) == pytest.approx(np.mean(expected), abs=4 * error)
    assert error < 0.06 * abs(np.mean(expected))

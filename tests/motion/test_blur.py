"""Motion blur with a known answer: the time for which each pixel is covered."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import djpt
from djpt import AnimatedTransform4f as A
from djpt.core.transforms import ScalarTransform4f as T

N, SPP = 32, 1024
CENTRES = (np.arange(N) + 0.5) / N * 2 - 1
X, Y = np.meshgrid(CENTRES, -CENTRES)
TOWARDS = T().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])


def image(shape: dict[str, Any], sensor: dict[str, Any] | None = None, spp: int = SPP) -> np.ndarray:
    """The image of a shape that shines, in the dark; a camera sees [-1, 1]^2."""
    film = {"type": "hdrfilm", "width": N, "height": N, "rfilter": {"type": "box"}}
    camera = {"type": "orthographic", "to_world": TOWARDS, "shutter_close": 1.0, "film": film, **(sensor or {})}
    shape = {**shape, "emitter": {"type": "area", "radiance": 1.0}}
    scene = djpt.load_dict({"type": "scene", "sensor": camera, "shape": shape, "integrator": {"type": "direct"}})
    return np.array(djpt.render(scene, spp=spp))[..., 0]


def pixel_means(covered: Any) -> np.ndarray:
    """The means over pixels of a share of the time, given by x and y."""
    offsets = (np.arange(16) + 0.5) / 16 * 2 / N - 1 / N
    return np.mean([covered(X + dx, Y + dy) for dx in offsets for dy in offsets], axis=0)


def check(found: np.ndarray, expected: np.ndarray, spp: int = SPP) -> None:
    """Compare with standard errors of shares, each pixel and all."""
    error = np.sqrt(np.maximum(expected * (1 - expected), 0.25 / spp) / spp)
    z = (found - expected) / error
    assert np.abs(z).max() < 5
    assert abs((found - expected).mean()) < 4 * np.sqrt((error**2).sum()) / error.size + 2e-4


def test_a_square_that_passes_leaves_ramps() -> None:
    a, start, way = 0.3, -0.6, 0.8
    place = T().scale(a)
    passes = A({0: T().translate([start, 0, 0]) @ place, 1: T().translate([start + way, 0, 0]) @ place})

    def covered(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        # |x - start - way t| < a
        first, last = (x - start - a) / way, (x - start + a) / way
        return np.clip(last, 0, 1) * (np.abs(y) < a) - np.clip(first, 0, 1) * (np.abs(y) < a)

    check(image({"type": "rectangle", "to_world": passes}), pixel_means(covered))


def test_a_square_that_turns_is_a_disk_with_a_soft_rim() -> None:
    a = 0.5
    quarter = A({0: T().scale(a), 1: T().rotate([0, 0, 1], 90).scale(a)})

    def covered(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        r = np.maximum(np.hypot(x, y), 1e-9)
        return np.clip(1 - 4 / math.pi * np.arccos(np.clip(a / r, 0, 1)), 0, 1)

    check(image({"type": "rectangle", "to_world": quarter}), pixel_means(covered))


def test_a_disk_that_turns_about_the_origin() -> None:
    """Constant speed along a circle: a point is covered for its share of the angle."""
    ring = A({k / 4: T().rotate([0, 0, 1], 90 * k) for k in range(5)})

    def covered(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        r = np.maximum(np.hypot(x, y), 1e-9)
        cosine = (r**2 + 0.4**2 - 0.2**2) / (2 * r * 0.4)
        return np.arccos(np.clip(cosine, -1, 1)) / math.pi

    check(image({"type": "sphere", "center": [0.4, 0, 0], "radius": 0.2, "to_world": ring}), pixel_means(covered))


def test_a_ball_that_grows() -> None:
    small, large = 0.2, 0.8
    grows = A({0: T().scale(small), 1: T().scale(large)})

    def covered(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.clip((large - np.hypot(x, y)) / (large - small), 0, 1)

    check(image({"type": "sphere", "to_world": grows}), pixel_means(covered))


def test_a_camera_that_pans() -> None:
    """A half-plane at the angles above 0, seen while the camera turns by 20 degrees, each row at all of them."""
    swing, fov = 20.0, 60.0
    camera = {
        "type": "perspective",
        "fov": fov,
        "to_world": A({0: T(), 1: T().rotate([0, 1, 0], swing)}),
        "film": {"type": "hdrfilm", "width": N, "height": 1, "rfilter": {"type": "box"}},
    }
    # The edge x = 0; the camera's +x is on the left of its image.
    half = {"type": "rectangle", "to_world": T().translate([1e4, 0, 10]).rotate([0, 1, 0], 180).scale(1e4)}
    found = image(half, camera, spp=8192)[0]
    offsets = (np.arange(64) + 0.5) / 64 * 2 / N - 1 / N
    angle = np.degrees(np.arctan(-(CENTRES[:, None] + offsets) * math.tan(math.radians(fov / 2))))
    expected = np.clip((angle + swing) / swing, 0, 1).mean(1)
    check(found, expected, 8192)


@pytest.mark.parametrize("sampler", ["independent", "stratified", "ldsampler"])
def test_time_is_a_number_of_the_sampler(sampler: str) -> None:
    """The time is drawn after the place on the film; stratified samplers spread it."""
    passes = A({0: T().translate([-0.6, 0, 0]).scale(0.3), 1: T().translate([0.2, 0, 0]).scale(0.3)})
    found = image({"type": "rectangle", "to_world": passes}, {"sampler": {"type": sampler}}, spp=256)
    assert found.mean() == pytest.approx(0.36 / 4, rel=0.01)


def test_a_rolling_shutter_slants_what_passes() -> None:
    """Each row sees a bar where it is at the row's time: exposed for an instant, or for a while."""
    a, start, way = 0.1, -0.5, 1.0
    bar = T().scale([a, 2, 1])
    passes = {0: T().translate([start, 0, 0]) @ bar, 1: T().translate([start + way, 0, 0]) @ bar}
    mesh = {"type": "rectangle"}
    film = {"type": "hdrfilm", "width": N, "height": N, "rfilter": {"type": "box"}}
    camera = {"type": "orthographic", "to_world": TOWARDS, "rolling_shutter": 0.5, "film": film}
    for exposure in (0.0, 0.25):
        camera = {**camera, "shutter_close": exposure}
        scene = djpt.load_dict(
            {
                "type": "scene",
                "sensor": camera,
                "lamp": {"type": "constant"},
                "bar": {**mesh, "to_world": A(passes), "bsdf": {"type": "diffuse", "reflectance": 0.0}},
                "integrator": {"type": "direct"},
            }
        )
        dark = 1 - np.array(djpt.render(scene, spp=SPP))[..., 0]

        def covered(x: np.ndarray, y: np.ndarray, exposure: float = exposure) -> np.ndarray:
            opens = (1 - y) / 2 * 0.5
            first, last = (x - start - a) / way - opens, (x - start + a) / way - opens
            if exposure == 0:
                return ((first < 0) & (last > 0)).astype(float)
            return np.clip(last / exposure, 0, 1) - np.clip(first / exposure, 0, 1)

        check(dark, pixel_means(covered), SPP if exposure else 64)
        with pytest.raises(djpt.RenderError, match="rolling shutter"):
            djpt.render(scene, spp=1, integrator=djpt.load_dict({"type": "bdpt"}))

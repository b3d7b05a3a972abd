"""Sensors that hand their rays on to others: each of these stands in a medium of its own."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float, TensorXf
from tests.kit.media_scenes import NULL, fog
from tests.kit.renders import pixels

SIZE = 12
PLACES = {
    "inside": T().look_at([0, 0, 1.8], [0, 0, 0], [0, 1, 0]),
    "outside": T().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
}


def film(width: int = SIZE) -> dict[str, Any]:
    return {"type": "hdrfilm", "width": width, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "luminance"}


def camera(name: str) -> dict[str, Any]:
    return {"type": "perspective", "fov": 40, "to_world": PLACES[name], "film": film()}


def scene(**sensors: Any) -> Any:
    """A ball in a box of fog under a sky."""
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volpath", "max_depth": 3},
            "ball": {
                "type": "sphere",
                "center": [0.2, 0, 0],
                "radius": 0.5,
                "bsdf": {"type": "diffuse", "reflectance": 0.1},
            },
            "sky": {"type": "constant"},
            "fog": {"type": "cube", "to_world": T().scale(2), "bsdf": NULL, "interior": fog(0.4)},
            **sensors,
        }
    )


def batch() -> dict[str, Any]:
    return {"type": "batch", "film": film(2 * SIZE), **{name: camera(name) for name in PLACES}}


def test_a_batch_shows_what_its_sensors_show() -> None:
    both = pixels(djpt.render(scene(sensor=batch()), spp=1024))
    for number, name in enumerate(PLACES):
        alone = pixels(djpt.render(scene(sensor=camera(name)), spp=1024))
        part = both[:, number * SIZE : (number + 1) * SIZE]
        assert part.mean() == pytest.approx(alone.mean(), rel=0.02)


def test_a_medium_that_a_batch_names() -> None:
    """It is that of the sensors which name none."""
    named = {"medium": fog(0.4)}
    both = pixels(djpt.render(scene(fog={"type": "sphere", "radius": 0.1}, sensor={**batch(), **named}), spp=256))
    alone = scene(fog={"type": "sphere", "radius": 0.1}, sensor={**camera("inside"), **named})
    assert both[:, :SIZE].mean() == pytest.approx(pixels(djpt.render(alone, spp=256)).mean(), rel=0.03)


def test_pixels_of_several_views() -> None:
    views = scene(**{name: camera(name) for name in PLACES})
    whole = [pixels(djpt.render(views, sensor=k, spp=1024)) for k in range(2)]
    loader = djpt.ad.RayDataLoader(views.sensors(), [TensorXf(image.reshape(SIZE, SIZE, 1)) for image in whole], 144)
    for _ in range(2):
        target, sensor = loader.next()
        seen = pixels(djpt.render(views, sensor=sensor, spp=1024))
        assert seen.mean() == pytest.approx(np.array(target).mean(), rel=0.03)


def test_derivatives_by_a_camera_of_a_batch() -> None:
    """Those of the camera alone."""

    def derivative(loaded: Any, key: str, seeds: range) -> np.ndarray:
        params, found = djpt.traverse(loaded), []
        place = djpt.Transform4f(params[key])
        for seed in seeds:
            step = Float(0)
            dr.enable_grad(step)
            params[key] = djpt.Transform4f().translate([step, 0, 0]) @ place
            params.update()
            change = loaded.integrator().render_forward
            dr.set_grad(step, 1)
            dr.enqueue(dr.ADMode.Forward, step)
            dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
            image = np.array(change(loaded, None, seed=seed, spp=1024))[..., 0]
            found.append(image[:, -SIZE:] @ np.linspace(-1, 1, SIZE))
        return np.array(found).sum(axis=1)

    one = derivative(scene(sensor=camera("inside")), "sensor.to_world", range(8))
    group = {"type": "batch", "film": film(2 * SIZE), "first": camera("outside"), "last": camera("inside")}
    other = derivative(scene(sensor=group), "sensor.last.to_world", range(8, 16))
    error = np.hypot(one.std(ddof=1), other.std(ddof=1)) / np.sqrt(8)
    assert abs(one.mean() - other.mean()) < 4 * error and error < 0.2 * abs(one.mean())

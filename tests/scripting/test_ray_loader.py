"""Batches of pixels: Mitsuba's order, the rays of the pixels, gradients, and what is refused."""

from __future__ import annotations

import importlib
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import ArgumentError, RenderError
from djpt.jit.types import Color3f, Point2f, TensorXf, UInt32

WIDTH, HEIGHT = 6, 4
KEY = "floor.bsdf.reflectance.value"


def camera(mi: Any, x: float = 0.0, **film: Any) -> dict[str, Any]:
    size = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    look = mi.ScalarTransform4f().look_at(origin=[x, 0, 3], target=[0, 0, 0], up=[0, 1, 0])
    return {"type": "perspective", "fov": 45, "to_world": look, "film": size | film}


def loader(mi: Any, pixels: int, **options: Any) -> Any:
    sensors = [mi.load_dict(camera(mi, x)) for x in (0.0, 1.0)]
    images = [mi.TensorXf(np.arange(72, dtype=np.float32).reshape(HEIGHT, WIDTH, 3) + 100 * k) for k in range(2)]
    # Mitsuba's `ad` lacks the class if it was imported before a variant was set.
    module = djpt.ad if mi is djpt else importlib.import_module("mitsuba.ad.loaders.ray_loader")
    return module.RayDataLoader(sensors, images, pixels, **options)


@pytest.mark.parametrize("tile", [1, 2, 4, 6])
def test_batches_are_mitsubas(mi: Any, tile: int) -> None:
    """Where they fill a pass exactly: with single pixels Mitsuba's may name pixels that aren't there."""
    mine, his = (loader(m, 16, seed=7, regular_reshuffle=True, tile_size=tile) for m in (djpt, mi))
    for _ in range(5):
        (target, sensor), (other, reference) = mine.next(), his.next()
        np.testing.assert_array_equal(np.array(sensor.pixel_idx), np.array(reference.pixel_idx))
        np.testing.assert_array_equal(np.array(target), np.array(other))
    for name in ("tiles_per_row", "tiles_per_col", "tiles_per_sensor", "iter_shuffle", "pixel_batch_multiplier"):
        assert getattr(mine, name) == getattr(his, name)


@pytest.mark.parametrize("tile", [1, 4, 6])
def test_a_pass_has_every_pixel(tile: int) -> None:
    batches = loader(djpt, 13, tile_size=tile)
    assert batches.effective_total_pixels == 52
    seen = np.concatenate([np.array(batches.next()[1].pixel_idx) for _ in range(batches.iter_shuffle)])
    assert set(seen) == set(range(48))


def test_rays_are_those_of_the_pixels() -> None:
    batches = loader(djpt, 48, tile_size=4)
    _, flat = batches.next()
    flat.prepare()
    ray = flat.ray_of_pixel(dr.arange(UInt32, 48), Point2f(0.25, 0.75), Point2f(0.5), djpt.Float(0))
    again, weight = flat.sample_ray(0.0, 0.0, Point2f((dr.arange(djpt.Float, 48) + 0.25) / 48, 0.75), Point2f(0.5))
    pixels = np.array(flat.pixel_idx)
    for number, sensor in enumerate(flat.sensors):
        column, row = pixels % WIDTH, pixels % (WIDTH * HEIGHT) // WIDTH
        place = Point2f(djpt.Float((column + 0.25) / WIDTH), djpt.Float((row + 0.75) / HEIGHT))
        expected = sensor.ray_through(place, Point2f(0.5))
        mine = pixels // (WIDTH * HEIGHT) == number
        for found in (ray, again):
            np.testing.assert_allclose(np.array(found.d)[:, mine], np.array(expected.d)[:, mine], atol=1e-5)
    assert dr.width(weight) == 48 and "num_sensors = 2, size = 6 x 4" in str(flat)


def scene() -> Any:
    return djpt.load_dict(
        {
            "type": "scene",
            "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.3}},
            "light": {"type": "constant"},
            "one": camera(djpt),
            "two": camera(djpt, 1.0),
        }
    )


@pytest.mark.parametrize("name", ["path", "direct", "replayed_by_script"])
@pytest.mark.sparse(2)
def test_batches_are_rendered_and_differentiated(name: str) -> None:
    djpt.register_integrator("replayed_by_script", lambda props: djpt.ad.integrators.prb.PRBIntegrator(props))
    lit, integrator = scene(), djpt.load_dict({"type": name})
    whole = [np.array(djpt.render(lit, sensor=k, spp=512, integrator=integrator)) for k in range(2)]
    batches = djpt.ad.RayDataLoader(lit.sensors(), [TensorXf(image) for image in whole], 24, tile_size=2)
    params, color = djpt.traverse(lit), Color3f(0.3)
    dr.enable_grad(color)
    params[KEY] = color
    params.update()
    for _ in range(2):
        target, flat = batches.next()
        image = djpt.render(lit, params, sensor=flat, spp=256, integrator=integrator)
        assert image.shape == target.shape == (1, 24, 3)
        np.testing.assert_allclose(np.array(dr.detach(image)), np.array(target), atol=0.15)
        dr.backward(dr.mean(image.array))
    covered = (1 - np.mean(whole)) / 0.7  # by the floor, which reflects 0.3 of the sky
    np.testing.assert_allclose(np.array(dr.grad(color)).sum(), 2 * covered, rtol=0.02)


def test_a_new_batch_compiles_no_kernel() -> None:
    lit = scene()
    batches = djpt.ad.RayDataLoader(lit.sensors()[:1], [dr.zeros(TensorXf, (HEIGHT, WIDTH, 3))], 8)
    hashes = set()
    for _ in range(3):
        _, flat = batches.next()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            dr.eval(djpt.render(lit, sensor=flat, spp=2))
            hashes |= {tuple(k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT)}
    assert len(hashes) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sensors": []}, "At least one sensor and one target image are needed"),
        ({"pixels_per_batch": 25}, r"pixels_per_batch \(25\) must be from 1 to total_pixels \(24\)"),
        ({"tile_size": 0}, r"tile_size \(0\) must be positive"),
        ({"target_images": dr.zeros(TensorXf, (4, 6))}, r"Target images must have shape \(height, width, channels\)"),
        ({"target_images": dr.zeros(TensorXf, (4, 6, 2))}, "images must have 1, 3 or 4 channels, found 2"),
        ({"target_images": dr.zeros(TensorXf, (4, 6, 4))}, "has 3 channels, its image 4"),
        ({"target_images": dr.zeros(TensorXf, (5, 6, 3))}, "has 6 x 4 pixels, its image 6 x 5"),
        ({"target_images": [dr.zeros(TensorXf, (4, 6, 3))] * 2}, "1 sensors don't fit 2 target images"),
        ({"film": {"crop_width": 2, "crop_height": 2}}, "has a crop window, which isn't supported here"),
        ({"film": {"sample_border": True}}, "has sample_border, which isn't supported here"),
    ],
)
def test_what_is_refused(change: dict[str, Any], words: str) -> None:
    sensor = djpt.load_dict(camera(djpt, **change.pop("film", {})))
    arguments = {"sensors": sensor, "target_images": dr.zeros(TensorXf, (4, 6, 3)), "pixels_per_batch": 8}
    with pytest.raises(ArgumentError, match=words):
        djpt.ad.loaders.RayDataLoader(**(arguments | change))


def test_a_flat_sensor_alone_sees_nothing() -> None:
    with pytest.raises(RenderError, match="has no sensors to look through; call 'initialize' first"):
        djpt.render(scene(), sensor=djpt.ad.FlatSensor(djpt.Properties("flat_sensor")), spp=1)

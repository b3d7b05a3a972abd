"""Sensors of all kinds that move: alone, above moving targets, on moving shapes, and in batches."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt import AnimatedTransform4f as A
from djpt.core.records import RAY_EPSILON
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from tests.kit.kernels import kernels

PIXEL = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
TIME = 0.37


def look(x: float, y: float = 2.0) -> T:
    return T().look_at([x, y, 3], [0.2, 0, 0], [0, 1, 0])


TURN = A({0: look(-3), 1: look(3)})
PASS = A({0: T().translate([-1, 0.2, 0]).scale(0.3), 1: T().translate([1, 0.2, 0]).rotate([0, 1, 0], 50).scale(0.5)})
GLIDE = A({0: look(0, 1), 0.5: look(-1), 1: look(2)})
STILL_DISK = {"type": "disk", "to_world": T().scale(0.3)}
MOVING_DISK = {"type": "disk", "to_world": PASS}
METER = {"type": "irradiancemeter", "film": PIXEL}
VIEW = {"type": "perspective", "fov": 40}


def batch(width: int, **sensors: Any) -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": width, "height": 4, "rfilter": {"type": "box"}}
    return {"type": "batch", "film": film, **sensors}


SENSORS: dict[str, dict[str, Any]] = {
    "radiancemeter": {"type": "radiancemeter", "to_world": TURN},
    "thinlens": {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.0, "to_world": TURN},
    "orthographic": {"type": "orthographic", "to_world": A({0: look(-1) @ T().scale(2), 1: look(1) @ T().scale(2)})},
    "fisheye": {"type": "fisheye", "to_world": TURN},
    "panorama": {"type": "panorama", "to_world": TURN},
    "distant": {"type": "distant", "to_world": TURN},
    "distant at a point": {"type": "distant", "to_world": TURN, "target": [0.3, 0.1, 0]},
    "distant at a shape": {"type": "distant", "to_world": TURN, "target": STILL_DISK},
    "distant at what moves": {"type": "distant", "to_world": TURN, "target": MOVING_DISK},
    "still, at what moves": {"type": "distant", "direction": [0.2, -1, 0.3], "target": {"type": "ref", "id": "disk"}},
    "batch": batch(
        16,
        a={**VIEW, "to_world": TURN},
        b={**VIEW, "to_world": look(1)},
        c={**VIEW, "to_world": GLIDE},
        d={"type": "orthographic", "to_world": A(TURN)},
    ),
    "batch of meters": batch(
        12,
        a={"type": "distant", "to_world": TURN, "target": MOVING_DISK},
        b={"type": "distant", "to_world": GLIDE},
        c={"type": "radiancemeter", "to_world": TURN},
    ),
    "batch on shapes": batch(
        8,
        a={**MOVING_DISK, "id": "lone", "meter": METER},
        b={"type": "ref", "id": "carrier"},
    ),
}


def scene_with(**sensors: dict[str, Any]) -> Any:
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sky": {"type": "constant", "radiance": 0.2},
            "disk": MOVING_DISK,
            "carrier": {"type": "sphere", "to_world": PASS, "meter": METER},
            "floor": {"type": "rectangle", "to_world": T().translate([0, -0.5, 0]).rotate([1, 0, 0], -90).scale(2)},
            "lamp": {"type": "point", "position": [1, 3, 1], "intensity": 10.0},
            **{name: {**sensor, "shutter_close": 1.0} for name, sensor in sensors.items()},
        }
    )


def test_rays_of_what_moves_are_those_of_the_moment() -> None:
    scene = scene_with(**SENSORS)
    still_scene = scene.at_time(TIME)
    x, y, u, v = np.random.default_rng(1).random((4, 24)).astype(np.float32)
    place, aperture = djpt.Point2f(x, y), djpt.Point2f(u, v)
    for moving, still in zip(scene.sensors(), still_scene.sensors(), strict=True):
        assert moving.moves and not still.moves
        ray, _ = moving.sample_ray(TIME, 0, place, aperture)
        expected, _ = still.sample_ray(0, 0, place, aperture)
        dr.eval(ray, expected)
        # Meters on shapes draw directions about a normal, which turns with the shape, and start a little above it.
        on_shape = moving.weight != 1
        fields = [(ray.o, expected.o, 2 * RAY_EPSILON if on_shape else 5e-6), (ray.maxt, expected.maxt, 0)]
        fields += [] if on_shape else [(ray.d, expected.d, 5e-6)]
        for a, b, near in fields:
            found, right = np.broadcast_arrays(np.array(a), np.array(b))
            np.testing.assert_allclose(found, right, atol=near, rtol=2e-6, err_msg=moving.id())
        assert np.allclose(np.array(ray.time), TIME)


def test_a_batch_of_moving_cameras_is_edited_without_a_new_kernel() -> None:
    scene = scene_with(sensor=SENSORS["batch"])
    params = djpt.traverse(scene)

    def edit(x: float) -> Any:
        params["sensor.a.to_world.translation"] = [x, 2, 3, 3, 2, 3]
        params.update()
        return np.array(djpt.render(scene, spp=4, seed=1, sensor=1))

    first = edit(-3)
    before = kernels(lambda: edit(-2))
    assert kernels(lambda: edit(-1)) <= before
    # Views don't mix.
    changed = np.abs(edit(-1) - first).max((0, 2)) > 1e-6
    assert changed[:4].any() and not changed[4:].any()


def test_a_batch_that_moves_holds_no_batch_that_moves() -> None:
    inner = batch(4, a={**VIEW, "to_world": TURN})
    with pytest.raises(SceneError, match="nest its sensors in this one"):
        djpt.load_dict(batch(8, a=VIEW, b=inner))


@pytest.mark.slow
@pytest.mark.parametrize("name", SENSORS)
def test_images_are_means_of_stills(name: str) -> None:
    sensor = {"film": PIXEL, **SENSORS[name]}
    scene, rounds, moments = scene_with(sensor=sensor), 8, 16
    which = len(scene.sensors()) - 1
    random = np.random.default_rng(3)
    blurred = np.array([np.mean(djpt.render(scene, spp=1024, seed=k, sensor=which)) for k in range(rounds)])
    still = []
    for k in range(rounds):
        times = (np.arange(moments) + random.random(moments)) / moments
        images = [
            djpt.render(scene.at_time(t), spp=128, seed=100 * k + i, sensor=which) for i, t in enumerate(times, 1)
        ]
        still.append(np.mean([np.mean(image) for image in images]))
    spread = np.sqrt((blurred.var(ddof=1) + np.var(still, ddof=1)) / rounds)
    assert abs(blurred.mean() - np.mean(still)) < 4 * spread

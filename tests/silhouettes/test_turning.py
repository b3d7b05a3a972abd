"""Cameras that turn apart from cameras whose centre moves."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.integrators.projective.turning_camera import StillRay, turned_apart
from djpt.jit.types import Color3f, Float, Point2f, TensorXf
from tests.silhouettes.cases import SIZE, ball, sensor, sky

FOV = 40.0


def scene(edit: dict[str, Any], at: tuple[float, float, float] = (0, 0, 6)) -> Any:
    """A ball over a floor, whose camera has other parameters."""
    camera = {**sensor(fov=FOV), "to_world": T().translate(list(at)).rotate([0, 1, 0], 180)}
    found = djpt.load_dict(
        {
            "type": "scene",
            "ball": ball({"type": "diffuse"}, center=[0.3, 0.2, 0], radius=0.8),
            "floor": {"type": "rectangle", "to_world": T().translate([0, 0, -0.8]).scale(3)},
            "sky": sky(),
            "sensor": camera,
        }
    )
    params = djpt.traverse(found)
    for key, value in edit.items():
        params[key] = value(params[key])
    params.update()
    return found


def number() -> Float:
    """A number with gradients."""
    theta = Float(0)
    dr.enable_grad(theta)
    return theta


@pytest.mark.parametrize("x", [0.0, 1000.0])
def test_places_of_rays_move_as_a_camera_zooms_also_far_off_the_origin(x: float) -> None:
    """u - 1/2 is in proportion to 1 / tan(fov / 2), so du / dfov = -(u - 1/2) / sin(fov)."""
    theta = number()
    found = scene({"sensor.x_fov": lambda fov: Float(fov) + theta}, (x, 0, 6))
    turned, rest = turned_apart(found, found.sensors()[0], forward=False)
    assert not rest.attached_names()
    camera = turned.attached()
    place = Point2f([0.1, 0.5, 0.9], [0.3, 0.6, 0.8])
    ray = dr.detach(camera.ray_through(place, Point2f(0)))
    _, uv = StillRay(ray.d, Color3f(1)).attached(found, camera, Float(0))
    np.testing.assert_allclose(np.array(uv), np.array(place), atol=2e-4)
    dr.forward(theta)
    expected = -(np.array(place) - 0.5) / np.sin(np.radians(FOV)) * np.radians(1)
    np.testing.assert_allclose(np.array(dr.grad(uv)), expected, atol=1e-5)


def test_what_is_left_of_a_motion_turns_no_ray() -> None:
    theta = number()
    move = djpt.Transform4f().rotate([0, 1, 0], 10 * theta) @ djpt.Transform4f().translate([theta, 0, 0])
    found = scene({"sensor.to_world": lambda place: move @ djpt.Transform4f(place)})
    turned, rest = turned_apart(found, found.sensors()[0], forward=False)
    rays = [camera.attached().ray_through(Point2f(0.3, 0.8), Point2f(0)) for camera in (turned, rest)]
    assert dr.grad_enabled(rays[0].d) and not dr.grad_enabled(rays[1].d)
    dr.forward(theta)
    assert np.abs(np.array(dr.grad(rays[1].o))).max() > 1


INDIRECT = {"type": "prb_projective", "max_depth": 3}


def moved(theta: Float, by_turn: float, by_step: float, ball: float = 0) -> Any:
    """The scene, its camera turned and moved aside, and its ball moved."""
    own = djpt.Transform4f().rotate([0.6, 0.8, 0], 20 * by_turn * theta)
    step, along = (djpt.Transform4f().translate([by * theta, 0, 0]) for by in (by_step, ball))
    edits: dict[str, Any] = {"sensor.to_world": lambda place: step @ djpt.Transform4f(place) @ own} if ball < 1 else {}
    return scene(edits | ({"ball.to_world": lambda place: along @ djpt.Transform4f(place)} if ball else {}))


def derivative(by_turn: float, by_step: float, ball: float = 0) -> Any:
    """The derivative of the image in indirect light."""
    theta = number()
    found = moved(theta, by_turn, by_step, ball)
    dr.forward(theta, dr.ADFlag.ClearEdges)
    return np.array(djpt.load_dict(INDIRECT).render_forward(found, None, spp=16, seed=3))


def test_a_motion_is_the_sum_of_its_parts() -> None:
    one, other, both = derivative(1, 0), derivative(0, 1), derivative(1, 1)
    assert min(np.abs(one).max(), np.abs(other).max()) > 0.1
    np.testing.assert_allclose(one + other, both, atol=2e-3 * np.abs(both).max())


def test_a_camera_turns_as_by_itself_if_something_else_moves() -> None:
    turn, ball, both = derivative(1, 0), derivative(0, 0, 1), derivative(1, 0, 0.5)
    np.testing.assert_allclose(turn + 0.5 * ball, both, atol=2e-3 * np.abs(both).max())


def test_reverse_mode_reaches_the_number_that_a_script_computes_a_camera_from() -> None:
    theta, weights = number(), np.random.default_rng(1).random((SIZE, SIZE, 3), np.float32)
    djpt.load_dict(INDIRECT).render_backward(moved(theta, 1, 1), None, TensorXf(weights), spp=16, seed=3)
    parts = weights * derivative(1, 1)
    assert float(dr.grad(theta)[0]) == pytest.approx(float(parts.sum()), abs=1e-5 * float(np.abs(parts).sum()))

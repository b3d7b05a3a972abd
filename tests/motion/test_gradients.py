"""Derivatives by keyframes: against closed forms, and motions found from blurred pictures."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt import AnimatedTransform4f as A
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError

N = 32
CENTRES = (np.arange(N) + 0.5) / N * 2 - 1
X, Y = np.meshgrid(CENTRES, -CENTRES)
A0, START, WAY = 0.3, -0.4, 0.7
SENSOR = {
    "type": "orthographic",
    "shutter_close": 1.0,
    "to_world": T().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
    "film": {"type": "hdrfilm", "width": N, "height": N, "rfilter": {"type": "box"}},
}
WEIGHTS = X**2 + 0.5 * X + 0.3 * Y


def bright(keyframes: Any, shape: str = "rectangle", **parts: Any) -> Any:
    """A shape that shines and moves in the dark; the camera sees [-1, 1]^2."""
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct_projective", "sppi": 0, "guiding": "none"},
            "sensor": SENSOR,
            "obj": {"type": shape, "to_world": A(keyframes), "emitter": {"type": "area", "radiance": 1.0}},
            **parts,
        }
    )


def passing(way: float = WAY) -> dict[float, T]:
    square = T().scale(A0)
    return {0: T().translate([START, 0, 0]) @ square, 1: T().translate([START + way, 0, 0]) @ square}


def moment(weight: Any) -> float:
    """The mean over time of a weight times the derivative, by its centre, of the integral of WEIGHTS over it."""
    t = (np.arange(4096) + 0.5) / 4096
    return float(4 * A0**2 * np.mean(weight(t) * (2 * (START + WAY * t) + 0.5)))


@pytest.mark.parametrize(
    ("part", "entry", "expected"),
    [
        ("translation", 3, moment(lambda t: t)),
        ("translation", 0, moment(lambda t: 1 - t)),
        ("times", 1, moment(lambda t: -WAY * t)),
    ],
)
@pytest.mark.sparse(3)
@pytest.mark.slow
def test_keyframes_of_a_square_that_passes(part: str, entry: int, expected: float) -> None:
    scene = bright(passing())
    params = djpt.traverse(scene)
    key = f"obj.to_world.{part}"
    weights = djpt.TensorXf(np.repeat(WEIGHTS[..., None], 3, 2).astype(np.float32) * (4 / N**2 / 3))
    leaf = djpt.TensorXf(params[key])
    dr.enable_grad(leaf)
    params[key] = leaf
    params.update()
    dr.backward(dr.sum(djpt.render(scene, params, spp=256) * weights, axis=None))
    found = np.array(dr.grad(leaf)).ravel()[entry]
    assert found == pytest.approx(expected, rel=0.03, abs=0.003)


@pytest.mark.slow
def test_forward_mode_is_the_adjoint_of_reverse_mode() -> None:
    scene = bright({0: T().scale(0.4), 1: T().rotate([0, 0, 1], 40).scale(0.5)})
    params = djpt.traverse(scene)
    key = "obj.to_world.scale"
    weights = djpt.TensorXf(np.repeat(WEIGHTS[..., None], 3, 2).astype(np.float32))
    change = np.arange(6).reshape(2, 3).astype(np.float32)
    found = []
    for mode in ("forward", "reverse"):
        leaf = djpt.TensorXf(dr.detach(params[key]))
        dr.enable_grad(leaf)
        params[key] = leaf
        params.update()
        image = djpt.render(scene, params, spp=16)
        if mode == "forward":
            dr.set_grad(leaf, djpt.TensorXf(change))
            found.append(float((np.array(dr.forward_to(image)) * np.array(weights)).sum()))
        else:
            dr.backward(dr.sum(image * weights, axis=None))
            found.append(float((np.array(dr.grad(leaf)) * change).sum()))
    assert found[0] == pytest.approx(found[1], rel=1e-3)


def test_materials_have_derivatives_while_shapes_move() -> None:
    """The albedo of a square under a sky: the derivative of its image is the image over the albedo."""
    plain = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    scene = djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "prb", "max_depth": 2, "hide_emitters": True},
            "sensor": SENSOR,
            "sky": {"type": "constant"},
            "obj": {"type": "rectangle", "to_world": A(passing()), "bsdf": plain},
        }
    )
    params = djpt.traverse(scene)
    key = "obj.bsdf.reflectance.value"
    dr.enable_grad(params[key])
    params.update()
    image = djpt.render(scene, params, spp=64)
    dr.backward(dr.mean(image, axis=None))
    assert dr.sum(dr.grad(params[key]))[0] == pytest.approx(float(np.array(image).mean() / 0.5), rel=0.03)


def test_what_has_no_derivative_says_so() -> None:
    scene = bright(passing())
    params = djpt.traverse(scene)
    leaf = djpt.TensorXf(params["obj.to_world.translation"])
    dr.enable_grad(leaf)
    params["obj.to_world.translation"] = leaf
    params.update()
    with pytest.raises(RenderError, match="prb_projective"):
        djpt.render(scene, params, spp=1, integrator=djpt.load_dict({"type": "path"}))


def found_by_newton(scene: Any, key: str, start: np.ndarray, direction: np.ndarray, target: np.ndarray) -> float:
    """How far to go from `start` in a direction, by Gauss and Newton, so that the picture becomes `target`."""
    params = djpt.traverse(scene)
    step = 0.0
    for k in range(5):
        leaf = djpt.TensorXf((start + step * direction).astype(np.float32))
        dr.enable_grad(leaf)
        params[key] = leaf
        params.update()
        image = djpt.render(scene, params, spp=256 << k, spp_grad=128 << min(k, 2), seed=10 + k)
        dr.set_grad(leaf, djpt.TensorXf(direction.astype(np.float32)))
        change = np.array(dr.forward_to(image)).ravel()
        residual = target.ravel() - np.array(dr.detach(image)).ravel()
        step += float(change @ residual / (change @ change))
    return step


@pytest.mark.slow
def test_a_velocity_is_found_from_one_blurred_picture() -> None:
    target = np.array(djpt.render(bright(passing()), spp=4096, integrator=djpt.load_dict({"type": "direct"})))
    start = np.array([[START, 0, 0], [START + 0.4, 0, 0]])
    found = found_by_newton(
        bright(passing(0.4)), "obj.to_world.translation", start, np.array([[0, 0, 0], [1, 0, 0]]), target
    )
    assert 0.4 + found == pytest.approx(WAY, rel=0.01)


@pytest.mark.slow
def test_a_focal_length_is_found_from_one_blurred_picture() -> None:
    """Of a camera that stays, by what passes."""
    camera = {**SENSOR, "type": "perspective", "near_clip": 0.1}
    wanted, fov = 25.0, 22.0
    target = djpt.render(
        bright(passing(), sensor={**camera, "fov": wanted}), spp=4096, integrator=djpt.load_dict({"type": "direct"})
    )
    scene = bright(passing(), sensor={**camera, "fov": fov})
    params = djpt.traverse(scene)
    for k in range(5):
        angle = djpt.Float(fov)
        dr.enable_grad(angle)
        params["sensor.x_fov"] = angle
        params.update()
        image = djpt.render(scene, params, spp=256 << k, spp_grad=128 << min(k, 2), seed=10 + k)
        dr.set_grad(angle, 1.0)
        change = np.array(dr.forward_to(image)).ravel()
        residual = np.array(target).ravel() - np.array(dr.detach(image)).ravel()
        fov += float(change @ residual / (change @ change))
    focal_length = 1 / np.tan(np.radians([wanted, fov]) / 2)
    assert focal_length[1] == pytest.approx(focal_length[0], rel=0.01)


@pytest.mark.slow
def test_a_speed_of_rotation_is_found_from_one_blurred_picture() -> None:
    """A square that turns about its middle, by the angle at the end of the exposure."""

    def turning(angle: float) -> dict[float, T]:
        return {0: T().scale([0.7, 0.25, 1]), 1: T().rotate([0, 0, 1], angle).scale([0.7, 0.25, 1])}

    def lamp(angle: float) -> dict[str, Any]:
        # Lights keep their proportions: a lit bar stands for them.
        sky, bar = {"type": "constant"}, {"type": "rectangle", "to_world": A(turning(angle))}
        return {"obj": bar, "sky": sky}

    direct = djpt.load_dict({"type": "direct", "hide_emitters": True})
    projective = {"type": "direct_projective", "sppi": 0, "guiding": "none", "hide_emitters": True}
    wanted, first = 50.0, 35.0
    target = np.array(djpt.render(bright({0: T(), 1: T()}, **lamp(wanted)), spp=4096, integrator=direct))
    scene = bright({0: T(), 1: T()}, **lamp(first), integrator=projective)
    params = djpt.traverse(scene)
    angle = first
    for k in range(5):
        theta = djpt.Float(angle)
        dr.enable_grad(theta)
        half = dr.deg2rad(theta) / 2
        zero, one = djpt.Float(0), djpt.Float(1)
        entries = [zero, zero, zero, one, zero, zero, dr.sin(half), dr.cos(half)]
        params["obj.to_world.rotation"] = djpt.TensorXf(dr.concat(entries), shape=(2, 4))
        params.update()
        image = djpt.render(scene, params, spp=256 << k, spp_grad=128 << min(k, 2), seed=10 + k)
        dr.set_grad(theta, 1.0)
        change = np.array(dr.forward_to(image)).ravel()
        angle += float(change @ (target.ravel() - np.array(dr.detach(image)).ravel()) / (change @ change))
    assert angle == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize(
    ("name", "weight"), [("shutter_open", lambda t: 1.0 + 0 * t), ("shutter_open_time", lambda t: t)]
)
@pytest.mark.sparse(2)
@pytest.mark.slow
def test_times_of_the_shutter(name: str, weight: Any) -> None:
    """A square goes on by its speed times the change of the moment; the shutter covers the middle of its way."""
    scene = bright(passing(), sensor={**SENSOR, "shutter_open": 0.2, "shutter_close": 0.8})
    params = djpt.traverse(scene)
    weights = djpt.TensorXf(np.repeat(WEIGHTS[..., None], 3, 2).astype(np.float32) * (4 / N**2 / 3))
    leaf = djpt.Float(0.2 if name == "shutter_open" else 0.6)
    dr.enable_grad(leaf)
    params[f"sensor.{name}"] = leaf
    params.update()
    dr.backward(dr.sum(djpt.render(scene, params, spp=256) * weights, axis=None))
    share = (np.arange(4096) + 0.5) / 4096
    place = START + WAY * (0.2 + 0.6 * share)
    expected = float(4 * A0**2 * np.mean(weight(share) * WAY * (2 * place + 0.5)))
    assert float(dr.grad(leaf)[0]) == pytest.approx(expected, rel=0.03, abs=0.003)

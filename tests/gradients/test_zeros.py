"""Derivatives by values that are 0 or tiny: paths go on where a factor vanishes, and nothing is divided by it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.dispatch.ensemble import may_vanish
from djpt.validation.gradcheck.losses import quotient
from tests.kit.derivatives import ZEROS
from tests.kit.kernels import kernels
from tests.kit.mesh_scenes import ball_file

KEY = "red.reflectance.value"


def room(integrator: str = "path", **nodes: Any) -> dict[str, Any]:
    """The Cornell box, small."""
    scene = djpt.cornell_box() | nodes
    scene["integrator"] = {"type": integrator, "max_depth": 6}
    scene["sensor"]["film"].update(width=16, height=16, rfilter={"type": "box"})
    return scene


def attach(params: Any, value: Any, key: str = KEY) -> None:
    params[key] = djpt.Color3f(value)
    dr.enable_grad(params[key])
    params.update()


def reverse(scene: Any, params: Any, value: Any, spp: int = 64) -> np.ndarray:
    """The gradient (3,) of the image's mean."""
    attach(params, value)
    dr.backward(dr.mean(djpt.render(scene, params, spp=1, spp_grad=spp), axis=None))
    return np.array(dr.grad(params[KEY])).ravel()


def forward(scene: Any, params: Any, value: Any, spp: int = 64) -> float:
    """The derivative of the image's mean by all channels together."""
    attach(params, value)
    dr.set_grad(params[KEY], djpt.Color3f(1))
    return float(np.mean(dr.forward_to(djpt.render(scene, params, spp=1, spp_grad=spp))))


def slope(scene: Any, params: Any, step: float = 0.02) -> float:
    """The derivative of the image's mean at 0 by one-sided differences."""

    def mean(value: float) -> float:
        params[KEY] = djpt.Color3f(value)
        params.update()
        return float(np.mean(djpt.render(scene, spp=4096), dtype=np.float64))

    return quotient(mean, step, side=1)


def test_the_red_wall() -> None:
    scene = djpt.load_dict(room())
    params = djpt.traverse(scene)
    expected = slope(scene, params)
    for value in (*ZEROS, 1e-25, 1e-8):
        gradient = reverse(scene, params, value, spp=1024)
        assert gradient.sum() == pytest.approx(expected, rel=0.03)
        assert forward(scene, params, value, spp=1024) == pytest.approx(gradient.sum(), rel=1e-4)


def test_channels_are_apart() -> None:
    """A channel that is black doesn't touch the others."""
    scene = djpt.load_dict(room())
    params = djpt.traverse(scene)
    black, red = reverse(scene, params, 0.0, 512), reverse(scene, params, [0.5, 0.0, 1e-20], 512)
    assert red[1:] == pytest.approx(black[1:], rel=0.05)
    whole = reverse(scene, params, 0.5, 512)
    assert red[0] == pytest.approx(whole[0], rel=0.05)


@pytest.mark.parametrize(
    "integrator", ["prb_basic", *(pytest.param(i, marks=pytest.mark.slow) for i in ("path_nee", "prb", "prbvolpath"))]
)
def test_integrators(integrator: str) -> None:
    scene = djpt.load_dict(room(integrator))
    params = djpt.traverse(scene)
    expected = reverse(scene, params, 0.02, 512).sum()
    for value in (0.0, 1e-10):
        assert reverse(scene, params, value, 512).sum() == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("value", [0.0, 1e-10])
@pytest.mark.sparse(2)
def test_schedules_agree(tmp_path: Path, value: float) -> None:
    """In the machine schedule shadow rays are traced where a black wall would be lit."""
    found = {}
    for schedule in ("flat", "machine", "wave"):
        ball = {"type": "ply", "filename": ball_file(tmp_path, rows=4), "bsdf": {"type": "ref", "id": "red"}}
        scene = djpt.load_dict(room(ball=ball))
        params = djpt.traverse(scene)
        attach(params, value)
        image = djpt.render(scene, params, spp=1, spp_grad=64, schedule=schedule)
        dr.backward(dr.mean(image, axis=None))
        found[schedule] = np.array(dr.grad(params[KEY])).ravel()
    assert found["machine"] == pytest.approx(found["flat"], rel=1e-3)
    assert found["wave"] == pytest.approx(found["flat"], rel=1e-3)


def test_values_that_vanish() -> None:
    assert may_vanish(djpt.Color3f(0.5, 0.3, 0)) and may_vanish(djpt.Float(1)) and may_vanish(djpt.Float(-1e-4))
    assert not may_vanish(djpt.Color3f(0.5, 0.3, 0.1)) and not may_vanish(djpt.Float(3))
    assert may_vanish(djpt.TensorXf(np.array([[0.2, 0.0]], np.float32)))


def test_one_kernel_for_all_tiny_values() -> None:
    scene = djpt.load_dict(room())
    params = djpt.traverse(scene)
    reverse(scene, params, 0.0)
    tiny, again = (kernels(lambda v=v: reverse(scene, params, v)) for v in (1e-9, 1e-4))
    assert tiny == again

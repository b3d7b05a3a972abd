"""Gradients of images by the texels of textures."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import TensorXf
from tests.kit.textured_room import FLOOR, WALL, bitmap, room, texels

pytestmark = pytest.mark.cuda


@pytest.mark.sparse(3)
@pytest.mark.parametrize("integrator", ["path", "prb"])
@pytest.mark.parametrize("keys", [{}, {"filter_type": "nearest"}, {"wrap_mode": "mirror"}], ids=str)
def test_gradients_by_texels(keys: dict[str, Any], integrator: str) -> None:
    start = texels(3, 4, 3)
    wall = {"type": "checkerboard", "color0": bitmap(texels(2, 2, 1), **keys), "to_uv": T().scale(4)}
    floor = bitmap(start, to_uv=T().scale([1.5, 1.5, 1]), **keys)
    scene = djpt.load_dict(room(floor, wall, integrator))
    params = djpt.traverse(scene)
    data = {f"{FLOOR}.data": start, f"{WALL}.color0.data": texels(2, 2, 1)}

    def loss() -> Any:
        return dr.mean(dr.square(djpt.render(scene, params, spp=8, seed=2, seed_grad=2)), axis=None)

    for name in data:
        dr.enable_grad(params[name])
    params.update()
    dr.backward(loss())
    gradients = {name: np.array(dr.grad(params[name])) for name in data}
    for name, value in data.items():
        assert gradients[name].shape == value.shape
        params[name] = value
    params.update()
    for name, index in ((f"{FLOOR}.data", (1, 2, 1)), (f"{FLOOR}.data", (0, 0, 2)), (f"{WALL}.color0.data", (1, 0, 0))):
        values = []
        for sign in (1, -1):
            moved = data[name].copy()
            moved[index] += sign * 0.05
            params.update({name: moved})
            values.append(float(loss().array[0]))
            params.update({name: data[name]})
        slope = (values[0] - values[1]) / 0.1
        assert gradients[name][index] == pytest.approx(slope, rel=0.01, abs=2e-6)


@pytest.mark.sparse(8)
@pytest.mark.parametrize("integrator", ["prb", "path", "direct"])
@pytest.mark.parametrize("shared", [True, False], ids=["shared", "own"])
def test_gradients_of_bitmaps_in_several_kinds_of_materials(shared: bool, integrator: str) -> None:
    # All of them small: Dr.Jit sums gradients of small arrays in a way of its own.
    start, random = texels(3, 4, 3), np.random.default_rng(4)

    def texture() -> dict[str, Any]:
        return {"type": "ref", "id": "wood"} if shared else bitmap(start)

    description = room(texture(), texture(), integrator)
    description["integrator"] = {"type": integrator}
    description["board"] = {
        "type": "rectangle", "to_world": T().translate([1.5, 0, 0.3]).scale(0.4),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "checkerboard", "color0": texture()}},
    }  # fmt: skip
    if shared:
        description["wood"] = bitmap(start)
    scene = djpt.load_dict(description)
    params = djpt.traverse(scene)
    names = [name for name in params if name.endswith(".data")]
    assert len(names) == (1 if shared else 3)
    tangent = random.random(start.shape).astype(np.float32)
    weights = TensorXf(random.random((24, 24, 3)).astype(np.float32))

    def loss() -> Any:
        return dr.sum((djpt.render(scene, params, spp=16, seed=1, seed_grad=1) * weights).array)

    def attach() -> None:
        for name in names:
            params[name] = start
            dr.enable_grad(params[name])

    attach()
    params.update()
    dr.backward(loss())
    reverse = sum(float(np.sum(np.array(dr.grad(params[name])) * tangent)) for name in names)
    attach()
    for name in names:
        dr.set_grad(params[name], TensorXf(tangent))
    params.update()
    forward = dr.forward_to(loss())[0]
    ends = []
    for sign in (1, -1):
        params.update(dict.fromkeys(names, start + sign * 0.02 * tangent))
        ends.append(float(loss()[0]))
    assert forward == pytest.approx((ends[0] - ends[1]) / 0.04, rel=2e-3)
    assert reverse == pytest.approx(forward, rel=1e-4)


def test_a_bitmap_is_recovered_from_its_picture() -> None:
    target = texels(3, 3, 3, seed=5)
    scene = djpt.load_dict(room(bitmap(target), integrator="prb"))
    params = djpt.traverse(scene)
    name = f"{FLOOR}.data"
    reference = djpt.render(scene, spp=16)
    opt = djpt.ad.Adam(lr=0.05, params={name: TensorXf(np.full_like(target, 0.5))})
    for step in range(60):
        opt[name] = dr.clip(opt[name], 0, 1)
        params.update(opt)
        image = djpt.render(scene, params, spp=4, seed=step)
        dr.backward(dr.mean(dr.square(image - reference), axis=None))
        opt.step()
    # The texels under the ball and behind it are hardly seen.
    assert np.median(np.abs(np.array(params[name]) - target)) < 0.03

"""Sums of the derivatives of tables by calls: those of Dr.Jit's additions, whatever threads add."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.lookup import MAX_CHAIN
from djpt.dispatch.tables import Buffer
from djpt.jit.types import Bool, Float, TensorXf, UInt32
from djpt.rendering.gradients import entry_sums, leaves
from djpt.rendering.gradients.entry_sums import CalledSums, ScatteredSums, proved, usable
from tests.kit.textured_room import FLOOR, bitmap, room, texels


@pytest.fixture
def calls() -> Iterator[None]:
    if not usable(4):
        pytest.skip("kernels make no calls here")
    yield


@pytest.mark.usefixtures("calls")
@pytest.mark.parametrize("size", [1, 2, 4])
def test_known_sums(size: int) -> None:
    assert proved(size)


@pytest.mark.usefixtures("calls")
@pytest.mark.parametrize("copies", [1, 2, 5])
@pytest.mark.parametrize("channels", [1, 3])
def test_threads_that_add_to_the_same_entries(channels: int, copies: int) -> None:
    lanes, turns = 2**17, 8
    sums = CalledSums(Buffer([dr.zeros(TensorXf, (1, 3, channels))], [0]), lanes, copies)
    lane = dr.arange(UInt32, lanes)
    entry: Any = Float(1) if channels == 1 else [Float(1), Float(2), Float(3)]

    def body(k: UInt32, used: Bool) -> tuple[UInt32, Bool]:
        return k + 1, used ^ sums.add([(lane % 3, entry), ((lane + k) % 3, entry)], lane % 4 != 0)

    _, used = dr.while_loop((dr.zeros(UInt32, lanes), dr.full(Bool, False, lanes)), lambda k, used: k < turns, body)
    dr.eval(used)
    found = np.array(sums.total()).reshape(3, -1)
    # Whole numbers below 2^24: the sums are exact.
    numbers = np.arange(lanes)[np.arange(lanes) % 4 != 0]
    counts = sum(
        np.bincount((numbers + k) % 3, minlength=3) + np.bincount(numbers % 3, minlength=3) for k in range(turns)
    )
    for c in range(channels):
        np.testing.assert_array_equal(found[:, c], counts * (c + 1))


MIXED = 2654435761
"""A factor after which the upper bits of numbers seem random."""


@pytest.mark.parametrize("by_calls", [True, False])
def test_sums_of_few_texels_do_not_stagnate(by_calls: bool, request: pytest.FixtureRequest) -> None:
    """Most derivatives are small: one number in float, to which all lanes add, would miss them."""
    if by_calls:
        request.getfixturevalue("calls")
    lanes, turns = 2**22, 8
    buffer = Buffer([dr.zeros(TensorXf, (1, 2, 1))], [0])
    sums: Any = CalledSums(buffer, lanes, 2) if by_calls else ScatteredSums(buffer, lanes)
    lane = dr.arange(UInt32, lanes)
    entry = dr.power(Float((lane * MIXED) >> 8) * 2**-24, 16)

    def body(k: UInt32, used: Bool) -> tuple[UInt32, Bool]:
        return k + 1, used ^ sums.add([(lane & 1, entry)], Bool(True))

    _, used = dr.while_loop((dr.zeros(UInt32, lanes), dr.full(Bool, False, lanes)), lambda k, used: k < turns, body)
    dr.eval(used)
    entries = ((np.arange(lanes, dtype=np.uint32) * np.uint32(MIXED) >> 8) * 2.0**-24) ** 16
    np.testing.assert_allclose(np.array(sums.total()), turns * entries.reshape(-1, 2).sum(0), rtol=1e-4)


def test_sums_of_many_numbers_do_not_stagnate() -> None:
    """Those of more parameters than registers are in memory, too."""
    balls = {f"ball_{k}": ball(-0.9 + 0.45 * (k % 5), -0.7 + 0.45 * (k // 5)) for k in range(20)}
    film = {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}}
    place = djpt.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    sensor = {"type": "perspective", "fov": 30, "to_world": place, "film": film}
    light = {"type": "constant"}
    scene = djpt.load_dict({"type": "scene", "integrator": {"type": "path"}, "sensor": sensor, "light": light, **balls})
    params = djpt.traverse(scene)
    keys = [key for key in params if key.endswith("reflectance.value")]
    assert len(keys) > MAX_CHAIN

    def mean(tangent: float | None) -> Any:
        for key in keys:
            params[key] = djpt.Color3f(0.5)
            dr.enable_grad(params[key])
            if tangent is not None:
                dr.set_grad(params[key], tangent)
        params.update()
        return dr.mean(djpt.render(scene, params, spp=1, spp_grad=4096, seed=1), axis=None)

    dr.backward(mean(None))
    found = sum(np.array(dr.grad(params[key]), np.float64).sum() for key in keys)
    np.testing.assert_allclose(found, np.array(dr.forward_to(mean(1.0))), rtol=2e-6)


def ball(x: float, y: float) -> dict[str, Any]:
    return {"type": "sphere", "radius": 0.25, "center": [x, y, 0], "bsdf": {"type": "diffuse"}}


@pytest.mark.usefixtures("calls")
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("keys", [{}, {"filter_type": "nearest"}], ids=["bilinear", "nearest"])
@pytest.mark.sparse(4)
def test_gradients_by_either_way(keys: dict[str, Any], channels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"{FLOOR}.data"

    def gradient() -> np.ndarray:
        scene = djpt.load_dict(room(bitmap(texels(5, 4, channels), **keys), bitmap(texels(2, 2, 1)), "prb"))
        params = djpt.traverse(scene)
        dr.enable_grad(params[name])
        params.update()
        dr.backward(dr.mean(dr.square(djpt.render(scene, params, spp=8, seed=2)), axis=None))
        return np.array(dr.grad(params[name]))

    made: list[type] = []
    original = entry_sums.entry_sums

    def noticed(buffer: Buffer, lanes: int) -> Any:
        sums = original(buffer, lanes)
        made.append(type(sums))
        return sums

    monkeypatch.setattr(leaves, "entry_sums", noticed)
    called = gradient()
    assert set(made) == {CalledSums}
    monkeypatch.setattr(leaves, "entry_sums", ScatteredSums)
    np.testing.assert_allclose(called, gradient(), rtol=1e-4, atol=1e-7)
    assert np.abs(called).max() > 0


@pytest.mark.usefixtures("calls")
def test_tables_too_large_for_copies() -> None:
    buffer = Buffer([dr.zeros(TensorXf, (64, 64, 3))], [0])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(entry_sums, "MOST", 2**10)
        assert isinstance(entry_sums.entry_sums(buffer, 16), ScatteredSums)
    assert isinstance(entry_sums.entry_sums(buffer, 16), CalledSums)


def test_values_that_stay_are_not_read_again() -> None:
    scene = djpt.load_dict(room(bitmap(texels(3, 4, 3)), bitmap(texels(2, 2, 1)), "prb"))
    params, name = djpt.traverse(scene), f"{FLOOR}.data"
    value = TensorXf(texels(3, 4, 3))
    dr.enable_grad(value)
    params.update({name: value})
    with dr.scoped_set_flag(dr.JitFlag.ForbidSynchronization, True):
        assert params.update({name: value}) == []
    with pytest.raises(djpt.ParameterError, match="finite"):
        params.update({name: TensorXf(np.full((3, 4, 3), np.nan, np.float32))})

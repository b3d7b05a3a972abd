"""Sums of the derivatives of tables by calls: those of Dr.Jit's additions, whatever threads add."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.dispatch.tables import Buffer
from djpt.jit.types import Bool, Float, TensorXf, UInt32
from djpt.rendering.gradients import entry_sums, leaves
from djpt.rendering.gradients.entry_sums import CalledSums, ScatteredSums, proved, usable
from tests.kit.textured_room import FLOOR, bitmap, room, texels


@pytest.fixture(autouse=True)
def calls() -> Iterator[None]:
    if not usable(4):
        pytest.skip("kernels make no calls here")
    yield


@pytest.mark.parametrize("size", [1, 2, 4])
def test_known_sums(size: int) -> None:
    assert proved(size)


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
    monkeypatch.setattr(leaves, "entry_sums", lambda buffer, lanes: ScatteredSums(buffer))
    np.testing.assert_allclose(called, gradient(), rtol=1e-4, atol=1e-7)
    assert np.abs(called).max() > 0


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

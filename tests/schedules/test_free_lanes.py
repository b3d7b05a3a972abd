"""Loops whose lanes compute on after their end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.jit.kernels import mapped, numbers_of
from djpt.jit.llvm.masks import can_unmask
from djpt.jit.types import PCG32, Bool, Float, Point2f, UInt32
from djpt.rendering.schedules import unmasked_loop as free_lanes
from djpt.rendering.schedules.unmasked_loop import Memory, run_free
from tests.kit.renders import box, pixels

unmasking = pytest.mark.skipif(not can_unmask(), reason="masks can't be changed here")


@dataclass
class Count:
    """Steps of each lane: `left` are still to do, `total` has those that count, `free` has all."""

    left: UInt32
    total: Float
    free: UInt32
    place: Point2f
    odd: Bool | None


def counted(lanes: int) -> Count:
    """Lane i makes i steps."""
    start = Count(dr.arange(UInt32, lanes), dr.zeros(Float, lanes), dr.zeros(UInt32, lanes), Point2f(0, 0), None)
    start.place = Point2f(dr.zeros(Float, lanes), dr.zeros(Float, lanes))

    def step(count: Count) -> Count:
        going = count.left > 0
        return Count(
            left=dr.select(going, count.left - 1, 0),
            total=count.total + dr.select(going, Float(1), 0),
            free=count.free + 1,
            place=count.place + Point2f(1, 2),
            odd=None,
        )

    return run_free(start, lambda count: count.left > 0, step, lanes, "count")


@pytest.mark.parametrize("lanes", [1, 5, 16, 37])
def test_results_that_are_kept(lanes: int) -> None:
    np.testing.assert_array_equal(np.array(counted(lanes).total), np.arange(lanes))


@unmasking
def test_lanes_go_on() -> None:
    """All lanes of a packet make as many steps as the longest."""
    end = counted(16)
    assert np.array(end.free)[0] > 0
    np.testing.assert_array_equal(np.array(end.place.y), 2 * np.array(end.free))


SCENES: dict[str, dict[str, Any]] = {
    "box": {"rfilter": {"type": "box"}},
    "gaussian": {"rfilter": {"type": "gaussian"}},
    "stored": {"rfilter": {"type": "gaussian"}, "sample_border": True},
}


@pytest.mark.sparse(8)
@unmasking
@pytest.mark.parametrize("film", SCENES)
@pytest.mark.parametrize("sampler", ["independent", "multijitter"])
def test_same_bits_as_with_masks(monkeypatch: pytest.MonkeyPatch, film: str, sampler: str) -> None:
    description = box(21, "box", {"type": "path", "max_depth": 6})
    description["sensor"]["film"].update(SCENES[film])
    description["sensor"]["sampler"] = {"type": sampler}

    def results() -> list[np.ndarray]:
        scene = djpt.load_dict(description)
        params = djpt.traverse(scene)
        key = "red.reflectance.value"
        dr.enable_grad(params[key])
        params.update()
        image = djpt.render(scene, params, spp=16, seed=3)
        dr.backward(dr.sum(image.array))
        return [pixels(image), np.array(dr.grad(params[key]))]

    free = results()
    monkeypatch.setattr(free_lanes, "can_unmask", lambda: False)
    for a, b in zip(free, results(), strict=True):
        np.testing.assert_array_equal(a, b)


@unmasking
def test_records_come_back_from_memory() -> None:
    record = [Point2f(Float(1, 2), Float(3, 4)), None, (UInt32(5, 6), Bool(True, False)), PCG32(2)]
    memory = Memory(record, 2)
    back = memory.read(memory.allocated())
    assert back[1] is None
    assert [type(x) for x in numbers_of(back)] == [type(x) for x in numbers_of(record)]
    for a, b in zip(numbers_of(record), numbers_of(back), strict=True):
        np.testing.assert_array_equal(np.array(a), np.array(b))
    assert mapped(record, lambda x: x)[0].x is not None

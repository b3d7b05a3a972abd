"""Samplers of scripts: the numbers, counts and state of Mitsuba's."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import DjptError
from djpt.jit.types import Float, Point2f, UInt32
from tests.kit.arrays import in_numpy

SAMPLERS: list[dict[str, Any]] = [
    {"type": "independent"},
    {"type": "stratified"},
    {"type": "stratified", "jitter": False},
    {"type": "multijitter"},
    {"type": "orthogonal"},
    {"type": "orthogonal", "strength": 3},
    {"type": "ldsampler"},
]


def both(mi: Any, description: dict[str, Any]) -> list[Any]:
    mi.set_log_level(mi.LogLevel.Error)
    return [djpt.load_dict(description), mi.load_dict(description)]


def name_of(description: dict[str, Any]) -> str:
    return "-".join(str(v) for v in description.values())


def require_equal(mine: Any, his: Any, lanes: int) -> None:
    dr.eval(mine, his)
    a, b = (np.broadcast_to(in_numpy(x), (*in_numpy(x).shape[:-1], lanes)) for x in (mine, his))
    np.testing.assert_allclose(a, b, rtol=0, atol=2e-7)


@pytest.mark.sparse(24)
@pytest.mark.parametrize(("share", "lanes"), [(1, 33), (16, 48), (4, 32)])
@pytest.mark.parametrize("description", SAMPLERS, ids=name_of)
def test_numbers_are_mitsubas(mi: Any, description: dict[str, Any], share: int, lanes: int) -> None:
    samplers = both(mi, {**description, "sample_count": 16, "seed": 3})
    if samplers[1].sample_count() % share:
        share = samplers[1].sample_count()
    drawn: list[list[Any]] = []
    for sampler, UInt in zip(samplers, (djpt.UInt32, mi.UInt32), strict=True):
        sampler.set_samples_per_wavefront(share)
        sampler.seed(UInt(7), lanes)
        numbers: list[Any] = [sampler.next_1d(), sampler.next_2d(), sampler.next_1d()]
        copy = sampler.clone()
        numbers += [sampler.next_2d(), copy.next_2d()]
        if share < sampler.sample_count():  # there is another sample
            sampler.advance()
            numbers += [sampler.next_1d(), sampler.next_2d()]
        other = sampler.fork()
        other.set_samples_per_wavefront(share)
        other.seed(5, lanes)
        drawn.append([*numbers, other.next_1d()])
        assert sampler.wavefront_size() == lanes
    for mine, his in zip(*drawn, strict=True):
        require_equal(mine, his, lanes)


@pytest.mark.parametrize("description", SAMPLERS, ids=name_of)
def test_counts_are_mitsubas(mi: Any, description: dict[str, Any]) -> None:
    for count in (1, 3, 17, 100):
        mine, his = both(mi, {**description, "sample_count": count})
        assert mine.sample_count() == his.sample_count()
    mine, his = both(mi, description)
    assert (mine.sample_count(), mine.wavefront_size()) == (his.sample_count(), his.wavefront_size())
    for sampler in (mine, his):
        sampler.set_sample_count(16)
    assert mine.sample_count() == his.sample_count()


def test_inactive_lanes_draw_nothing(mi: Any) -> None:
    samplers = both(mi, {"type": "independent"})
    drawn = []
    for sampler, Bool in zip(samplers, (djpt.Bool, mi.Bool), strict=True):
        sampler.seed(0, 4)
        sampler.next_1d(Bool([True, False, True, False]))
        drawn.append(sampler.next_1d())
    require_equal(*drawn, 4)


@dr.syntax
def sums(sampler: Any, rounds: Any) -> Any:
    """The sum of `rounds` numbers per lane, in a loop."""
    i, total = UInt32(0), Float(0)
    while i < rounds:
        total += sampler.next_1d()
        total += sampler.next_2d().y
        i += 1
    return total


@pytest.mark.sparse(5)
@pytest.mark.parametrize("description", [*SAMPLERS, {"type": "sobol"}], ids=name_of)
def test_loops_carry_a_sampler(description: dict[str, Any]) -> None:
    looped, unrolled = (djpt.load_dict({**description, "sample_count": 16}) for _ in range(2))
    for sampler in (looped, unrolled):
        sampler.seed(1, 8)
    result = sums(looped, UInt32(3) + dr.zeros(UInt32, 8))
    total = Float(0)
    for _ in range(3):
        total += unrolled.next_1d()
        total += unrolled.next_2d().y
    np.testing.assert_allclose(in_numpy(result), in_numpy(total), rtol=1e-6)
    np.testing.assert_allclose(in_numpy(looped.next_1d()), in_numpy(unrolled.next_1d()), rtol=0, atol=1e-7)


def test_a_new_seed_compiles_no_kernel() -> None:
    sampler, hashes = djpt.load_dict({"type": "stratified"}), set()
    for seed in (0, 1, UInt32(2)):
        sampler.seed(seed, 16)
        numbers = sampler.next_2d()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            dr.eval(numbers)
            hashes |= {kernel["hash"] for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT}
    assert len(hashes) == 1


class Steps(djpt.Sampler):
    """A script's sampler: 0, 0.1, 0.2, ..."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.count = UInt32(0)

    def seed(self, seed: Any, wavefront_size: int = 0xFFFFFFFF) -> None:
        super().seed(seed, wavefront_size)
        self.count = UInt32(0)

    def next_1d(self, active: Any = True) -> Float:
        value = Float(self.count % 10) * 0.1
        self.count += 1
        return value

    def next_2d(self, active: Any = True) -> Point2f:
        return Point2f(self.next_1d(), self.next_1d())


def test_scripts_can_write_samplers() -> None:
    djpt.register_sampler("steps", lambda props: Steps(props))
    sampler = djpt.load_dict({"type": "steps", "sample_count": 7})
    sampler.seed(0, 2)
    assert sampler.sample_count() == 7
    first, copy = sampler.next_1d(), sampler.clone()
    assert (first[0], sampler.next_1d()[0]) == (0, pytest.approx(0.1))
    np.testing.assert_allclose(in_numpy(copy.next_2d()).ravel(), [0.1, 0.2], rtol=1e-6)
    sampler.advance()
    np.testing.assert_allclose(in_numpy(sums(sampler, UInt32([1, 2]))), [0.6, 1.8], rtol=1e-5)


@pytest.mark.parametrize("call", ["set_sample_count", "set_samples_per_wavefront"])
def test_impossible_counts(call: str) -> None:
    sampler = djpt.load_dict({"type": "independent", "sample_count": 8})
    with pytest.raises(DjptError, match=r"independent|sampler|sample"):
        getattr(sampler, call)(0)
    with pytest.raises(DjptError, match=r"must divide the sample count, 8; found 3"):
        sampler.set_samples_per_wavefront(3)

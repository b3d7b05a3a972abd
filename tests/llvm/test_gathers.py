"""Gathers by the processor's instruction load what a load per lane does."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.jit.backends import VARIANTS, variant
from djpt.jit.llvm.gathers import FAST, features, gather_as_llvm_does, gather_by_instruction
from djpt.jit.types import Bool, Float, UInt32

pytestmark = pytest.mark.skipif(VARIANTS[variant()] != "llvm", reason="kernels of processors")


def gathered(lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Values of a table of floats and of one of whole numbers, at places out of order, 0 in every third lane."""
    lane = dr.arange(UInt32, lanes)
    place, wanted = (lane * 7919) % 1000, Bool(lane % 3 != 0)
    numbers = dr.arange(UInt32, 1000) * 5 + 1
    floats = dr.sqrt(Float(numbers))
    dr.eval(numbers, floats)
    return np.array(dr.gather(Float, floats, place, wanted)), np.array(dr.gather(UInt32, numbers, place, wanted))


def test_the_backend_asks_for_them() -> None:
    djpt.load_dict(djpt.cornell_box())
    assert (FAST in features()) == ("+avx2" in features() and "+avx512f" not in features())


def test_they_are_asked_for_once() -> None:
    gather_by_instruction()
    gather_by_instruction()
    assert features().count(FAST) <= 1


@pytest.mark.parametrize("lanes", [1, 5, 4096])
def test_they_load_the_same(lanes: int) -> None:
    before = features()
    with gather_as_llvm_does():
        assert FAST not in features()
        expected = gathered(lanes)
    assert features() == before
    for found, of_llvm in zip(gathered(lanes), expected, strict=True):
        np.testing.assert_array_equal(found, of_llvm)
        assert not found[::3].any()

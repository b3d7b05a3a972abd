"""The contract with Dr.Jit's core: each bound function does what djpt relies on, and nothing stops without it."""

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.geometry.bvh.build.functions import can_compile
from djpt.geometry.bvh.calls.searches import why_not
from djpt.jit.llvm import calls, drjit_internals, lanes, masks
from djpt.jit.llvm.drjit_internals import FUNCTIONS, function, missing

pytestmark = pytest.mark.skipif(dr.backend_v(djpt.Float) != dr.JitBackend.LLVM, reason="functions of the LLVM backend")


def test_this_version_of_drjit_has_all_functions() -> None:
    assert missing() == []


def test_lanes() -> None:
    width = function("vector_width")()
    assert width in (4, 8, 16) and lanes.lane_count() == width
    assert lanes.target().processor and any(name.startswith("+") for name in lanes.target().features)


def test_blocks_are_small_for_a_while() -> None:
    usual = function("block_size")()
    with lanes.small_blocks(256):
        assert function("block_size")() == 256
    assert function("block_size")() == usual


def test_addresses_are_those_of_the_memory() -> None:
    array = djpt.UInt32([3, 1, 4, 1, 5])
    dr.eval(array)
    memory = np.ctypeslib.as_array((calls.ctypes.c_uint32 * 5).from_address(calls.address_of(array)))
    assert memory.tolist() == [3, 1, 4, 1, 5]


def test_a_pushed_mask_opens_all_lanes() -> None:
    """Lanes that have left a loop go on writing to local memory within `all_lanes`, and only there."""

    def sums(everywhere: bool) -> list[float]:
        kept, i = dr.alloc_local(djpt.Float, 1, djpt.Float(0)), djpt.UInt32(0)
        ends = dr.arange(djpt.UInt32, 64) % 4

        def body(i: djpt.UInt32, kept: object) -> tuple[djpt.UInt32, object]:
            if everywhere:
                with masks.all_lanes(64):
                    kept[djpt.UInt32(0)] = kept[djpt.UInt32(0)] + 1
            else:
                kept[djpt.UInt32(0)] = kept[djpt.UInt32(0)] + 1
            return i + 1, kept

        _, kept = dr.while_loop((i, kept), lambda i, kept: i < ends, body, labels=("i", "kept"))
        return list(kept[djpt.UInt32(0)].numpy()[:4])

    assert masks.can_unmask()
    assert sums(everywhere=False) == [0, 1, 2, 3]
    assert sums(everywhere=True) == [3, 3, 3, 3]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_rendering_does_without_any_of_them(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each has a slower way, which gives the same image; what can't be known without one is an error."""
    monkeypatch.setitem(FUNCTIONS, name, FUNCTIONS[name]._replace(symbol="_Z4gonev"))
    drjit_internals.function.cache_clear()
    try:
        assert missing() == [name]
        if name in ("block_size", "set_block_size"):
            with lanes.small_blocks():
                pass
        if name.startswith("mask") or name == "release":
            assert not masks.can_unmask()
        if name in ("ray_trace", "pointer", "data", "release"):
            with pytest.raises(calls.CallError, match="no calls of functions"):
                calls.bound(name)
            assert "no calls of functions" in str(calls.reason_against(lambda: bool(calls.bound(name)), "another"))
    finally:
        drjit_internals.function.cache_clear()


def test_no_function_fails_to_compile() -> None:
    """A mistake in the text of one would only make everything slower: `auto` falls back without a word."""
    assert can_compile()
    assert why_not("call") is None
    assert why_not("rings") in (None, "the processor, or Dr.Jit's packets, lack AVX2")

"""Loops whose lanes compute on after their end, because that is cheaper than to stop them.

Dr.Jit keeps the state of lanes that have left a loop by a select for each variable, and so both the old and the new
state in registers until then. Of the two dozen variables of a path few matter once its lane has done its samples.
Local memory is written without selects (`djpt.jit.llvm.masks`), and LLVM turns it into registers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import drjit as dr

from djpt.jit.kernels import mapped, numbers_of, while_loop
from djpt.jit.llvm.masks import all_lanes, can_unmask
from djpt.jit.types import Bool, UInt32

__all__ = ["run_free"]

T = TypeVar("T", bound=Any)


def run_free(
    start: T, condition: Callable[[T], Bool], body: Callable[..., T], lanes: int, label: str, *local: Any
) -> T:
    """Run a loop over the dataclass `start`, whose arrays have `lanes` lanes, and return it as it is at the end.

    Lanes go on until none fulfils the `condition`. So `body` itself must keep the results of those that don't, and
    they must not come to fulfil it again. What it writes to arrays is masked as in any loop. `local` are records of
    local memory, which `body` gets after the state and writes to.
    """
    if not can_unmask():
        end, *_ = while_loop(
            (start, *local),
            lambda state, *local: condition(state),
            lambda state, *local: (body(state, *local), *local),
            label=label,
        )
        return end
    memory = Memory(start, lanes)
    arrays, *_ = while_loop(
        (memory.allocated(), *local),
        lambda arrays, *local: condition(memory.read(arrays)),
        lambda arrays, *local: (memory.write(arrays, body(memory.read(arrays), *local)), *local),
        label=label,
    )
    return memory.read(arrays)


class Memory:
    """A record in the local memory of each lane: an array for each type of number."""

    def __init__(self, record: Any, lanes: int) -> None:
        """Make room for records like `record`."""
        self._record, self._lanes = record, lanes
        self._types = [type(number) for number in numbers_of(record)]
        self._kinds = list(dict.fromkeys(self._types))
        before = [self._types[:i].count(kind) for i, kind in enumerate(self._types)]
        self._places = [(self._kinds.index(kind), n) for kind, n in zip(self._types, before, strict=True)]
        """The array of each number, and its place there."""

    def allocated(self) -> list[Any]:
        """Arrays that hold the record."""
        arrays = [dr.alloc_local(kind, self._types.count(kind)) for kind in self._kinds]
        return self.write(arrays, self._record)

    def read(self, arrays: list[Any]) -> Any:
        """The record in the arrays."""
        with all_lanes(self._lanes):
            found = iter([arrays[kind].read(UInt32(place)) for kind, place in self._places])
        return mapped(self._record, lambda _: next(found))

    def write(self, arrays: list[Any], record: Any) -> list[Any]:
        """Write a record to the arrays and return them."""
        # Dr.Jit's table of equal expressions never forgets a write, 9 KiB per image.
        with all_lanes(self._lanes), dr.scoped_set_flag(dr.JitFlag.ValueNumbering, False):
            for (kind, place), number in zip(self._places, numbers_of(record), strict=True):
                arrays[kind].write(number, UInt32(place))
        return arrays

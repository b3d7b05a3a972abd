"""What stands in a tree with a transform: instances of groups, and analytic solids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from djpt.geometry.bvh.calls.layout import PASSES_LIGHTS, ROW_BYTES, ROW_WORDS
from djpt.geometry.bvh.steps.records import EMITS, ONE_SIDED
from djpt.geometry.query import LABEL, NORMAL
from djpt.jit.llvm.arithmetic import fma
from djpt.jit.llvm.ir import F32, I32, I64, Function, Value

__all__ = ["Features", "Placed", "Triple"]


@dataclass(frozen=True)
class Features:
    """What the functions for a scene must be able to do; they have no code for anything else."""

    instances: bool = False
    kinds: tuple[int, ...] = ()
    """The kinds of analytic solids: numbers into `djpt.geometry.canonical.KINDS`."""
    lights: bool = False
    """Whether shapes emit that rays may pass through."""
    one_sided: bool = False
    """Whether rays pass through some triangles that they meet from behind."""

    @property
    def placed(self) -> bool:
        """Whether anything stands in the tree with a transform."""
        return self.instances or bool(self.kinds)

    def passed(self, f: Function, scene: Value, record: Value, flags: Value) -> Value:
        """Whether a ray with `flags` passes through the shape at a record since it is part of a light."""
        label = f.load(I32, scene.at(record.to(I64) * ROW_BYTES).at(4 * LABEL))
        return ((flags & PASSES_LIGHTS) != 0) & ((label & EMITS) != 0)

    def behind(self, f: Function, scene: Value, record: Value, d: Sequence[Value]) -> Value:
        """Whether a ray along `d` meets a one-sided triangle from behind."""
        row = scene.at(record.to(I64) * ROW_BYTES)
        x, y, z = (f.load(F32, row.at(4 * (NORMAL + axis))) for axis in range(3))
        label = f.load(I32, row.at(4 * LABEL))
        return ((label & ONE_SIDED) != 0) & (fma(x, d[0], fma(y, d[1], z * d[2])) > 0.0)


class Triple(NamedTuple):
    """A point or vector."""

    x: Value
    y: Value
    z: Value


class Placed:
    """A placed primitive; `record` is the number of its second row."""

    def __init__(self, f: Function, scene: Value, record: Value) -> None:
        self._f, self._scene, self.record = f, scene, record
        self._address = scene.at(record.to(I64) * ROW_BYTES).at(-ROW_BYTES)

    def word(self, index: int) -> Value:
        """A whole number of the record."""
        return self._f.load(I32, self._address.at(4 * (ROW_WORDS + index)))

    def float(self, index: int) -> Value:
        """A number of the record."""
        return self._f.load(F32, self._address.at(4 * (ROW_WORDS + index)))

    def into(self, o: Sequence[Value], d: Sequence[Value]) -> tuple[Triple, Triple]:
        """A ray in the primitive's space; distances stay the same."""
        origin, direction = [], []
        for row in range(3):
            x, y, z, shift = (self._f.load(F32, self._address.at(16 * row + 4 * k)) for k in range(4))
            origin.append(fma(x, o[0], fma(y, o[1], z * o[2])) + shift)
            direction.append(fma(x, d[0], fma(y, d[1], z * d[2])))
        return Triple(*origin), Triple(*direction)

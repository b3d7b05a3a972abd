"""Reading the values of plugins as scripts see them: attached to their gradients, where they have any."""

from __future__ import annotations

import functools
from typing import Any

import drjit as dr

from djpt.dispatch.ensemble import BufferTable, Detached, Leaf, TableLeaf
from djpt.dispatch.lookup import MAX_CHAIN, Flat, choose
from djpt.dispatch.tables import Buffer
from djpt.types import Float, UInt32

__all__ = ["Live"]


class Live(Detached):
    """Opaque copies, except that values with gradients are read where they are.

    So what a script computes with a scene's plugins is attached to them. While gradients are suspended, as they are
    while images are rendered, all values are copies.
    """

    @property
    def is_plain(self) -> bool:
        return is_suspended()

    def attaches(self, leaf: Leaf) -> bool:
        return not is_suspended() and any(dr.grad_enabled(row) for row in leaf.rows())

    def __call__(self, leaf: Leaf, slot: UInt32) -> Any:
        if not self.attaches(leaf):
            return super().__call__(leaf, slot)
        rows = leaf.rows()
        if isinstance(leaf, TableLeaf):
            return BufferTable(Buffer(rows, leaf.identity()), slot)
        return choose(slot, rows, leaf.identity()) if len(rows) <= MAX_CHAIN else Flat(rows).at(slot)


@functools.cache
def probe() -> Float:
    """A number with a gradient."""
    with dr.resume_grad():
        number = Float(0)
        dr.enable_grad(number)
    return number


def is_suspended() -> bool:
    """Whether gradients are suspended (`dr.suspend_grad`)."""
    return not dr.grad_enabled(probe())

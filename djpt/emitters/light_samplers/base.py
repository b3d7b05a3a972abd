"""The contract of light samplers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from djpt.jit.types import Float, Point3f, UInt32, Vector3f

if TYPE_CHECKING:
    from djpt.emitters.base import Emitter

__all__ = ["LightSampler"]


class LightSampler:
    """A distribution over a scene's emitters, for a point that light is to be sampled at.

    Built on the host, before kernels are traced; the methods run in kernels.
    """

    uses_normal = False
    """True if the choice depends on the surface normal at the point."""

    def __init__(self, emitters: Sequence[Emitter]) -> None:
        """`emitters`: at least one, in the order in which the scene numbers them."""
        self.count = len(emitters)

    def choose(self, p: Point3f, n: Vector3f | None, u: Float) -> tuple[UInt32, Float, Float]:
        """Choose an emitter for the point `p`: its number, the inverse of its probability, and a fresh uniform number.

        `u` in [0, 1) makes the choice; what it leaves undecided is the new number in [0, 1). The inverse
        probability is 0 where no emitter was chosen. `n` may be None (no surface); its side doesn't matter.
        """
        raise NotImplementedError

    def probability(self, p: Point3f, n: Vector3f | None, index: UInt32) -> Float:
        """The probability that `choose` gives emitter number `index`; unspecified beyond the last."""
        raise NotImplementedError

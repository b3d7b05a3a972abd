"""The ends of paths: after a largest number of edges, and by Russian roulette."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import ClassVar

import drjit as dr

from djpt.description.properties import Properties
from djpt.jit.kernels import maximum, minimum
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.samplers.base import SampleStream

__all__ = ["UNBOUNDED", "Terminating", "first_roulette", "roulette"]

UNBOUNDED = 2**16
"""The edges of the longest path where `max_depth` is -1: without absorption or roulette it would go on for ever."""

LATE = 1000
"""Russian roulette that begins later isn't felt."""


class Terminating:
    """An estimator whose paths end after `max_depth` edges, and from the depth `rr_depth` on by Russian roulette.

    Both attributes are numbers of Python that may be set at any time. Kernels read `longest` and `roulette_from` in
    their place, which are inputs: one kernel is that of all depths. A `max_depth` of 0, a black image, may be another.
    """

    longest: UInt32
    """The edges of the longest path, 1-wide: `max_depth`, or `UNBOUNDED` where that is -1."""
    roulette_from: UInt32
    """`rr_depth`, 1-wide."""

    settings: ClassVar[Sequence[str]] = ("max_depth", "rr_depth")

    _max_depth: int
    _rr_depth: int

    @property
    def max_depth(self) -> int:
        """The edges of the longest path; -1: no limit but `UNBOUNDED`."""
        return self._max_depth

    @max_depth.setter
    def max_depth(self, edges: int) -> None:
        self._max_depth = edges
        self.longest = dr.opaque(UInt32, UNBOUNDED if edges < 0 else edges)

    @property
    def rr_depth(self) -> int:
        """The depth at which Russian roulette begins; integrators without roulette don't have it."""
        return self._rr_depth

    @rr_depth.setter
    def rr_depth(self, depth: int) -> None:
        self._rr_depth = depth
        self.roulette_from = dr.opaque(UInt32, depth)


def first_roulette(props: Properties, max_depth: int) -> int:
    """The parameter `rr_depth`; warns if neither it nor `max_depth` ends paths soon."""
    depth = props.integer("rr_depth", 5, low=1)
    if max_depth < 0 and depth > LATE:
        warnings.warn(
            f"{props.node}: paths may have {UNBOUNDED} edges where little is absorbed, with 'max_depth' -1 and "
            f"'rr_depth' {depth}; bound one of them",
            stacklevel=2,
        )
    return depth


def roulette(sampler: SampleStream, throughput: Color3f, eta: Float | None, begins: Bool) -> tuple[Color3f, Bool]:
    """Russian roulette where it `begins`: survive with the probability min(largest throughput eta^2, 0.95).

    Returns the throughput, divided by this probability, and where paths survive: nowhere if the throughput is 0. The
    probability has no derivative.
    """
    largest = maximum(maximum(throughput.x, throughput.y), throughput.z)
    # Radiance that has been refracted is scaled by 1 / eta^2, which says nothing about its importance.
    survival = dr.detach(minimum(largest if eta is None else largest * dr.square(eta), Float(0.95)))
    survives = ~begins | (sampler.next_1d() < survival)
    return dr.select(begins, throughput * dr.rcp(survival), throughput), (largest > 0) & survives

"""The gaussian filter, the default."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from djpt.description.properties import Properties
from djpt.description.registry import register_rfilter
from djpt.jit.kernels import Arithmetic
from djpt.rfilters.base import ReconstructionFilter

__all__ = ["Gaussian"]

# exp(-y / 2) on 0 <= y <= 16, lowest power first. The constant term is lowered by the value
# that float32 gives at the edge, so that the kernel ends at 0.
MINIMAX = (
    0.99924713,
    -4.977025247e-1,
    1.222248550e-1,
    -1.932406282e-2,
    2.136713061e-3,
    -1.679873860e-4,
    9.202145248e-6,
    -3.329417433e-7,
    7.128382794e-9,
    -6.821193280e-11,
)

MOST = 64.0
"""The largest standard deviation: beyond, a pixel would read more than 500^2 samples for each one of its own."""


class Gaussian(ReconstructionFilter):
    """max(0, exp(-x^2 / (2 stddev^2)) - exp(-radius^2 / (2 stddev^2))) with radius = 4 stddev.

    Parameters: `stddev` (pixels, in (0, 64], default 0.5). The time that the film takes grows with its square: above 4
    all samples are stored and read again by each pixel in reach.

    The exponential is a polynomial in y = x^2 / stddev^2, much faster than `dr.exp`. It is the
    minimax fit of degree 9 that Mitsuba uses, so that filtered images can be compared pixel by
    pixel; it differs from the formula by up to 7e-4. As there, the fit isn't cut off at the radius:
    in the half pixel beyond, where films still evaluate it, it is at most 1.4e-5 and then 0.
    """

    statics = settings = ("stddev",)
    has_lobes = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.stddev = props.float("stddev", 0.5, low=0.0, low_open=True, high=MOST)
        self.reach = 4 * self.stddev

    def formula(self, m: Arithmetic, x: Any) -> Any:
        y = x * x
        scale = 1 / self.stddev**2
        w = estrin(m, y, [c * scale**i for i, c in enumerate(MINIMAX)])
        return m.select(w > 0, w, 0)


def estrin(m: Arithmetic, x: Any, coefficients: Sequence[Any]) -> Any:
    """A polynomial, lowest coefficient first, by Estrin's scheme: pairs in parallel, then pairs of pairs.

    Near the edge terms of size 1 cancel to 1e-6, so the order of operations shows: it is
    Dr.Jit's, which Mitsuba uses.
    """
    if len(coefficients) == 1:
        return coefficients[0]
    paired = [m.fma(x, coefficients[i + 1], coefficients[i]) for i in range(0, len(coefficients) - 1, 2)]
    if len(coefficients) % 2:
        paired.append(coefficients[-1])
    return estrin(m, x * x, paired)


register_rfilter("gaussian", Gaussian)

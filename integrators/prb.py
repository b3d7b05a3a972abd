"""Path replay backpropagation."""

from __future__ import annotations

from djpt.core.records import SurfaceInteraction3f
from djpt.description.registry import register_integrator
from djpt.integrators.base import PathState
from djpt.integrators.path import Path
from djpt.jit.types import Bool, UInt32

__all__ = ["PRB"]


class PRB(Path):
    """`path` under the name and with the defaults of Mitsuba's differentiable path tracer.

    Gradients of both come from path replay (`djpt.rendering.gradients.replay`): D. Vicini, S. Speierer and W. Jakob,
    "Path Replay Backpropagation", SIGGRAPH 2021. Sampling decisions are detached.

    Parameters: as `path`, with `max_depth` 6 by default. Russian roulette starts one vertex
    later than in `path`, and an environment isn't covered (alpha 0), as in Mitsuba.
    """

    pure = True
    in_any_frame = True

    default_max_depth = 6
    covers_sky = False

    def roulette_depth(self, depth: UInt32) -> UInt32:
        return depth

    def covered(self, state: PathState, si: SurfaceInteraction3f, passes: Bool) -> Bool:
        """Openings count as surfaces here."""
        return (state.depth > 0) | si.is_valid()


register_integrator("prb", PRB)

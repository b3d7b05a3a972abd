"""Path replay as integrators of scripts: `prb` and `prb_basic` with the method `sample` that scripts override."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.description.properties import Properties
from djpt.dispatch.ensemble import Attached
from djpt.integrators.ad_integrator import RBIntegrator
from djpt.integrators.base import PathIntegrator, trace_path
from djpt.integrators.prb import PRB
from djpt.integrators.prb_basic import PRBBasic
from djpt.jit.types import Bool, Color3f, Float
from djpt.rendering.gradients.lane_replay import measured, replayed

__all__ = ["BasicPRBIntegrator", "PRBIntegrator"]


class PathReplay(RBIntegrator, PathIntegrator):
    """An integrator that advances vertex by vertex, with one lane per sample.

    `djpt.render` of the plugin of the same name gives the same image and the same gradients, faster: its lanes don't
    wait for each other's paths.
    """

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if self.aov_names():
            raise props.error("bounces", f"isn't supported by '{type(self).__name__}': use the plugin 'path'")

    def sample(  # type: ignore[override]
        self,
        mode: dr.ADMode,
        scene: Any,
        sampler: Any,
        ray: Any,
        δL: Color3f | None,
        state_in: Any,
        active: Bool | bool,
        **kwargs: Any,
    ) -> tuple[Color3f, Bool, list[Float], Any]:
        """The result of all samples: see `ADIntegrator.sample`.

        The state is the radiance; before a second run, a `Measured`: what the second run needs to know of each path.
        """
        scene = scene.replace(emitter_choice=self.emitter_choice)
        if mode == dr.ADMode.Primal and isinstance(scene.lookup, Attached):
            found = measured(self, scene, sampler, ray, active)
            return found.radiance, Bool(True), [], found
        if mode == dr.ADMode.Primal:
            (radiance,), valid = trace_path(self, scene, sampler, ray, active)
            return radiance, valid, [], radiance
        change = replayed(self, mode, scene, sampler, ray, state_in, δL, active)
        return change, Bool(True), [], state_in


class PRBIntegrator(PathReplay, PRB):  # type: ignore[misc]
    """Path replay backpropagation (D. Vicini, S. Speierer and W. Jakob, SIGGRAPH 2021), for scripts to derive from.

    Parameters: as `prb`. Paths and random numbers are those of Mitsuba's.
    """


class BasicPRBIntegrator(PathReplay, PRBBasic):  # type: ignore[misc]
    """Path replay without light sampling and Russian roulette, for scripts to derive from.

    Parameters: as `prb_basic`. Paths and random numbers are those of Mitsuba's.
    """

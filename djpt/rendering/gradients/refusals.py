"""The refusal of derivatives that are known to be wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.errors import RenderError
from djpt.jit.frozen import recording
from djpt.rendering.gradients.unproven import CASES, Rendering
from djpt.rendering.gradients.unproven_cameras import CAMERA_CASES

if TYPE_CHECKING:
    from djpt.integrators.base import Integrator
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["require_proven"]


def require_proven(scene: Scene, integrator: Integrator, sensor: Sensor | None = None) -> None:
    """Refuse derivatives that are known to be wrong, unless `integrator.unproven_gradients` is true.

    Called where derivatives of an image are asked for, with the scene whose parameters have gradients.

    Raises:
        RenderError: It names the nodes, what is wrong, and what can be done.
    """
    if integrator.unproven_gradients:
        return
    rendering = Rendering.of(scene, integrator, sensor)
    movers = rendering.movers() or [emitter for emitter in scene.emitters() if emitter.is_moving()]
    if not movers:
        return
    what = f"'{movers[-1].id()}' moves with parameters that have gradients"
    cases = CASES
    if rendering.camera is not None and integrator.follows_camera:
        cases = CAMERA_CASES
    for case in cases:
        if case.needs_numbers and recording():
            continue
        node = next(case.found(rendering), None)
        if node is not None:
            raise refusal(what, f"{node}, and {case.reason}", case.way_out)


def refusal(what: str, why: str, way_out: str) -> RenderError:
    """The error for a case."""
    return RenderError(
        f"{what}, but the derivatives would be wrong: {why}. Possible: {way_out}; or, to get them all the same, set "
        "'unproven_gradients' of the integrator to true"
    )

"""Cameras that move in indirect light: rules by which more of a path stays than by that of `reattach`.

By that rule hits slide over surfaces as the camera moves, while what they see stays: where two surfaces touch, the
variance has no bound. In the light of emitters alone hits that slide have less noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from djpt.description.properties import Properties
from djpt.integrators.ad_integrator import UNBOUNDED
from djpt.integrators.projective.moving_camera import parts_of_image
from djpt.integrators.projective.turning_camera import StillRays, turned_apart
from djpt.integrators.volpath import VolumetricPath
from djpt.jit.frozen import recording
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.unproven import Rendering, moves
from djpt.rendering.gradients.unproven_cameras import CAMERA_CASES
from djpt.sensors.moving import still

__all__ = ["CameraApart", "camera_apart"]

RAYS = 8
"""How many rays that stay stand for a sample: they take less than a tenth of the time of one by the other rules."""


@dataclass(frozen=True)
class CameraApart:
    """The parts of a camera's motion that such rules follow: views of the camera that move by a part each."""

    turning: Any
    """One whose centre stays, and with it all rays, as it turns or zooms; None if it doesn't."""
    moving: Any
    """One before which vertices stay, with the light of emitters left out; None if they can't."""
    rest: Any
    """One that moves by all else."""

    def parts_of_image(self, integrator: Any, scene: Any, seed: Any, spp: int) -> Iterator[TensorXf]:
        """The parts of an image that these rules give: see `djpt.integrators.projective.moving_camera`."""
        if self.turning is not None:
            yield from parts_of_image(integrator, scene, self.turning, RAYS * spp, seed, kind=StillRays)
        if self.moving is not None:
            entries = {
                "max_depth": -1 if integrator.max_depth == UNBOUNDED else integrator.max_depth,
                "rr_depth": integrator.rr_depth,
                "hide_emitters": integrator.hide_emitters,
            }
            paths = VolumetricPath(Properties("volpath", "integrator", entries))
            yield from parts_of_image(paths, scene, self.moving, spp, seed, indirect=True)


def camera_apart(integrator: Any, scene: Any, camera: Any, spp: int, forward: bool) -> CameraApart | None:
    """The parts of a camera's motion that such rules follow; None if there are none, or no indirect light.

    Rays stay before any scene as a pinhole camera turns. Vertices stay if nothing else moves, and no surface shows
    things that move otherwise.

    Args:
        integrator: a `djpt.integrators.projective.projective_sampling.PSIntegrator`.
        scene: the scene.
        camera: the camera, or a batch.
        spp: the samples per pixel of the call.
        forward: whether gradients are propagated forward, so that those of 0 count as none.
    """
    if integrator.direct_light_only or integrator.max_depth <= 2 or recording() or 0 in integrator.counts(camera, spp):
        return None
    if not camera.attached_names() or integrator.aov_names():
        return None
    turned, camera = turned_apart(scene, camera, forward)
    if camera.attached_names() and not moves(scene, None):
        rendering = Rendering.of(scene, integrator, camera)
        if not any(True for case in CAMERA_CASES for _ in case.found(rendering)):
            return CameraApart(turned, camera, still(camera))
    return None if turned is None else CameraApart(turned, None, camera)

"""Cameras that move alone, in indirect light: rules by which more of a path stays than by that of `reattach`.

By that rule hits slide over surfaces as the camera moves, while what they see stays: where two surfaces touch, the
variance has no bound. In the light of emitters hits that slide have less noise, so others are for paths of three edges
and more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from djpt.description.properties import Properties
from djpt.integrators.ad_integrator import UNBOUNDED
from djpt.integrators.projective.moving_camera import parts_of_image
from djpt.integrators.projective.turning_camera import StillRays
from djpt.integrators.volpath import VolumetricPath
from djpt.jit.frozen import recording
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.unproven import Rendering, moves
from djpt.rendering.gradients.unproven_cameras import CAMERA_CASES, other_cameras
from djpt.sensors.moving import has_motion, shifting, still, turning

__all__ = ["CameraApart", "camera_apart"]


@dataclass(frozen=True)
class CameraApart:
    """The part of a camera's motion that such a rule follows."""

    camera: Any
    """A view of the camera that moves by this part alone."""
    rest: Any
    """One that moves by all else."""
    rays_stay: bool
    """Whether all rays stay, as the camera turns or zooms; otherwise vertices do, and it may move in any way."""

    def parts_of_image(self, integrator: Any, scene: Any, seed: Any, spp: int) -> Iterator[TensorXf]:
        """The parts of an image in indirect light, see `djpt.integrators.projective.moving_camera.parts_of_image`."""
        if self.rays_stay:
            return parts_of_image(integrator, scene, self.camera, spp, seed, kind=StillRays)
        entries = {
            "max_depth": -1 if integrator.max_depth == UNBOUNDED else integrator.max_depth,
            "rr_depth": integrator.rr_depth,
            "hide_emitters": integrator.hide_emitters,
        }
        paths = VolumetricPath(Properties("volpath", "integrator", entries))
        return parts_of_image(paths, scene, self.camera, spp, seed, indirect=True)


def camera_apart(integrator: Any, scene: Any, camera: Any, spp: int, forward: bool) -> CameraApart | None:
    """The part of a camera's motion that such a rule follows; None if there is none, or no indirect light.

    Vertices stay if no surface shows things that move otherwise; rays do before any scene.

    Args:
        integrator: a `djpt.integrators.projective.projective_sampling.PSIntegrator`.
        scene: the scene.
        camera: the camera, or a batch.
        spp: the samples per pixel of the call.
        forward: whether gradients are propagated forward, so that those of 0 count as none.
    """
    if integrator.direct_light_only or integrator.max_depth <= 2 or recording() or 0 in integrator.counts(camera, spp):
        return None
    if not camera.attached_names() or moves(scene, None):
        return None
    rendering = Rendering.of(scene, integrator, camera)
    if not any(True for case in CAMERA_CASES for _ in case.found(rendering)):
        return CameraApart(camera, still(camera), rays_stay=False)
    pinholes = all(member.is_central and not member.uses_aperture for member in camera.members())
    if not pinholes or any(True for _ in other_cameras(rendering)) or not has_motion(turning(camera), forward):
        return None
    rest = shifting(camera)
    return CameraApart(turning(camera), rest if has_motion(rest, forward) else still(camera), rays_stay=True)

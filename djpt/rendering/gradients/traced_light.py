"""The light paths of `ptracer`, as replay follows them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.integrators.ptracer import ParticleTracer
from djpt.jit.types import Bool, Color3f, UInt32
from djpt.rendering.gradients.light_replay import Step, begun
from djpt.rendering.schedules.job import Job
from djpt.samplers.base import SampleStream
from djpt.scene.scene import Scene

__all__ = ["TracedLight"]


class TracedLight:
    """The light paths number `begin` <= n < `end` of an image, one per lane, as `light_replay` follows them."""

    def __init__(self, job: Job, scene: Scene, begin: int, end: int) -> None:
        """`scene` is a view whose lookups are attached."""
        assert isinstance(job.integrator, ParticleTracer)
        self._job, self._scene, self._integrator = job, scene, job.integrator
        self._number = dr.arange(UInt32, end - begin) + dr.opaque(UInt32, begin)

    def sampler(self) -> SampleStream:
        """The random numbers of the paths, from the first one on."""
        return self._job.light_stream(self._number)

    def begin(self, sampler: SampleStream) -> tuple[Any, Color3f, Color3f | None]:
        """See `LightPaths`."""
        path = self._integrator.start(self._scene, sampler)
        flux, zero_weight = begun(self._scene, path.flux, path.flux * path.unit)
        return replace(path, flux=flux, zero_weight=zero_weight), flux, zero_weight

    def hit(self, ray: Ray3f, active: Bool) -> SurfaceInteraction3f:
        """Where a ray arrives."""
        scene = self._scene
        return scene.surface_interaction(ray, scene.closest_hit(ray), scene.surface_detail)

    def step(self, state: Any, sampler: SampleStream, active: Bool) -> Step:
        """See `LightPaths`."""
        scene, si = self._scene, self.hit(state.ray, active)
        arriving = replace(state, flux=state.flux * scene.media.transmittance(state.ray, si.t))
        v = self._integrator.vertex(scene, self._job.camera, sampler, arriving, si)
        light = self._integrator.seen(scene, v)
        return Step(
            arrived=arriving.flux,
            position=v.position,
            light=light,
            shows=si.is_valid(),
            onward=v.path.flux,
            state=v.path,
            active=v.active,
            zero_weight=v.path.zero_weight,
            joins=Bool(False),
        )

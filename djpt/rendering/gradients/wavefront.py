"""Path replay of wavefronts: for samplers that are nothing but a stream of lanes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from djpt.integrators.base import PathIntegrator
from djpt.jit.types import Color3f, TensorXf
from djpt.rendering.gradients.derivatives import AttachedDerivative, on_grid, over_weights
from djpt.rendering.gradients.fresh_leaves import attached_view, spread
from djpt.rendering.gradients.lane_replay import measured, replayed
from djpt.rendering.schedules.job import Band
from djpt.rendering.schedules.passes import image_of_samples
from djpt.rendering.schedules.reconstruction import sample_adjoints
from djpt.rendering.schedules.wavefront import WavefrontJob

__all__ = ["WavefrontDerivative"]


class WavefrontDerivative(AttachedDerivative):
    """The derivative of an image by path replay with one path per lane, all samples at once."""

    at_once = "in one wavefront, because the sampler has no 'stream' for each sample"

    def backward(self, image: TensorXf) -> list[Any]:
        job = self._job()
        with dr.suspend_grad():
            adjoints = over_weights(job, on_grid(job, image))
            deltas = sample_adjoints(job, Band(0, job.height), adjoints, 0, job.spp)
            delta = job.color_adjoint(job.by_lanes(deltas))
            dr.eval(delta)
        fresh, _ = self._replayed(dr.ADMode.Backward, delta)
        dr.eval()  # the replay writes to the gradients
        return [dr.grad(leaf) for leaf in fresh]

    def forward(self, tangents: list[Any]) -> TensorXf:
        job = self._job()
        _, change = self._replayed(dr.ADMode.Forward, None, tangents)
        with dr.suspend_grad():
            return image_of_samples(job, job.by_samples(job.tangent_channels(change)))

    def _job(self) -> WavefrontJob:
        assert isinstance(self.job, WavefrontJob)
        return self.job

    def _replayed(
        self, mode: dr.ADMode, delta: Color3f | None, tangents: Sequence[Any] | None = None
    ) -> tuple[list[Any], Color3f]:
        """Fresh leaves in place of the parameters, which gradients have been propagated to, or from; and `replayed`."""
        job, integrator = self._job(), self.job.integrator
        assert isinstance(integrator, PathIntegrator)
        with dr.resume_grad():
            fresh, places = self.leaves.made(tangents)
            scene = attached_view(job.scene, places)
            if tangents is not None:
                spread(fresh)
        with dr.suspend_grad():
            sampler = job.begun(job.spp)
            ray = job.rays(sampler, 0, job.spp)
            found = measured(integrator, scene, sampler.clone(), ray)
            dr.eval(found)
            return fresh, replayed(integrator, mode, scene, sampler, ray, found, delta)

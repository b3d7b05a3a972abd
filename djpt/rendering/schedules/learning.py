"""The learning schedule: training paths, then the image by the schedule that is fastest for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.description.properties import Properties
from djpt.errors import RenderError
from djpt.integrators.guiding.training import LearningIntegrator
from djpt.jit.frozen import recording
from djpt.jit.types import UInt32
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.passes import report
from djpt.rendering.schedules.reconstruction import Summed
from djpt.samplers import SampleIndex, SampleStream
from djpt.samplers.independent import Independent
from djpt.samplers.seeds import sample_tea_32

__all__ = ["Learning"]

TRAINING_SEED = 5
"""The number of the seed of training paths, among those that are derived from an image's."""

GOLDEN = 2654435769
"""2^32 over the golden ratio: its multiples, modulo 2^32, are spread evenly."""


class Learning(Schedule):
    """Runs a `LearningIntegrator`: the trained integrator is rendered by another schedule."""

    name = "learning"
    can_be_recorded = False  # what is learned are results of kernels

    def rows(self, job: Job) -> Iterator[Summed]:
        job = trained(job)
        return choose("auto", job).rows(job)


def trained(job: Job) -> Job:
    """The job with an integrator that has learned."""
    integrator = job.integrator
    assert isinstance(integrator, LearningIntegrator)
    if recording():
        raise RenderError(
            f"{integrator.id()}: a frozen function can't learn about a scene, since that needs the results of kernels; "
            "render it outside of the function, or with 'path'"
        )
    return replace(job, integrator=integrator.trained(JobTrainingPaths(job)))


class JobTrainingPaths:
    """A job as a `LearningIntegrator` sees it: see `djpt.integrators.guiding.training.TrainingPaths`."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._sampler = Independent(Properties("independent", "sampler", {}))
        self._seed = sample_tea_32(job.seed_value, UInt32(TRAINING_SEED))[0]
        dr.eval(self._seed)
        self.scene, self.samples = job.scene, job.samples

    def begin(self, first: int, end: int) -> tuple[SampleStream, Ray3f]:
        """Random numbers and camera rays, see `djpt.integrators.guiding.training.TrainingPaths`."""
        job = self._job
        number = dr.arange(UInt32, end - first) + dr.opaque(UInt32, first)
        pixel: Any = dr.mul_hi(number * GOLDEN, dr.opaque(UInt32, job.width * job.height))
        stream = self._sampler.stream(self._seed, SampleIndex(UInt32(0), number, job.spp_value, job.width_value))
        ray, _ = job.sampled_ray(stream, pixel, *job.coordinates(pixel))
        return stream, ray

    def pause(self) -> None:
        """Stop here if somebody has asked for it."""
        report(self._job, 0)

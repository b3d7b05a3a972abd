"""The splatting schedule: a lane is a sample, which adds light to other pixels, too."""

from __future__ import annotations

import functools

import drjit as dr

from djpt.films.splats import Splats
from djpt.integrators.splatting import SplattingIntegrator
from djpt.schedules.base import Schedule
from djpt.schedules.canvas import picture
from djpt.schedules.job import Band, Job
from djpt.schedules.lanes import grouped
from djpt.schedules.passes import stored_image
from djpt.types import Bool, Color3f, Float, TensorXf, UInt32

__all__ = ["Splatting"]


class Splatting(Schedule):
    """Runs a `SplattingIntegrator`: the image is that of the samples' values, plus the sums of what they add."""

    name = "splatting"

    def image(self, job: Job) -> TensorXf:
        assert isinstance(job.integrator, SplattingIntegrator)
        layers = len(job.integrator.layer_names())
        splats = Splats(job.film, job.scene.brightness, 1 + layers // 3)
        image = stored_image(job, functools.partial(splatted, splats))
        inverse = dr.rcp(dr.opaque(Float, job.spp))
        # Camera rays outside of the crop bring all light, since no other adds to them.
        colors = [Color3f(*splats.sums(0, continued=job.film.border > 0)) * inverse]
        colors += [Color3f(*splats.sums(1 + layer)) * inverse for layer in range(layers // 3)]
        aovs = [Float(0)] * len(job.integrator.aov_names())
        channels = job.channels(colors[0], Bool(False), aovs)
        further = [c for color in colors[1:] for c in color]
        dr.eval(channels, further)
        size = job.film.crop_size()
        image = image + picture(channels, *size)
        return dr.concat([image, picture(further, *size)], axis=2) if further else image


def splatted(splats: Splats, job: Job, band: Band, begin: int, end: int) -> list[Float]:
    """Compute the samples begin <= k < end of a band, and add their light to `splats`."""
    integrator = job.integrator
    assert isinstance(integrator, SplattingIntegrator)
    layer, pixel = grouped(job, band, end - begin)
    x, y = job.coordinates(pixel)
    stream, ray, offset = job.begin(pixel, layer + dr.opaque(UInt32, begin), x, y)
    position = job.in_crop(x, y, offset)
    return job.channels(*integrator.splat_sample(job.scene, job.camera, stream, ray, position, splats))

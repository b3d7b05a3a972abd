"""The splatting schedule: a lane is a sample, which adds light to other pixels, too."""

from __future__ import annotations

import drjit as dr

from djpt.films.footprint import Splats
from djpt.integrators.base import Integrator
from djpt.integrators.bidirectional.strategies import SplattingIntegrator
from djpt.jit.types import Bool, Color3f, Float, TensorXf, UInt32
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import grouped
from djpt.rendering.schedules.passes import stored_rows
from djpt.rendering.schedules.reconstruction import image_of_rows, picture

__all__ = ["SplattedSamples", "Splatting"]


class Splatting(Schedule):
    """Runs a `SplattingIntegrator`: the image is that of the samples' values, plus the sums of what they add."""

    name = "splatting"
    in_bands = False

    def image(self, job: Job) -> TensorXf:
        assert isinstance(job.integrator, SplattingIntegrator)
        layers = len(job.integrator.layer_names())
        splats = Splats(job.film, job.scene.lights.brightness, 1 + layers // 3)
        samples = self.samples_with(splats)
        image = image_of_rows(job, stored_rows(job, samples, *samples.passes(job)))
        # As many as `job.spp`, unless a signal ended the last pass.
        inverse = dr.rcp(dr.opaque(Float, samples.count / (job.width * job.height)))
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

    def samples_with(self, splats: Splats) -> SplattedSamples:
        """The function that computes samples, and adds their light for other pixels to `splats`."""
        return SplattedSamples(splats)


class SplattedSamples:
    """Computes samples, adds the light that they bring to other pixels to `splats`, and counts them."""

    def __init__(self, splats: Splats) -> None:
        self._splats = splats
        self.count = 0

    def passes(self, job: Job) -> tuple[int, int]:
        """The pixels of a band and the samples per pixel of a pass, where nobody waits for it; 0: as many as suit."""
        return 0, 0

    def __call__(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        """The samples begin <= k < end of a band."""
        layer, pixel = grouped(job, band, end - begin)
        return self.values(job, job.integrator, pixel, layer + dr.opaque(UInt32, begin))

    def values(self, job: Job, integrator: Integrator, pixel: UInt32, k: UInt32) -> list[Float]:
        """The channels of the sample number `k` of a pixel, per lane; the `integrator` may differ from the job's."""
        assert isinstance(integrator, SplattingIntegrator)
        self.count += dr.width(pixel)
        x, y = job.coordinates(pixel)
        stream, ray, offset = job.begin(pixel, k, x, y)
        position = job.in_crop(x, y, offset)
        return job.channels(*integrator.splat_sample(job.scene, job.camera, stream, ray, position, self._splats))

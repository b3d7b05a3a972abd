"""Derivatives of images that light paths add to: by replay, pass by pass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import drjit as dr

from djpt.errors import RenderError
from djpt.films.footprint import ChangeSplats, SpreadReader, in_window
from djpt.integrators.bdpt import BidirectionalPath
from djpt.integrators.ptracer import ParticleTracer
from djpt.jit.types import Color3f, Float, TensorXf, UInt32
from djpt.rendering.gradients.bidirectional import BothEnds
from djpt.rendering.gradients.derivatives import Derivative, NoDerivative, ReplayDerivative, add, on_grid, over_weights
from djpt.rendering.gradients.fresh_leaves import FreshLeaves, spread
from djpt.rendering.gradients.gradient_sums import Forward, Measure, Reverse
from djpt.rendering.gradients.leaves import Parameter
from djpt.rendering.gradients.light_replay import nothing, walk_light_paths
from djpt.rendering.gradients.traced_light import TracedLight
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import grouped
from djpt.rendering.schedules.passes import ranges, stored_passes, stored_rows
from djpt.rendering.schedules.reconstruction import image_of_rows, picture, sample_adjoints
from djpt.rendering.schedules.wave import Wave
from djpt.scene.scene import Scene

__all__ = [
    "BothEndsDerivative",
    "TracedLightDerivative",
    "adjoints_of_light",
    "light_derivative",
    "light_image",
    "passes_of_paths",
    "straight_light",
]

PASS_PATHS, PASS_PAIRS = 2**17, 2**18
"""Light paths of a pass, and pairs of paths that are joined. Each pass has sums of its own, so that they don't outgrow
what they are increased by: for one pass of 2^21 pairs, which add to them many times, they were 0.1 % too small."""


def light_derivative(job: Job, parameters: list[Parameter]) -> Derivative:
    """The estimator of the derivative of an image by an integrator that starts at lights.

    Raises:
        RenderError: It follows media that scatter light.
    """
    if job.scene.media.scatter:
        raise RenderError(
            f"'{type(job.integrator).__name__}' has no derivatives in media that scatter light; 'prbvolpath' has"
        )
    by = TracedLightDerivative if isinstance(job.integrator, ParticleTracer) else BothEndsDerivative
    return by(job, parameters)


def gradients(fresh: list[Any]) -> list[Any]:
    """The gradients of leaves after a replay."""
    dr.eval()  # what the replay writes to
    with dr.resume_grad():
        return [dr.grad(leaf) for leaf in fresh]


def adjoints_of_light(job: Job, image: TensorXf, continued: bool) -> SpreadReader:
    """Derivatives of a loss by light that is added to the film, from those with respect to the pixels.

    `continued` is as for `Splats.sums`.
    """
    height, width, channels = image.shape
    entry = dr.arange(UInt32, width * height) * channels
    of_pixel = job.color_adjoint([dr.gather(Float, image.array, entry + c) for c in range(channels)])
    reader = SpreadReader(job.film)
    scale = dr.rcp(dr.opaque(Float, job.spp))
    if job.film.filters and not continued:
        scale = scale * dr.rcp(reader.shares_inside())
    reader.hold(of_pixel * scale)
    return reader


def light_image(job: Job, changes: ChangeSplats, continued: bool) -> TensorXf:
    """The derivative of the image of the light that is added to the film."""
    channels = job.tangent_channels(Color3f(*changes.sums(0, continued)) * dr.rcp(dr.opaque(Float, job.spp)))
    dr.eval(channels)
    return picture(channels, *job.film.crop_size())


class BothEndsDerivative:
    """The derivative of an image by `bdpt`."""

    def __init__(self, job: Job, parameters: list[Parameter]) -> None:
        self._job, self._leaves = job, FreshLeaves(parameters)
        self._continued = job.film.border > 0

    def backward(self, image: TensorXf) -> list[Any]:
        job = self._job
        with dr.suspend_grad():
            adjoints = over_weights(job, on_grid(job, image))
            pixels = adjoints_of_light(job, image, self._continued)

            def of_pass(band: Band, begin: int, end: int) -> list[Any]:
                delta = job.color_adjoint(sample_adjoints(job, band, adjoints, begin, end))
                dr.eval(delta)
                with self._leaves.attached(job.scene) as (fresh, scene), dr.suspend_grad():
                    paths, sampler = self._paths(scene, band, begin, end)
                    paths.reverse(Measure(pixels), Reverse(pixels), sampler, delta)
                    return gradients(fresh)

            return add(of_pass(*part) for part in stored_passes(job, PASS_PAIRS))

    def forward(self, tangents: list[Any]) -> TensorXf:
        changes = ChangeSplats(self._job.film)

        def samples(job: Job, band: Band, begin: int, end: int) -> list[Float]:
            with self._leaves.attached(job.scene, tangents) as (fresh, scene), dr.suspend_grad():
                spread(fresh)
                paths, sampler = self._paths(scene, band, begin, end)
                return job.tangent_channels(paths.forward(Forward(changes), sampler))

        with dr.suspend_grad():
            image = image_of_rows(self._job, stored_rows(self._job, samples))
            return image + light_image(self._job, changes, self._continued)

    def _paths(self, scene: Scene, band: Band, begin: int, end: int) -> tuple[BothEnds, Any]:
        """The samples begin <= k < end of a band, and their random numbers."""
        job = self._job
        assert isinstance(job.integrator, BidirectionalPath)
        layer, pixel = grouped(job, band, end - begin)
        x, y = job.coordinates(pixel)
        sampler, ray, offset = job.begin(pixel, layer + dr.opaque(UInt32, begin), x, y)
        inside = in_window(job.in_crop(x, y, offset))
        return BothEnds(job.integrator, scene, job.camera, ray, inside, dr.width(pixel)), sampler


def passes_of_paths(job: Job, most: int) -> Iterator[tuple[int, int]]:
    """The numbers begin <= n < end of an image's light paths, pass by pass; at most so many in each."""
    width, height = job.film.crop_size()
    return ranges(width * height * job.spp, most)


def straight_light(job: Job, parameters: list[Parameter]) -> Derivative:
    """The derivative of what the camera sees of lights, in an image by `ptracer`."""
    assert isinstance(job.integrator, ParticleTracer)
    seen = replace(job, integrator=job.integrator.from_camera, spp=job.sampler.round_count(job.spp))
    return ReplayDerivative(seen, Wave(), parameters) if parameters else NoDerivative(seen)


class TracedLightDerivative:
    """The derivative of an image by `ptracer`: of what light paths show, and of what the camera sees of lights."""

    def __init__(self, job: Job, parameters: list[Parameter]) -> None:
        self._job, self._leaves = job, FreshLeaves(parameters)
        self._straight = straight_light(job, parameters)

    def backward(self, image: TensorXf) -> list[Any]:
        with dr.suspend_grad():
            pixels = adjoints_of_light(self._job, image, False)

            def of_pass(begin: int, end: int) -> list[Any]:
                with self._leaves.attached(self._job.scene) as (fresh, scene), dr.suspend_grad():
                    paths, lanes = TracedLight(self._job, scene, begin, end), end - begin
                    empty = nothing(scene, lanes)
                    total = walk_light_paths(paths, Measure(pixels), paths.sampler(), lanes, empty).carried
                    walk_light_paths(paths, Reverse(pixels), paths.sampler(), lanes, total)
                    return gradients(fresh)

            by_light = add(of_pass(*part) for part in passes_of_paths(self._job, PASS_PATHS))
        return [a + b for a, b in zip(by_light, self._straight.backward(image), strict=True)]

    def forward(self, tangents: list[Any]) -> TensorXf:
        job, changes = self._job, ChangeSplats(self._job.film)
        with dr.suspend_grad():
            for begin, end in passes_of_paths(job, PASS_PATHS):
                with self._leaves.attached(job.scene, tangents) as (fresh, scene), dr.suspend_grad():
                    spread(fresh)
                    paths, lanes = TracedLight(job, scene, begin, end), end - begin
                    walk = walk_light_paths(paths, Forward(changes), paths.sampler(), lanes, nothing(scene, lanes))
                    dr.eval(walk.count, changes.memory)
            return light_image(job, changes, False) + self._straight.forward(tangents)

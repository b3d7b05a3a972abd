"""Differentiable images: `render` as an operation that Dr.Jit can differentiate.

The image itself is rendered without derivative tracking. Its derivatives are estimated when
they are asked for, with samples of their own, in one of two modes:

* reverse: from the derivative of a loss with respect to each pixel to one gradient per parameter;
* forward: from a change of the parameters to a change of the image.

Integrators that advance vertex by vertex are differentiated by path replay; those that only
offer `sample` by Dr.Jit's automatic differentiation of their code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Protocol, cast

import drjit as dr

from djpt.dispatch.ensemble import Attached, Detached
from djpt.errors import RenderError
from djpt.jit.frozen import recording, undifferentiated
from djpt.jit.kernels import begin_trace
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Bool, Color3f, Float, TensorXf, UInt32
from djpt.rendering.gradients.fresh_leaves import FreshLeaves
from djpt.rendering.gradients.leaves import Accumulator, Numbering, Parameter, Tangents
from djpt.rendering.gradients.modes import Forward, Mode, Reverse
from djpt.rendering.schedules.base import ModeOf, Schedule
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.passes import (
    image_of_samples,
    one_ahead,
    ranges,
    register_spp,
    stored_passes,
    stored_pixels,
    stored_rows,
    summed_rows,
)
from djpt.rendering.schedules.reconstruction import add_samples, collected, image_of_rows, sample_adjoints
from djpt.rendering.schedules.sinks import blank_sums, sample_buffers

__all__ = [
    "AttachedDerivative",
    "Derivative",
    "NoDerivative",
    "ReplayDerivative",
    "add",
    "attached_image",
    "on_grid",
    "over_weights",
    "propagated",
]

MAX_ATTACHED_SAMPLES = 2**25
"""The largest number of samples for plain AD, which holds the graph of all of them at once."""


def attached_image(
    parameters: list[Parameter], unused: list[Any], primal: Callable[[], TensorXf], derivative: Derivative
) -> TensorXf:
    """The image `primal()`, attached to `parameters` by an estimator of its derivative, and to `unused` values."""
    return dr.custom(ImageOp, [p.value for p in parameters], unused, primal, derivative)


def propagated(image: TensorXf, grad: TensorXf | None) -> TensorXf:
    """Propagate gradients of an image, `grad`, to what it is attached to; without them, gradients to the image.

    The result is the gradient of the image (H, W, C) in the second case.
    """
    if grad is None:
        dr.forward_to(image)
        return dr.grad(image)
    dr.set_grad(image, grad)
    dr.enqueue(dr.ADMode.Backward, image)
    dr.traverse(dr.ADMode.Backward)
    return image


class Derivative(Protocol):
    """An estimator of an image's derivative."""

    def backward(self, image: TensorXf) -> list[Any]:
        """The gradients of the parameters, from the derivatives with respect to the pixels (H, W, C)."""

    def forward(self, tangents: list[Any]) -> TensorXf:
        """The derivative of the image in the direction of `tangents`, one per parameter."""


class ImageOp(dr.CustomOp):
    """An image and its derivative, as an operation of Dr.Jit."""

    def eval(
        self, values: list[Any], unused: list[Any], primal: Callable[[], TensorXf], derivative: Derivative
    ) -> TensorXf:
        self.derivative = derivative
        if recording():
            undifferentiated.append(self.name())
        return primal()

    def backward(self) -> None:
        undifferentiated.clear()
        begin_trace()
        self.set_grad_in("values", self.derivative.backward(cast(TensorXf, self.grad_out())))

    def forward(self) -> None:
        undifferentiated.clear()
        begin_trace()
        self.set_grad_out(self.derivative.forward(list(cast("list[Any]", self.grad_in("values")))))

    def name(self) -> str:
        return "djpt.render"


class NoDerivative:
    """The derivative of an image that depends on no parameter with gradients: zero."""

    def __init__(self, job: Job) -> None:
        width, height = job.film.crop_size()
        self.shape = (height, width, job.channel_count())

    def backward(self, image: TensorXf) -> list[Any]:
        return []

    def forward(self, tangents: list[Any]) -> TensorXf:
        return dr.zeros(TensorXf, self.shape)


class ReplayDerivative:
    """The derivative of an image by path replay."""

    def __init__(self, job: Job, schedule: Schedule, parameters: list[Parameter]) -> None:
        assert isinstance(job.scene.lookup, Detached)
        self.job, self.schedule, self.parameters = job, schedule, parameters
        # Later edits of the scene must not change what is differentiated.
        self.values = job.scene.lookup.snapshot([(p.owner, p.attribute) for p in parameters])
        leaves = [leaf for ensemble in job.scene.ensembles() for leaf in ensemble.leaves()]
        self.numbering = Numbering(parameters, leaves, self.values)

    def _replay(self, band: Band, begin: int, end: int, mode_of: ModeOf) -> tuple[Mode, list[Float], UInt32]:
        return self.schedule.replay(self.job, self.values, self.numbering, band, begin, end, mode_of)

    def backward(self, image: TensorXf) -> list[Any]:
        with dr.suspend_grad():
            adjoints = on_grid(self.job, image)
            if self.schedule.carries_sums(self.job):
                return self._by_pixels(adjoints)
            return self._by_samples(over_weights(self.job, adjoints))

    def _by_pixels(self, adjoints: list[Float]) -> list[Any]:
        """Gradients, if all samples of a pixel have the same adjoint: that of the pixel over their number."""
        job = self.job
        inverse = dr.opaque(Float, 1 / job.spp)
        adjoints = [a * inverse for a in adjoints]
        dr.eval(adjoints)

        def mode_of(lanes: int, pixel: UInt32) -> Mode:
            delta = job.color_adjoint([dr.gather(Float, a, pixel) for a in adjoints])
            return Reverse(self._accumulator(lanes), delta, None)

        whole = Band(0, job.height)
        return add(self._gradients(whole, begin, end, mode_of) for begin, end in ranges(job.spp, register_spp(job)))

    def _by_samples(self, adjoints: list[Float]) -> list[Any]:
        """Gradients, if each sample has its own adjoint: a sum over the pixels in reach of the filter."""
        job = self.job

        def of_pass(band: Band, begin: int, end: int) -> list[Any]:
            deltas = sample_adjoints(job, band, adjoints, begin, end)

            def adjoint(slot: UInt32, active: Bool) -> Color3f:
                return job.color_adjoint([dr.gather(Float, delta, slot, active) for delta in deltas])

            def mode_of(lanes: int, pixel: UInt32) -> Mode:
                return Reverse(self._accumulator(lanes), None, adjoint)

            return self._gradients(band, begin, end, mode_of)

        return add(of_pass(band, begin, end) for band, begin, end in stored_passes(job))

    def _accumulator(self, lanes: int) -> Accumulator:
        return Accumulator(self.parameters, self.numbering, self.values, lanes)

    def _gradients(self, band: Band, begin: int, end: int, mode_of: ModeOf) -> list[Any]:
        mode, sums, number = self._replay(band, begin, end, mode_of)
        assert isinstance(mode, Reverse)
        with small_blocks():
            dr.eval(sums, number)
        return mode.accumulator.gradients(sums)

    def forward(self, tangents: list[Any]) -> TensorXf:
        job = self.job
        changes = Tangents(self.numbering, tangents)

        def sums_of_pass(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
            def mode_of(lanes: int, pixel: UInt32) -> Mode:
                return Forward(changes, None, blank_sums(lanes, job.channel_count()) if sums is None else sums)

            _, result, _ = self._replay(band, begin, end, mode_of)
            with small_blocks():
                dr.eval(result)
            return result

        def samples(job: Job, band: Band, begin: int, end: int) -> list[Float]:
            buffers, write = sample_buffers(job, band, end - begin)
            number = self._replay(band, begin, end, lambda lanes, pixel: Forward(changes, write, []))[2]
            with small_blocks():
                dr.eval(number, buffers)
            return buffers

        with dr.suspend_grad():
            if self.schedule.carries_sums(job):
                return image_of_rows(job, summed_rows(job, sums_of_pass))
            return image_of_rows(job, stored_rows(job, samples))


class AttachedDerivative:
    """Automatic differentiation of `Integrator.sample`: one attached pass over all samples."""

    at_once: ClassVar[str] = "by plain AD, which holds all samples in memory"
    """How all samples are differentiated at once, for a message."""

    def __init__(self, job: Job, schedule: Schedule, parameters: list[Parameter]) -> None:
        if job.samples > MAX_ATTACHED_SAMPLES:
            raise RenderError(
                f"'{type(job.integrator).__name__}' is differentiated {self.at_once}: "
                f"at most {MAX_ATTACHED_SAMPLES} samples are possible, found {job.samples}; use a smaller spp_grad"
            )
        self.job, self.schedule, self.leaves = job, schedule, FreshLeaves(parameters)

    def _samples(self, tangents: list[Any] | None = None) -> tuple[list[Any], list[Float]]:
        """Fresh leaves in place of the parameters, and the samples' channels attached to them."""
        fresh, places = self.leaves.made(tangents)
        view = self.job.with_scene(self.job.scene.replace(lookup=Attached(places)))
        return fresh, self.schedule.samples(view, Band(0, self.job.height), 0, self.job.spp)

    def backward(self, image: TensorXf) -> list[Any]:
        band = Band(0, self.job.height)
        with dr.suspend_grad():
            adjoints = over_weights(self.job, on_grid(self.job, image))
            deltas = sample_adjoints(self.job, band, adjoints, 0, self.job.spp)
        with dr.resume_grad():
            fresh, samples = self._samples()
            loss = Float(0)
            for sample, delta in zip(samples, deltas, strict=True):
                loss += sample * delta
            if dr.grad_enabled(loss):
                dr.backward(loss)
            return [dr.grad(leaf) for leaf in fresh]

    def forward(self, tangents: list[Any]) -> TensorXf:
        with dr.resume_grad():
            fresh, samples = self._samples(tangents)
            dr.enqueue(dr.ADMode.Forward, *fresh)
            # A channel may be an intermediate result of another: keep those gradients.
            dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearNone)
            changes = [dr.grad(sample) for sample in samples]
        with dr.suspend_grad():
            dr.eval(changes)
            return image_of_samples(self.job, changes)


def on_grid(job: Job, image: TensorXf) -> list[Float]:
    """The channels of an image (H, W, C) on the sampled grid, zero on its border."""
    height, width, channels = image.shape
    border = job.film.border
    pixel = dr.arange(UInt32, job.width * job.height)
    row = pixel // job.width_value
    # Unsigned: rows and columns of the border wrap around to large numbers and fall outside.
    y, x = row - border, pixel - row * job.width_value - border
    inside = (x < dr.opaque(UInt32, width)) & (y < dr.opaque(UInt32, height))
    start = (y * dr.opaque(UInt32, width) + x) * channels
    result = [dr.gather(Float, image.array, start + c, inside) for c in range(channels)]
    dr.eval(result)
    return result


def over_weights(job: Job, adjoints: list[Float]) -> list[Float]:
    """Derivatives with respect to the pixels' weighted sums, from those with respect to the pixels."""
    weight = filter_weights(job)
    result = [a * dr.select(weight == 0, 0, dr.rcp(weight)) for a in adjoints]
    dr.eval(result)
    return result


def filter_weights(job: Job) -> Float:
    """The sum of the weights of all samples that reach a pixel of the grid."""
    bands = ((band, add_samples(job, band, [], 0, job.spp, None)) for band in one_ahead(job.bands(stored_pixels(job))))
    parts = []
    for rows in collected(job, bands, 1):
        pixel = dr.arange(UInt32, rows.count * job.width)
        parts.append(dr.gather(Float, rows.sums[0], pixel))
        dr.eval(parts)
    return dr.concat(parts)


def add(parts: Any) -> list[Any]:
    """The gradients, added up over all passes, parameter by parameter."""
    total: list[Any] | None = None
    for part in parts:
        total = part if total is None else [a + b for a, b in zip(total, part, strict=True)]
    assert total is not None
    return total

"""First and second moments of samples, and the variance of pixels that follows from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.records import Ray3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.images.colorimetry import XYZ_TO_RGB
from djpt.integrators.paths.nesting import NestingIntegrator
from djpt.jit.types import Bool, Color3f, Float, TensorXf
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Moment", "variance"]

SECOND = "m2_"
"""The beginning of the names of second moments."""

RGB_TO_XYZ = np.linalg.inv(XYZ_TO_RGB)


class Moment(NestingIntegrator):
    """The image of nested integrators, with the means of their samples and of the samples' squares.

    Nested integrators, at least one, under any key `name`. The channels: the colour of the first one; per integrator
    its own AOVs as ``name.channel`` and the colour as ``name.X``, ``name.Y``, ``name.Z`` (CIE XYZ: `Y` is the
    luminance); then the second moments of all these, with ``m2_`` before the name. All are filtered as colours are.
    Names and values are Mitsuba's for the first integrator; further ones draw the random numbers they would draw alone.

    `djpt.variance` computes the variance of each pixel from such an image.
    """

    pure = True
    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if not self.nested:
            raise props.error("moment", "needs a nested integrator")
        self.run_as_nested()

    def aov_names(self) -> Sequence[str]:
        first = [
            f"{name}.{channel}"
            for name, integrator in self.nested
            for channel in (*integrator.aov_names(), "X", "Y", "Z")
        ]
        return first + [SECOND + name for name in first]

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        samples = self.samples(scene, sampler, ray, active)
        color, valid, _ = samples[0]
        return color, valid, with_squares([c for color, _, aovs in samples for c in (*aovs, *xyz(color))])

    def sample_channels(self, color: Color3f, valid: Bool) -> list[Float]:
        return with_squares(xyz(color))


def xyz(color: Color3f) -> list[Float]:
    """The components of a colour in CIE XYZ."""
    return [r * color.x + g * color.y + b * color.z for r, g, b in RGB_TO_XYZ.tolist()]


def with_squares(values: list[Float]) -> list[Float]:
    """Some values, then their squares."""
    return values + [dr.square(value) for value in values]


def variance(image: Any, channels: Sequence[str], spp: int) -> TensorXf:
    """The estimated variance of the pixels of an image that a `moment` integrator rendered.

    Var = (E[x^2] - E[x]^2) / (spp - 1), an unbiased estimate for the mean of `spp` independent samples.
    Its square root is the standard error. It holds for the box filter (others mix the samples of neighbours) and for
    the `independent` sampler (for stratified samples it is too large).

    Args:
        image: (H, W, C): a `TensorXf` or a NumPy array.
        channels: The names of its C channels: `djpt.channel_names(scene)`.
        spp: Samples per pixel, at least 2.

    Returns:
        (H, W, n) for the n channels that have a second moment, in their order; X, Y and Z of a plain integrator.

    Raises:
        RenderError: No channel has a second moment, or arguments that don't fit.
    """
    if spp < 2:
        raise RenderError(f"a variance takes at least 2 samples per pixel, found {spp}")
    # In double precision, because these are differences of large numbers.
    values = np.asarray(image.numpy() if hasattr(image, "numpy") else image, np.float64)
    names = list(channels)
    if values.ndim != 3 or values.shape[2] != len(names):
        raise RenderError(f"an image of {len(names)} channels is expected, found shape {values.shape}")
    pairs = [(names.index(name), names.index(SECOND + name)) for name in names if SECOND + name in names]
    if not pairs:
        raise RenderError(f"no channel has a second moment ('{SECOND}..'): render with a 'moment' integrator")
    mean, square = (values[..., [pair[i] for pair in pairs]] for i in (0, 1))
    return TensorXf((np.maximum(square - mean**2, 0) / (spp - 1)).astype(np.float32))


register_integrator("moment", Moment)

"""Derivatives of images whose colours come from a nested integrator, and whose other channels from camera rays."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.jit.types import TensorXf
from djpt.rendering.gradients.derivatives import Derivative, add

__all__ = ["NestedDerivative"]


class NestedDerivative:
    """The derivative of an image (H, W, C) that consists of two, side by side along its channels.

    Args:
        color: that of the nested integrator's image, the one it has alone with the same seed.
        others: that of the remaining channels.
        count: the number of the nested integrator's channels.
    """

    def __init__(self, color: Derivative, others: Derivative, count: int) -> None:
        self.color, self.others, self.count = color, others, count

    def backward(self, image: TensorXf) -> list[Any]:
        with dr.suspend_grad():
            parts = image[:, :, : self.count], image[:, :, self.count :]
        return add([self.color.backward(parts[0]), self.others.backward(parts[1])])

    def forward(self, tangents: list[Any]) -> TensorXf:
        parts = [self.color.forward(tangents), self.others.forward(tangents)]
        with dr.suspend_grad():
            return dr.concat(parts, axis=2)

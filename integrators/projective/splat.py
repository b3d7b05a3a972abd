"""Images of samples that only their derivatives are asked of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.jit.types import Color3f, TensorXf

__all__ = ["attached_splat", "keep"]

MOST_LANES = 1 << 21
"""The samples that are stored at most."""


def keep(*values: Any) -> None:
    """Compute samples before anything is attached to them, so that derivatives don't compute them again.

    Of many samples storage would be the limit: they are computed again.
    """
    known = [value for value in values if value is not None]
    if dr.width(known) <= MOST_LANES:
        dr.eval(known)


def attached_splat(color: Color3f, shape: tuple[int, ...], splat: Callable[[Color3f], TensorXf]) -> TensorXf:
    """The image ``splat(color)``, attached to `color`; its values are 0.

    An image is linear in its samples, and costs a scatter per channel and pixel in reach of the filter, each of which
    would launch all that its samples are computed from. As an operation of its own, it takes their change when that is
    known.

    Args:
        color: the samples.
        shape: that of the image.
        splat: a linear function.
    """
    return dr.custom(SplatOp, color, shape, splat)


class SplatOp(dr.CustomOp):
    """The image of samples, as an operation of Dr.Jit."""

    def eval(self, color: Color3f, shape: tuple[int, ...], splat: Callable[[Color3f], TensorXf]) -> TensorXf:
        self.splat, self.lanes = splat, dr.width(color)
        return dr.zeros(TensorXf, shape)

    def forward(self) -> None:
        change = Color3f(self.grad_in("color"))
        dr.eval(change)
        self.set_grad_out(self.splat(change))

    def backward(self) -> None:
        with dr.isolate_grad():
            color = dr.zeros(Color3f, self.lanes)
            dr.enable_grad(color)
            image = self.splat(color)
            dr.set_grad(image, self.grad_out())
            dr.enqueue(dr.ADMode.Backward, image)
            dr.traverse(dr.ADMode.Backward)
            adjoint = dr.grad(color)
        dr.eval(adjoint)
        self.set_grad_in("color", adjoint)

    def name(self) -> str:
        return "splat"

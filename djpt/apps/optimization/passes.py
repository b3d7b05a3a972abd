"""Residuals and their derivatives in both directions: three functions, traced in each call or frozen."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any

import drjit as dr

from djpt.errors import RenderError
from djpt.jit.frozen import Holder
from djpt.jit.types import UInt32
from djpt.rendering.known_images import Images, images_collected, images_known

__all__ = ["Passes", "Residual"]

Residual = Callable[[Mapping[str, Any], Any], Any]
"""A function of variables by name and a seed that returns an array attached to the variables."""

Variables = dict[str, Any]


class Passes:
    """The residuals r of a function, J v and J^T w.

    Args:
        function: The residuals.
        frozen: Whether `dr.freeze` records each of the three once and launches its kernels again: then the seed is an
            array, and the function must not read arrays on the host, or edit shapes and cameras.
    """

    def __init__(self, function: Residual, frozen: bool) -> None:
        self._function, self._frozen = function, frozen
        self.residuals, self.forward, self.reverse = (
            self._pass(one) for one in (plain_residuals, forward_derivative, reverse_derivative)
        )

    def _pass(self, derived: Callable[..., Any]) -> Callable[..., Any]:
        """A function of (variables, .., seed, number of halvings)."""
        if not self._frozen:
            return lambda *arguments: derived(self._function, *arguments)
        recorded = dr.freeze(derived, state_fn=lambda function, *_: reached(function), auto_opaque=False)

        holders = holders_of(self._function)

        def launched(*arguments: Any) -> Any:
            *arrays, seed, halvings = arguments
            try:
                return recorded(self._function, *arrays, dr.opaque(UInt32, seed), halvings)
            finally:
                # Attached values that derivatives leave in a scene are another structure: all would be recorded twice.
                dr.disable_grad([h.held[1:] for h in holders])

        return launched


def reached(function: Residual) -> list[dict[str, Any]]:
    """What a function, and functions of the same module that it calls, use of the code around them.

    There `dr.freeze` looks for arrays.
    """
    found, seen, left = list[dict[str, Any]](), set[int](), list[Any]([function])
    while left:
        one = left.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        outside = inspect.getclosurevars(one)
        for variables in (dict(outside.nonlocals), dict(outside.globals)):
            found.append(variables)
            left += [v for v in variables.values() if isinstance(v, FunctionType) and v.__module__ == one.__module__]
    return found


def holders_of(function: Residual) -> list[Holder]:
    """The scenes and parameters that a function reaches, unless gradients of their arrays are enabled already."""
    found = [v for variables in reached(function) for v in variables.values() if isinstance(v, Holder)]
    return [holder for holder in found if not dr.grad_enabled(holder.held[1:])]


def halved(image: Any) -> Any:
    """An image (H, W, C) of half the size, of means over 2 x 2 pixels; a last odd row or column is left out."""
    even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2, :]
    rows = even[0::2, :, :] + even[1::2, :, :]
    return (rows[:, 0::2, :] + rows[:, 1::2, :]) / 4


def residuals(function: Residual, variables: Variables, seed: Any, halvings: int) -> Any:
    """The residuals, images halved in size so many times, attached."""
    found = function(variables, seed)
    for _ in range(halvings):
        found = halved(found)
    return found


def plain_residuals(function: Residual, variables: Variables, seed: Any, halvings: int) -> tuple[Any, Images]:
    """The residuals, and the images that they were computed from."""
    with images_collected() as images:
        found = dr.detach(residuals(function, variables, seed, halvings))
    return found, dr.detach(images)


def forward_derivative(
    function: Residual, variables: Variables, tangents: Variables, images: Images, seed: Any, halvings: int
) -> Any:
    """J v, for v by name, where images are known."""
    attached = enabled(variables)
    for name, value in attached.items():
        dr.set_grad(value, tangents[name])
    with images_known(images):
        found = residuals(function, attached, seed, halvings)
    if not dr.grad_enabled(found):
        raise RenderError("least_squares: the residuals don't depend on the variables")
    dr.enqueue(dr.ADMode.Forward, *attached.values())
    dr.traverse(dr.ADMode.Forward)
    return dr.grad(found)


def reverse_derivative(
    function: Residual, variables: Variables, weights: Any, images: Images, seed: Any, halvings: int
) -> Variables:
    """J^T w by name, for w in the shape of the residuals, where images are known."""
    attached = enabled(variables)
    with images_known(images):
        found = residuals(function, attached, seed, halvings)
    dr.backward(dr.sum(found * weights, axis=None))
    return {name: dr.grad(value) for name, value in attached.items()}


def enabled(variables: Variables) -> Variables:
    """Copies with gradients enabled."""
    copies = {name: type(value)(value) for name, value in variables.items()}
    for value in copies.values():
        dr.enable_grad(value)
    return copies

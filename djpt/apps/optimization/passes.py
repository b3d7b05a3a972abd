"""Residuals, and their derivatives in both directions: functions that are traced in each call, or frozen."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import FunctionType
from typing import Any

import drjit as dr

from djpt.errors import RenderError
from djpt.jit.frozen import Holder, undifferentiated
from djpt.jit.types import UInt32
from djpt.rendering.known_images import (
    Images,
    Jacobians,
    Linearised,
    images_collected,
    images_known,
    images_linearised,
    jacobians_collected,
    jacobians_known,
)

__all__ = ["Linear", "Passes", "Residual"]

Residual = Callable[[Mapping[str, Any], Any], Any]
"""A function of variables by name and a seed that returns an array attached to the variables."""

Variables = dict[str, Any]


@dataclass(frozen=True)
class Linear:
    """Residuals about one place: products with one estimate of their Jacobian J."""

    known: Jacobians
    """The Jacobians of images that are in memory."""
    images: int
    """The number of images."""

    def forward(self, tangents: Variables) -> Any:
        """J v, for v by name."""
        raise NotImplementedError

    def reverse(self, weights: Any) -> Variables:
        """J^T w by name, for w in the shape of the residuals."""
        raise NotImplementedError

    def normal(self, tangents: Variables) -> Variables:
        """J^T J v by name."""
        return self.reverse(self.forward(tangents))

    def by(self, other: Linear) -> Linear | None:
        """These residuals with the Jacobians of others; None if an image has none in memory, or there is no image."""
        if not self.known or len(self.known) < self.images or self.known.keys() != other.known.keys():
            return None
        return replace(self, known=other.known)

    def mixed(self, other: Linear, share: float) -> Linear:
        """These residuals with the means of both Jacobians, of which the other ones count for a `share`."""
        return replace(self, known={name: one.mixed(other.known[name], share) for name, one in self.known.items()})


class Passes:
    """The residuals of a function, and their derivatives.

    Args:
        function: The residuals.
        frozen: Whether `dr.freeze` records what is computed once and launches its kernels again: then the seed is an
            array, and the function must not read arrays on the host, or edit shapes and cameras.
    """

    def __init__(self, function: Residual, frozen: bool) -> None:
        self._function, self._frozen = function, frozen
        self.residuals = self._pass(plain_residuals)
        """The residuals, and the images that they were computed from: (variables, seed, number of halvings)."""
        self._jacobians, self._forward, self._reverse, self._normal = (
            self._pass(one) for one in (jacobians, forward_derivative, reverse_derivative, normal_product)
        )

    def linear(self, variables: Variables, images: Images, seed: Any, halvings: int) -> Linear:
        """The residuals about `variables`, where images are known."""
        if not self._frozen:
            return graph(self._function, variables, images, seed, halvings)
        found = self._jacobians(variables, images, seed, halvings)
        functions = self._forward, self._reverse, self._normal
        return Recorded(found, len(images), functions, (variables, images), (seed, halvings))

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
                for holder in holders:
                    holder.disable_grad()

        return launched


@dataclass(frozen=True)
class Graph(Linear):
    """Products by a graph, which is traversed for each."""

    attached: Variables
    found: Any
    """The residuals, attached to the variables."""
    derivatives: Linearised
    """Of images, as far as their Jacobians are in memory."""

    def forward(self, tangents: Variables) -> Any:
        self._prepare()
        for name, value in self.attached.items():
            dr.set_grad(value, tangents[name])
        dr.enqueue(dr.ADMode.Forward, *self.attached.values())
        dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearVertices)
        return taken(self.found)

    def reverse(self, weights: Any) -> Variables:
        self._prepare()
        dr.set_grad(self.found, weights)
        dr.enqueue(dr.ADMode.Backward, self.found)
        dr.traverse(dr.ADMode.Backward, dr.ADFlag.ClearVertices)
        return {name: taken(value) for name, value in self.attached.items()}

    def _prepare(self) -> None:
        """Let the graph, which others may share, use these Jacobians."""
        for name, derivative in self.derivatives.items():
            derivative.jacobian = self.known[name]


def graph(function: Residual, variables: Variables, images: Images, seed: Any, halvings: int) -> Graph:
    """The residuals about `variables`, by the graph of one call of the function."""
    attached = enabled(variables)
    with images_known(images), images_linearised() as derivatives:
        found = residuals(function, attached, seed, halvings)
    if not dr.grad_enabled(found):
        raise RenderError("least_squares: the residuals don't depend on the variables")
    known = {name: derivative.jacobian for name, derivative in derivatives.items()}
    return Graph(known, len(images), attached, found, derivatives)


def taken(value: Any) -> Any:
    """The gradient of an end of a graph, which is 0 from then on."""
    found = dr.grad(value)
    dr.eval(found)
    dr.clear_grad(value)
    return found


@dataclass(frozen=True)
class Recorded(Linear):
    """Products by recorded functions: J v, J^T w and J^T J v."""

    functions: tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]
    place: tuple[Variables, Images]
    last: tuple[Any, int]
    """Seed and number of halvings."""

    def forward(self, tangents: Variables) -> Any:
        return self.functions[0](*self.place, self.known, tangents, *self.last)

    def reverse(self, weights: Any) -> Variables:
        found: Variables = self.functions[1](*self.place, self.known, weights, *self.last)
        return found

    def normal(self, tangents: Variables) -> Variables:
        found: Variables = self.functions[2](*self.place, self.known, tangents, *self.last)
        return found


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


def jacobians(function: Residual, variables: Variables, images: Images, seed: Any, halvings: int) -> Jacobians:
    """The Jacobians of the images that residuals are computed from, where images are known."""
    with images_known(images), jacobians_collected() as found:
        residuals(function, enabled(variables), seed, halvings)
    undifferentiated.clear()
    return found


def forward_derivative(
    function: Residual,
    variables: Variables,
    images: Images,
    known: Jacobians,
    tangents: Variables,
    seed: Any,
    halvings: int,
) -> Any:
    """J v, for v by name, where images are known, and maybe their Jacobians."""
    attached = enabled(variables)
    for name, value in attached.items():
        dr.set_grad(value, tangents[name])
    with images_known(images), jacobians_known(known):
        found = residuals(function, attached, seed, halvings)
    if not dr.grad_enabled(found):
        raise RenderError("least_squares: the residuals don't depend on the variables")
    dr.enqueue(dr.ADMode.Forward, *attached.values())
    dr.traverse(dr.ADMode.Forward)
    return dr.grad(found)


def reverse_derivative(
    function: Residual,
    variables: Variables,
    images: Images,
    known: Jacobians,
    weights: Any,
    seed: Any,
    halvings: int,
) -> Variables:
    """J^T w by name, for w in the shape of the residuals, where images are known, and maybe their Jacobians."""
    attached = enabled(variables)
    with images_known(images), jacobians_known(known):
        found = residuals(function, attached, seed, halvings)
    dr.backward(dr.sum(found * weights, axis=None))
    return {name: dr.grad(value) for name, value in attached.items()}


def normal_product(
    function: Residual,
    variables: Variables,
    images: Images,
    known: Jacobians,
    tangents: Variables,
    seed: Any,
    halvings: int,
) -> Variables:
    """J^T J v by name, for v by name."""
    given = function, variables, images, known
    forward = dr.detach(forward_derivative(*given, tangents, seed, halvings))
    return reverse_derivative(*given, forward, seed, halvings)


def enabled(variables: Variables) -> Variables:
    """Copies with gradients enabled."""
    copies = {name: type(value)(value) for name, value in variables.items()}
    for value in copies.values():
        dr.enable_grad(value)
    return copies

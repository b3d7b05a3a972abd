"""Images of a function that are known when only its derivative is asked for, and Jacobians that are known, too.

The derivative of an image has samples of its own, so that a derivative of residuals needs images of any seed: those
that the residuals were last computed from at the same place serve, and aren't rendered again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from djpt.jit.types import TensorXf
from djpt.rendering.settings import RenderSettings

__all__ = [
    "Images",
    "Jacobians",
    "Linearised",
    "images_collected",
    "images_known",
    "images_linearised",
    "jacobians_collected",
    "jacobians_known",
    "known_derivative_or",
    "known_or",
    "linearising",
]

Images = dict[str, TensorXf]
"""Images by what they were rendered of, and by the number of the call."""


Jacobians = dict[str, Any]
"""Jacobians of images, by the same names."""

Linearised = dict[str, Any]
"""Derivatives of images by Jacobians, by the same names."""


@contextmanager
def images_collected() -> Iterator[Images]:
    """The images that are rendered inside."""
    images: Images = {}
    _contexts.append((images, {}, True))
    try:
        yield images
    finally:
        _contexts.pop()


@contextmanager
def images_known(images: Images) -> Iterator[None]:
    """Let images that are rendered inside, attached or not, have the values of these, in the same order.

    Where there is none of the same sensor, integrator and number of samples, images are rendered.
    """
    _contexts.append((images, {}, False))
    try:
        yield
    finally:
        _contexts.pop()


def known_or(settings: RenderSettings, rendered: Callable[[], TensorXf]) -> TensorXf:
    """The image of these settings that is known, inside of `images_known`, or else `rendered()`, which is collected."""
    if not _contexts:
        return rendered()
    images, counts, collecting = _contexts[-1]
    name = named(settings, counts)
    if not collecting:
        return TensorXf(images[name]) if name in images else rendered()
    images[name] = found = rendered()
    return found


def named(settings: RenderSettings, counts: dict[str, int]) -> str:
    """The name of one more image of these settings."""
    # What tells images apart whatever their seeds.
    kind = f"{id(settings.sensor)} {type(settings.integrator).__name__} {settings.spp}"
    counts[kind] = number = counts.get(kind, 0) + 1
    return f"{kind} {number}"


@contextmanager
def jacobians_collected() -> Iterator[Jacobians]:
    """The Jacobians of the attached images inside, as far as they have some."""
    jacobians: Jacobians = {}
    _jacobians.append((jacobians, {}, True))
    try:
        yield jacobians
    finally:
        _jacobians.pop()


@contextmanager
def jacobians_known(jacobians: Jacobians) -> Iterator[None]:
    """Let attached images inside have these Jacobians, in the same order, where there is one."""
    _jacobians.append((jacobians, {}, False))
    try:
        yield
    finally:
        _jacobians.pop()


@contextmanager
def images_linearised() -> Iterator[Linearised]:
    """Let attached images inside compute at once what all their derivatives need, however many are asked for.

    The result has those derivatives that are products with a Jacobian in memory, by the names of images.
    """
    derivatives: Linearised = {}
    _jacobians.append((derivatives, {}, None))
    try:
        yield derivatives
    finally:
        _jacobians.pop()


def linearising() -> bool:
    """Whether images are linearised."""
    return bool(_jacobians) and _jacobians[-1][2] is None


def known_derivative_or(settings: RenderSettings, derivative: Any) -> Any:
    """The derivative by a Jacobian that is known, or made known here, or else `derivative`."""
    if not _jacobians:
        return derivative
    from djpt.rendering.gradients.jacobian import KnownDerivative, jacobian_of  # few searches use them

    known, counts, collecting = _jacobians[-1]
    name = named(settings, counts)
    if collecting is False:
        return KnownDerivative(derivative, known[name]) if name in known else derivative
    found = jacobian_of(derivative)
    if found is None:
        return derivative
    if collecting:
        known[name] = found
        return derivative
    known[name] = KnownDerivative(derivative, found)
    return known[name]


_contexts: list[tuple[Images, dict[str, int], bool]] = []
"""What has begun, the innermost last: images, the counts of each kind so far, and whether images are collected."""

_jacobians: list[tuple[dict[str, Any], dict[str, int], bool | None]] = []
"""The same for Jacobians; inside of `images_linearised` for derivatives, and None."""

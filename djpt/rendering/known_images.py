"""Images of a function that are known when only its derivative is asked for.

The derivative of an image has samples of its own, so that a derivative of residuals needs images of any seed: those
that the residuals were last computed from at the same place serve, and aren't rendered again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from djpt.jit.types import TensorXf
from djpt.rendering.settings import RenderSettings

__all__ = ["Images", "images_collected", "images_known", "known_or"]

Images = dict[str, TensorXf]
"""Images by what they were rendered of, and by the number of the call."""


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
    # What tells images apart whatever their seeds.
    kind = f"{id(settings.sensor)} {type(settings.integrator).__name__} {settings.spp}"
    counts[kind] = number = counts.get(kind, 0) + 1
    name = f"{kind} {number}"
    if not collecting:
        return TensorXf(images[name]) if name in images else rendered()
    images[name] = found = rendered()
    return found


_contexts: list[tuple[Images, dict[str, int], bool]] = []
"""What has begun, the innermost last: images, the counts of each kind so far, and whether images are collected."""

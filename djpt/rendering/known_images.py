"""Images of a function that are known when only its derivative is asked for.

The derivative of an image has samples of its own, so that a derivative of residuals needs images of any seed: those
that the residuals were last computed from at the same place serve, and aren't rendered again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from djpt.jit.types import TensorXf
from djpt.rendering.settings import RenderSettings

__all__ = ["Images", "images_collected", "images_known", "known_or", "note_image"]

Images = dict[str, TensorXf]
"""Images by what they were rendered of, and by the number of the call."""


@contextmanager
def images_collected() -> Iterator[Images]:
    """The images that `djpt.render` returns inside."""
    images: Images = {}
    _collecting.append(images)
    try:
        yield images
    finally:
        _collecting.pop()


@contextmanager
def images_known(images: Images) -> Iterator[None]:
    """Let images that `djpt.render` attaches to parameters inside have the values of these, in the same order.

    Where there is none of the same sensor, integrator and number of samples, images are rendered.
    """
    _known.append((images, {}))
    try:
        yield
    finally:
        _known.pop()


def note_image(settings: RenderSettings, image: TensorXf) -> None:
    """Note an image, inside of `images_collected`."""
    if _collecting:
        images, kind = _collecting[-1], kind_of(settings)
        images[f"{kind} {sum(name.startswith(kind) for name in images)}"] = image


def known_or(settings: RenderSettings, rendered: Callable[[], TensorXf]) -> TensorXf:
    """The image of these settings that is known, inside of `images_known`, or else `rendered()`."""
    if not _known:
        return rendered()
    (images, counts), kind = _known[-1], kind_of(settings)
    number = counts.get(kind, 0)
    counts[kind] = number + 1
    found = images.get(f"{kind} {number}")
    return rendered() if found is None else TensorXf(found)


def kind_of(settings: RenderSettings) -> str:
    """What tells images apart whatever their seeds."""
    return f"{id(settings.sensor)} {type(settings.integrator).__name__} {settings.spp};"


_collecting: list[Images] = []
_known: list[tuple[Images, dict[str, int]]] = []
"""What contexts have begun, the innermost last; the counts are those of images so far."""

"""Joint non-local means: what `denoise` can do without a neural network.

A pixel becomes the mean of those around it whose neighbourhoods look alike, in the image and in its guides. Differences
are compared with what noise explains: F. Rousselle, C. Knaus, M. Zwicker, *Adaptive rendering with non-local means
filtering*, ACM TOG 31(6), 2012; the weight is the smaller of those of colour and guides: F. Rousselle, M. Manzi,
M. Zwicker, *Robust denoising using feature and color information*, CGF 32(7), 2013. There the variance is measured
by samples; here it is estimated from the image, by what is left of it where it is least smooth.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["filtered"]

Pixels = npt.NDArray[np.float32]

SEARCH = 5
"""Pixels to each side among which alike ones are looked for."""
PATCH = 3
"""Pixels to each side that are compared."""
STRENGTH = 0.7
"""How far patches may differ, in standard deviations of their noise."""
SHARPNESS = {"albedo": 0.1, "normal": 0.3}
"""How far guides may differ."""
DARKEST = 0.02
"""What is added to the albedo by which light is divided."""
NEAR = 4
"""Pixels to each side over which noise is averaged."""


def filtered(noisy: Pixels, guides: Mapping[str, Pixels], clean: bool) -> Pixels:
    """The image (H, W, 3) of linear values without its noise. Guides, by name, that aren't `clean` are filtered first.

    With an albedo it is the light on surfaces that is filtered, the image divided by the albedo.
    """
    if not clean:
        guides = {name: means(guide, {}, search=2, patch=1) for name, guide in guides.items()}
    matter = guides["albedo"] + np.float32(DARKEST) if "albedo" in guides else np.float32(1)
    return (means(noisy / matter, guides) * matter).astype(np.float32)


def means(image: Pixels, guides: Mapping[str, Pixels], search: int = SEARCH, patch: int = PATCH) -> Pixels:
    """The weighted mean of the pixels around each one: (H, W, 3)."""
    variance = noise(image)
    floor = np.float32(1e-8 * np.mean(np.square(image)) + 1e-30)
    total, weights = image.copy(), np.ones((*image.shape[:2], 1), np.float32)
    # A pair of pixels has one weight: half of the offsets are enough.
    for down, right in [(y, x) for y in range(search + 1) for x in range(-search, search + 1) if y > 0 or x > 0]:
        here, there = overlap(image.shape[0], image.shape[1], down, right)
        if image[here].size == 0:
            continue
        explained = variance[here] + variance[there]
        apart = (np.square(image[here] - image[there]) - explained) / (STRENGTH**2 * explained + floor)
        distance = blurred(apart.mean(axis=2, keepdims=True, dtype=np.float32), patch)
        for name, guide in guides.items():
            differs = np.square(guide[here] - guide[there]).sum(axis=2, keepdims=True) / SHARPNESS[name] ** 2
            distance = np.maximum(distance, differs)
        weight = np.exp(-np.maximum(distance, 0))
        total[here] += weight * image[there]
        total[there] += weight * image[here]
        weights[here] += weight
        weights[there] += weight
    return np.asarray(total / weights, np.float32)


def overlap(height: int, width: int, down: int, right: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """The pixels whose partner, `down` and `right` of them, is in the image too, and these partners; `down` >= 0."""
    left = max(0, -right)
    wide = max(0, width - abs(right))
    rows = max(0, height - down)
    here = slice(0, rows), slice(left, left + wide)
    return here, (slice(down, down + rows), slice(left + right, left + right + wide))


def noise(image: Pixels) -> Pixels:
    """The variance of each pixel (H, W, 3), estimated by what a mask takes from it that is 0 for planes and edges.

    J. Immerkaer, *Fast noise variance estimation*, Computer Vision and Image Understanding 64(2), 1996.
    """
    rough = image
    for axis in range(2):
        edge = [(1, 1) if i == axis else (0, 0) for i in range(3)]
        padded = np.moveaxis(np.pad(rough, edge, mode="symmetric"), axis, 0)
        rough = np.moveaxis(padded[:-2] - 2 * padded[1:-1] + padded[2:], 0, axis)
    return blurred(np.square(rough) / 36, NEAR)


def blurred(values: npt.NDArray[Any], radius: int) -> Pixels:
    """The mean over a square of 2 `radius` + 1 pixels around each one, as far as it lies in the image."""
    result = values.astype(np.float64)
    for axis in range(2):
        count = result.shape[axis]
        sums = np.cumsum(result, axis=axis)
        sums = np.concatenate([np.zeros_like(np.take(sums, [0], axis=axis)), sums], axis=axis)
        begin = np.maximum(np.arange(count) - radius, 0)
        end = np.minimum(np.arange(count) + radius + 1, count)
        shape = [-1 if i == axis else 1 for i in range(3)]
        result = (np.take(sums, end, axis=axis) - np.take(sums, begin, axis=axis)) / (end - begin).reshape(shape)
    return result.astype(np.float32)

"""Sets of triangles (F, 3, 3) that are easy or hard for acceleration structures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["SOUPS", "exponential", "giants_among_dwarfs", "scattered", "sphere"]

Corners = NDArray[np.float32]


def sphere(count: int, bumps: float = 0.15) -> Corners:
    """A bumpy sphere of about `count` triangles in rows, like a scanned object."""
    rows = max(2, round((count / 4) ** 0.5))
    u, v = np.linspace(0, 2 * np.pi, 2 * rows + 1), np.linspace(0.05, np.pi - 0.05, rows + 1)
    u[-1] = 0  # closed to the last bit
    u, v = (x.ravel() for x in np.meshgrid(u, v))
    p = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=1)
    p *= 1 + bumps * np.sin(7 * p[:, :1]) * np.sin(11 * p[:, 1:2]) * np.cos(5 * p[:, 2:])
    i = (np.arange(rows)[:, None] * (2 * rows + 1) + np.arange(2 * rows)).ravel()
    below = i + 2 * rows + 1
    faces = np.concatenate([np.stack([i, i + 1, below], 1), np.stack([i + 1, below + 1, below], 1)])
    corners: Corners = p[faces].astype(np.float32)
    return corners


def scattered(count: int = 300, seed: int = 0) -> Corners:
    """Triangles of all sizes, everywhere, through each other."""
    rng = np.random.default_rng(seed)
    middle, size = rng.uniform(-1, 1, (count, 1, 3)), 10 ** rng.uniform(-3, 0, (count, 1, 1))
    return (middle + size * rng.normal(size=(count, 3, 3))).astype(np.float32)


def giants_among_dwarfs() -> Corners:
    """A fine object on a floor of two triangles."""
    a, b, c, d = ([x, y, -1.2] for x, y in ((-40, -40), (40, -40), (40, 40), (-40, 40)))
    return np.concatenate([sphere(6000), np.array([[a, b, c], [a, c, d]], np.float32)])


def flat(count: int = 12) -> Corners:
    """A square in the plane x = 0.5, cut into a regular grid."""
    y, z = (x.ravel() for x in np.meshgrid(np.arange(count), np.arange(count)))
    first = np.stack([np.full_like(y, 0.5, np.float32), y, z], 1)[:, None] + [[0, 0, 0], [0, 1, 0], [0, 0, 1]]
    second = np.stack([np.full_like(y, 0.5, np.float32), y, z], 1)[:, None] + [[0, 1, 1], [0, 1, 0], [0, 0, 1]]
    return (np.concatenate([first, second]) * [1, 1 / count, 1 / count]).astype(np.float32)


def copies(count: int = 50) -> Corners:
    """The same triangle many times."""
    return np.repeat(np.array([[[0, 0, 0], [1, 0, 0.2], [0, 1, 0.3]]], np.float32), count, axis=0)


def exponential(count: int = 240) -> Corners:
    """Each triangle is half as large as the one before and half as far from a corner."""
    triangle = np.array([[1, 1, 1], [1.5, 1, 1], [1, 1.5, 1.2]], np.float64)
    return (triangle * 2.0 ** -np.linspace(0, 100, count)[:, None, None]).astype(np.float32)


def far_away() -> Corners:
    """A small object, far from the origin."""
    return (sphere(800).astype(np.float64) * 0.5 + [3000, -2000, 1000]).astype(np.float32)


SOUPS = {
    "one": lambda: copies(1),
    "two": lambda: scattered(2),
    "scattered": scattered,
    "sphere": lambda: sphere(3000),
    "giants_among_dwarfs": giants_among_dwarfs,
    "flat": flat,
    "copies": copies,
    "exponential": exponential,
    "far_away": far_away,
}

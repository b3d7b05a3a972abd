"""Closest hits in double precision, by other formulas than the engine's: local distances of all roots."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["ORACLES", "closest", "in_local"]

Array = np.ndarray
Oracle = Callable[[Array, Array], Array]


def quadratic(a: Array, b: Array, c: Array) -> Array:
    """Real roots of a t^2 + 2 b t + c, (N, 2), NaN where there are none."""
    root = np.sqrt(b * b - a * c)
    # Without cancellation: one root by the sum of equal signs, the other by the product of both.
    q = -(b + np.copysign(root, b))
    return np.stack([q / a, c / q], axis=1)


def at(o: Array, d: Array, t: Array) -> Array:
    """Points (N, K, 3) at distances (N, K)."""
    return o[:, None] + t[:, :, None] * d[:, None]


def plane(o: Array, d: Array) -> Array:
    """z = 0."""
    return -o[:, 2:] / d[:, 2:]


def rectangle(o: Array, d: Array) -> Array:
    """The part of the plane in [-1, 1]^2."""
    t = plane(o, d)
    return np.where(np.abs(at(o, d, t)[:, :, :2]).max(axis=2) <= 1, t, np.nan)


def disk(o: Array, d: Array) -> Array:
    """The part of the plane in the unit circle."""
    t = plane(o, d)
    return np.where(np.linalg.norm(at(o, d, t)[:, :, :2], axis=2) <= 1, t, np.nan)


def cube(o: Array, d: Array) -> Array:
    """Six rectangles."""
    hits = []
    for axis in range(3):
        for side in (-1, 1):
            t = (side - o[:, axis]) / d[:, axis]
            others = np.delete(o + t[:, None] * d, axis, axis=1)
            hits.append(np.where(np.abs(others).max(axis=1) <= 1, t, np.nan))
    return np.stack(hits, axis=1)


def sphere(o: Array, d: Array) -> Array:
    """|p| = 1."""
    return quadratic((d * d).sum(1), (o * d).sum(1), (o * o).sum(1) - 1)


def cylinder(o: Array, d: Array) -> Array:
    """x^2 + y^2 = 1 for 0 <= z <= 1."""
    x, v = o[:, :2], d[:, :2]
    t = quadratic((v * v).sum(1), (x * v).sum(1), (x * x).sum(1) - 1)
    z = at(o, d, t)[:, :, 2]
    return np.where((z >= 0) & (z <= 1), t, np.nan)


def cone(o: Array, d: Array) -> Array:
    """x^2 + y^2 = z^2 for 0 <= z <= 1."""
    sign = np.array([1, 1, -1])
    t = quadratic((d * d) @ sign, (o * d) @ sign, (o * o) @ sign)
    z = at(o, d, t)[:, :, 2]
    return np.where((z >= 0) & (z <= 1), t, np.nan)


ORACLES: dict[str, Oracle] = {
    "rectangle": rectangle,
    "cube": cube,
    "sphere": sphere,
    "disk": disk,
    "cylinder": cylinder,
    "cone": cone,
    "plane": plane,
    "cuboid": cube,
}
"""All roots in local coordinates, where `to_world` of the plugin starts from: (N, K) with NaNs."""


def in_local(matrix: Array, o: Array, d: Array) -> tuple[Array, Array]:
    """World rays (N, 3) in the coordinates that `matrix` maps to the world."""
    inverse = np.linalg.inv(matrix[:3, :3])
    return (o - matrix[:3, 3]) @ inverse.T, d @ inverse.T


def closest(oracle: Oracle, matrix: Array, o: Array, d: Array) -> Array:
    """The smallest t > 0 per world ray, or infinity."""
    with np.errstate(all="ignore"):
        t = oracle(*in_local(matrix, o, d))
        return np.where(t > 0, t, np.inf).min(axis=1)

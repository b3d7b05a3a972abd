"""Closest hits in double precision, by other formulas than the engine's, from the distances of all roots."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["GRID", "ORACLES", "closest", "in_local"]

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


def paraboloid(o: Array, d: Array) -> Array:
    """x^2 + y^2 = z for 0 <= z <= 1."""
    x, v = o[:, :2], d[:, :2]
    t = quadratic((v * v).sum(1), (x * v).sum(1) - d[:, 2] / 2, (x * x).sum(1) - o[:, 2])
    z = at(o, d, t)[:, :, 2]
    return np.where((z >= 0) & (z <= 1), t, np.nan)


def bracketed(f: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """The zero of a function per ray between two places of different sign, by bisection; NaN elsewhere."""
    f_low, there = f(low), f(low) * f(high) <= 0
    for _ in range(70):
        middle = (low + high) / 2
        same = f(middle) * f_low > 0
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.where(there, (low + high) / 2, np.nan)


def torus(o: Array, d: Array) -> Array:
    """(|p|^2 + R^2 - r^2)^2 = 4 R^2 (x^2 + y^2), R = 1, r = 1/4: real roots of the quartic, as eigenvalues."""
    a, b, c = (d * d).sum(1), (o * d).sum(1), (o * o).sum(1)
    # From the point closest to the middle, where b = 0.
    shift = -b / a
    o = o + shift[:, None] * d
    c = (o * o).sum(1)
    k = c + 1 - 1 / 16
    e2, e1, e0 = ((u[:, :2] * v[:, :2]).sum(1) for u, v in ((d, d), (o, d), (o, o)))
    quartic = [a * a, 0 * a, 2 * a * k - 4 * e2, -8 * e1, k * k - 4 * e0]
    companion = np.zeros((len(a), 4, 4))
    companion[:, 0] = -np.stack(quartic[1:], axis=1) / quartic[0][:, None]
    companion[:, [1, 2, 3], [0, 1, 2]] = 1
    roots = np.linalg.eigvals(companion)
    # Double roots come out as pairs with imaginary parts of the square root of rounding.
    return np.where(np.abs(roots.imag) <= 1e-7 * (1 + np.abs(roots.real)), roots.real + shift[:, None], np.nan)


def ball(o: Array, d: Array) -> Array:
    """|p| = 0.8."""
    return sphere(o / 0.8, d / 0.8)


GRID = np.random.default_rng(4).normal(size=(4, 4, 4)).astype(np.float32)
"""Samples (Z, Y, X) of a distance grid: not a smooth surface at all."""


def interpolated(p: Array) -> Array:
    """The trilinear interpolant of GRID at points (.., 3) of [0, 1]^3."""
    last = np.array(GRID.shape[::-1]) - 1
    scaled = p * last
    cell = np.clip(np.floor(scaled).astype(int), 0, last - 1)
    (x, y, z), (u, v, w) = np.moveaxis(cell, -1, 0), np.moveaxis(scaled - cell, -1, 0)
    value = np.zeros(p.shape[:-1])
    for i, a in ((0, 1 - u), (1, u)):
        for j, b in ((0, 1 - v), (1, v)):
            for k, c in ((0, 1 - w), (1, w)):
                value += a * b * c * GRID[z + k, y + j, x + i]
    return value


def grid(o: Array, d: Array) -> Array:
    """The first zero of a cubic along the ray in each cell; between its extrema it has one zero at most."""
    planes = np.linspace(0, 1, len(GRID))
    crossings = ((planes[None, None] - o[:, :, None]) / d[:, :, None]).reshape(len(o), -1)
    box = ((np.array([0, 1])[None, None] - o[:, :, None]) / d[:, :, None]).reshape(len(o), 3, 2)
    enter, leave = np.maximum(box.min(axis=2).max(axis=1), 0), box.max(axis=2).min(axis=1)
    leave = np.maximum(enter, leave)
    cuts = np.sort(np.clip(crossings, enter[:, None], leave[:, None]), axis=1)
    cuts = np.concatenate([enter[:, None], cuts, leave[:, None]], axis=1)

    def f(t: Array) -> Array:
        return interpolated(np.clip(at(o, d, t), 0, 1))

    first, width = cuts[:, :-1], np.diff(cuts, axis=1)
    # The cubic in s = (t - first) / width from four values, and where its derivative vanishes.
    f0, f1, f2, f3 = (f(first + width * s) for s in (1e-9, 1 / 3, 2 / 3, 1 - 1e-9))
    c1 = (-11 * f0 + 18 * f1 - 9 * f2 + 2 * f3) / 2
    c2 = (18 * f0 - 45 * f1 + 36 * f2 - 9 * f3) / 2
    c3 = (-9 * f0 + 27 * f1 - 27 * f2 + 9 * f3) / 2
    extrema = quadratic((3 * c3).ravel(), c2.ravel(), c1.ravel()).reshape(*first.shape, 2)
    extrema = np.sort(np.where((extrema > 0) & (extrema < 1), extrema, 1.0), axis=2)
    ends = np.concatenate([0 * first[..., None], extrema, 1 + 0 * first[..., None]], axis=2)
    places = (first[..., None] + width[..., None] * ends).reshape(len(o), -1)
    low, high = places[:, :-1], places[:, 1:]
    value = f(places)
    there = (value[:, :-1] * value[:, 1:] <= 0) & (high > low)
    first_of = np.argmax(there, axis=1)[:, None]
    low, high = (np.take_along_axis(x, first_of, axis=1) for x in (low, high))
    return np.where(there.any(axis=1)[:, None], bracketed(f, low, high), np.nan)


ORACLES: dict[str, Oracle] = {
    "rectangle": rectangle,
    "cube": cube,
    "sphere": sphere,
    "disk": disk,
    "cylinder": cylinder,
    "cone": cone,
    "paraboloid": paraboloid,
    "plane": plane,
    "cuboid": cube,
    "torus": torus,
    "implicit": ball,
    "metaballs": ball,
    "sdfgrid": grid,
}
"""Functions that give all roots (N, K), with NaNs, in the local coordinates that `to_world` maps from."""


def in_local(matrix: Array, o: Array, d: Array) -> tuple[Array, Array]:
    """World rays (N, 3) in the coordinates that `matrix` maps to the world."""
    inverse = np.linalg.inv(matrix[:3, :3])
    return (o - matrix[:3, 3]) @ inverse.T, d @ inverse.T


def closest(oracle: Oracle, matrix: Array, o: Array, d: Array) -> Array:
    """The smallest t > 0 per world ray, or infinity."""
    with np.errstate(all="ignore"):
        t = oracle(*in_local(matrix, o, d))
        return np.where(t > 0, t, np.inf).min(axis=1)

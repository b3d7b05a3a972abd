"""The pieces of shapes that consist of many: curves, cut into straight pieces with a radius at each end; ellipsoids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "CUBIC",
    "ELLIPSOID",
    "LINE",
    "WORDS",
    "CurveSegments",
    "cubic_at",
    "cubic_piece_counts",
    "cubic_pieces",
    "ellipsoid_pieces",
    "linear_pieces",
]

TOLERANCE = 1 / 128
"""The largest distance between a cubic curve and its pieces, in radii."""
MOST = 32
"""The largest number of pieces of a segment."""
WORDS = 8
"""The words of a piece's row: the segment's first control point, the number of the segment or ellipsoid in its shape,
the number of all, the sort; the parameters at both ends (floats); 0, 0."""

Array = NDArray[np.float64]

LINE, CUBIC, ELLIPSOID = 0, 1, 2
"""The sorts of pieces."""

INNER = 4.0
"""The radius of the ball that an ellipsoid's piece is: the axis, of length 1, lies within it."""


@dataclass
class CurveSegments:
    """The pieces of one shape; the first axis of most arrays is the piece."""

    maps: Array
    """The maps into the pieces' spaces, (P, 3, 4): see `djpt.geometry.canonical`."""
    radii: NDArray[np.float32]
    """The radii there, (P, 2)."""
    boxes: Array
    """The boxes about the pieces, (P, 6): low corner, high corner."""
    rows: NDArray[np.uint32]
    """The rows that shading reads, (P, WORDS)."""
    points: Array
    """The control points of curves, (N, 4): place and radius."""


def straight(
    start: Array, end: Array, radii: Array, closed: bool, rows: NDArray[np.uint32], points: Array
) -> CurveSegments:
    """Pieces with straight axes from `start` (P, 3) to `end`; hulls of balls if `closed`, else tubes."""
    low, high = (
        side(start + sign * radii[:, :1], end + sign * radii[:, 1:])
        for side, sign in ((np.minimum, -1), (np.maximum, 1))
    )
    axis = end - start
    length, largest = np.linalg.norm(axis, axis=1), radii.max(axis=1)
    short = length < 1e-5 * largest + 1e-30
    # Such a piece is a ball, or a tube without length: the other end lies within.
    axis = np.where(short[:, None], [0.0, 0, 1], axis / np.maximum(length, 1e-300)[:, None])
    length = np.where(short, 0.5 * largest + 1e-30, length)
    radii = np.where(short[:, None], np.stack([largest * closed, 0 * largest], axis=1), radii)
    across = np.where((np.abs(axis[:, 0]) < 0.6)[:, None], [1.0, 0, 0], [0.0, 1, 0])
    x = np.cross(across, axis)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    linear = np.stack([x, np.cross(axis, x), axis], axis=1) / length[:, None, None]
    radii = radii / length[:, None]
    if not closed:
        radii[:, 0] = -np.maximum(radii[:, 0], 1e-20)
    return CurveSegments(with_shift(linear, start), radii.astype(np.float32), enlarged(low, high), rows, points)


def with_shift(linear: Array, origin: Array) -> Array:
    """The maps (P, 3, 4) with given linear parts that take `origin` (P, 3) to 0."""
    return np.concatenate([linear, -np.einsum("pij,pj->pi", linear, origin)[:, :, None]], axis=2)


def enlarged(low: Array, high: Array) -> Array:
    """Boxes (P, 6) with a margin for rounding."""
    margin = 1e-6 * (np.abs(low).max() + np.abs(high).max() + 1e-30)
    return np.concatenate([low - margin, high + margin], axis=1)


def ellipsoid_pieces(centers: Array, axes: Array) -> CurveSegments:
    """The pieces of ellipsoids: images of the unit ball under the linear maps `axes` (N, 3, 3), moved to `centers`."""
    reach = np.linalg.norm(axes, axis=2)
    count = len(centers)
    numbers, ends = np.arange(count), np.zeros(count)
    rows = rows_of(numbers * 0, numbers, count, ELLIPSOID, ends, ends)
    radii = np.tile(np.array([INNER, 0], np.float32), (count, 1))
    maps = with_shift(INNER * np.asarray(np.linalg.inv(axes), np.float64), centers)
    return CurveSegments(maps, radii, enlarged(centers - reach, centers + reach), rows, np.zeros((0, 4)))


def rows_of(
    first: NDArray[Any], number: NDArray[Any], count: int, sort: int, low: Array, high: Array
) -> NDArray[np.uint32]:
    """The rows of pieces, see `WORDS`."""
    rows = np.zeros((len(first), WORDS), np.uint32)
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = first, number, count, sort
    rows[:, 4], rows[:, 5] = low.astype(np.float32).view(np.uint32), high.astype(np.float32).view(np.uint32)
    return rows


def linear_pieces(points: Array, segments: NDArray[np.uint32]) -> CurveSegments:
    """The pieces of linear curves, one for each segment; `points` (N, 4), `segments` the first point of each."""
    a, b = points[segments], points[segments + 1]
    count = len(segments)
    numbers = np.arange(count)
    rows = rows_of(segments, numbers, count, LINE, np.zeros(count), np.ones(count))
    return straight(a[:, :3], b[:, :3], np.stack([a[:, 3], b[:, 3]], axis=1), True, rows, points)


def cubic_pieces(points: Array, segments: NDArray[np.uint32]) -> CurveSegments:
    """The pieces of cubic B-splines: chords, as many as keep them near the curve.

    After K. Nakamaru and Y. Ohno, "Ray Tracing for Curves Primitive", WSCG 2002, but cut in advance. A chord of a curve
    is off by at most h^2 / 8 times the second derivative, which is linear in a segment. Where chords meet at an
    angle, they reach beyond the joint, so that no ray passes between them.
    """
    controls = points[segments[:, None] + np.arange(4)]
    counts = cubic_piece_counts(points, segments)
    of = np.repeat(np.arange(len(segments)), counts)
    step = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    low, high = step / counts[of], (step + 1) / counts[of]
    a, b = cubic_at(controls[of], low), cubic_at(controls[of], high)

    chord = b[:, :3] - a[:, :3]
    length = np.maximum(np.linalg.norm(chord, axis=1), 1e-30)
    axis = chord / length[:, None]
    # Pieces follow each other within a segment, and where the next segment shares control points.
    joined = (step[1:] > 0) | (segments[of[1:]] == segments[of[:-1]] + 1)
    cosine = np.clip((axis[1:] * axis[:-1]).sum(axis=1), -1, 1)
    bevel = np.sqrt((1 - cosine) / np.maximum(1 + cosine, 0.1))  # the tangent of half the angle
    beyond = np.where(joined, b[:-1, 3] * bevel, 0.0)
    before, after = np.append(0.0, beyond) / length, np.append(beyond, 0.0) / length
    change, span = b - a, high - low
    start, end = a - change * before[:, None], b + change * after[:, None]
    rows = rows_of(segments[of], of, len(segments), CUBIC, low - span * before, high + span * after)
    radii = np.maximum(np.stack([start[:, 3], end[:, 3]], axis=1), 0)
    return straight(start[:, :3], end[:, :3], radii, False, rows, points)


def cubic_piece_counts(points: Array, segments: NDArray[np.uint32]) -> NDArray[np.int64]:
    """The numbers of pieces of the segments of cubic B-splines."""
    controls = points[segments[:, None] + np.arange(4)]
    bend = np.maximum(
        *(
            np.linalg.norm(controls[:, k, :3] - 2 * controls[:, k + 1, :3] + controls[:, k + 2, :3], axis=1)
            for k in (0, 1)
        )
    )
    thin = np.maximum(controls[:, :, 3].mean(axis=1), 1e-9)
    counts: NDArray[np.int64] = np.clip(np.ceil(np.sqrt(bend / (8 * TOLERANCE * thin))), 1, MOST).astype(np.int64)
    return counts


def cubic_at(controls: Array, v: Array) -> Array:
    """Uniform cubic B-splines with four control points each, (N, 4, C), at a parameter each: (N, C)."""
    w = np.stack([(1 - v) ** 3, 3 * v**3 - 6 * v**2 + 4, -3 * v**3 + 3 * v**2 + 3 * v + 1, v**3], axis=1) / 6
    result: Array = np.einsum("nk,nkc->nc", w, controls)
    return result

"""Whether shapes may cut or touch each other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.shapes.mitsuba_api import ShapeType

__all__ = ["between", "encloses", "is_convex", "is_sphere", "may_intersect"]

Floats = NDArray[np.float64]

CLOSE = 1e-4
"""The gap that counts as none, as a fraction of the smaller shape."""

DIRECTIONS = 64
"""The directions, evenly spread, in which a gap between two shapes is looked for."""

MOST_PAIRS = 1 << 24
"""The pairs of triangles, or of triangles and vertices, that are looked at; beyond, shapes count as intersecting."""


def may_intersect(a: Any, b: Any) -> bool:
    """Whether two shapes may have points in common; False only if they certainly don't.

    Apart are shapes with a plane between them, a shape within a sphere, a cube or a mesh, and meshes whose triangles
    keep clear of each other. Shapes that touch count as intersecting, but for a sphere that touches a flat shape or
    another sphere: they share a point, and no curve.
    """
    low_a, high_a = a.world_box()
    low_b, high_b = b.world_box()
    least = CLOSE * min(float(np.linalg.norm(high_a - low_a)), float(np.linalg.norm(high_b - low_b)))
    gap = widest_gap(a, b, least)
    if gap > least or (gap > -least and touch_in_a_point(a, b)):
        return False
    if is_within(a, b, least) or is_within(b, a, least):
        return False
    near_a, near_b = triangles_near(a, low_b - least, high_b + least), triangles_near(b, low_a - least, high_a + least)
    if any(near is not None and not len(near) for near in (near_a, near_b)):
        return False
    return near_a is None or near_b is None or any_overlap(near_a, near_b, least)


def is_sphere(shape: Any) -> bool:
    """Whether a shape is a sphere."""
    return bool(shape.shape_type() == ShapeType.Sphere)


def touch_in_a_point(a: Any, b: Any) -> bool:
    """Whether two shapes that touch share a single point."""
    return any(is_sphere(x) and (is_sphere(y) or y.plane() is not None) for x, y in ((a, b), (b, a)))


def widest_gap(a: Any, b: Any, enough: float) -> float:
    """The largest gap between two shapes along any of some directions, or the first one above `enough`.

    It is below zero if the shapes overlap in all directions. Those of meshes are looked at vertex by vertex.
    """
    widest = -np.inf
    for direction in directions(a, b):
        (low_a, high_a), (low_b, high_b) = a.interval(direction), b.interval(direction)
        widest = max(widest, low_a - high_b, low_b - high_a)
        if widest > enough:
            break
    return float(widest)


def directions(a: Any, b: Any) -> Iterator[Floats]:
    """Unit vectors along which shapes may be apart: axes, normals of flat shapes, from one to the other, and others."""
    yield from np.eye(3)
    for shape in (a, b):
        if shape.plane() is not None:
            yield shape.plane()[0]
    (low_a, high_a), (low_b, high_b) = a.world_box(), b.world_box()
    with np.errstate(invalid="ignore"):  # of infinite planes
        across = low_a + high_a - low_b - high_b
    if np.isfinite(across).all() and across.any():
        yield across / np.linalg.norm(across)
    # A spiral over half of the sphere, in golden angles.
    z = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    angle, radius = np.arange(DIRECTIONS) * np.pi * (3 - np.sqrt(5)), np.sqrt(1 - z * z)
    yield from np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def encloses(outer: Any, inner: Any) -> bool:
    """Whether a shape lies inside of another one that is a sphere or a cube."""
    low, high = inner.world_box()
    return is_within(inner, outer, CLOSE * float(np.linalg.norm(high - low)))


def is_within(inner: Any, outer: Any, least: float) -> bool:
    """Whether a shape lies inside of a sphere or a cube, clear of its surface."""
    low, high = inner.world_box()
    if is_sphere(outer):
        low_o, high_o = outer.world_box()
        center, radius = (low_o + high_o) / 2, float((high_o - low_o)[0]) / 2
        corner = np.maximum(np.abs(low - center), np.abs(high - center))
        return bool(np.linalg.norm(corner) < radius - least)
    if outer.canonical != "cube":
        return False
    normals = np.linalg.inv(np.asarray(outer.to_world.matrix, np.float64)[:3, :3])
    for normal in normals / np.linalg.norm(normals, axis=1, keepdims=True):
        (begin, end), (begin_o, end_o) = inner.interval(normal), outer.interval(normal)
        if begin < begin_o + least or end > end_o - least:
            return False
    return True


def triangles_near(shape: Any, low: Floats, high: Floats) -> Floats | None:
    """The triangles (n, 3, 3) of a mesh that may reach into a box; None if the shape isn't a mesh."""
    if not shape.of_triangles:
        return None
    corners = np.asarray(shape.positions, np.float64)[shape.indices]
    corners = corners[((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1)]
    # The plane of a triangle may still pass the box.
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    distance = np.abs(((low + high) / 2 - corners[:, 0]) * normal).sum(axis=1)
    signed = np.einsum("ij,ij->i", (low + high) / 2 - corners[:, 0], normal)
    reach = np.abs(normal) @ ((high - low) / 2)
    return corners[np.abs(signed) <= reach + 1e-6 * distance]


def any_overlap(a: Floats, b: Floats, least: float) -> bool:
    """Whether the boxes around any two triangles overlap; True for too many pairs."""
    if len(a) * len(b) > MOST_PAIRS:
        return True
    low_a, high_a, low_b, high_b = a.min(axis=1), a.max(axis=1), b.min(axis=1), b.max(axis=1)
    return any(
        bool(((low <= high_b + least) & (high >= low_b - least)).all(axis=1).any())
        for low, high in zip(low_a, high_a, strict=True)
    )


def is_convex(shape: Any) -> bool:
    """Whether a shape is certainly convex, or flat: no part of it stands before another one."""
    if not shape.of_triangles:
        return is_sphere(shape) or shape.plane() is not None or shape.shape_type() == ShapeType.Cylinder
    points, faces = np.asarray(shape.positions, np.float64), np.asarray(shape.indices)
    if len(points) * len(faces) > MOST_PAIRS:
        return False
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    heights = normal @ points.T - np.einsum("ij,ij->i", normal, a)[:, None]
    least = 1e-4 * float(np.ptp(points, axis=0).max())
    # Outward or inward, but alike for all faces.
    return bool((heights < least).all() or (heights > -least).all())


def between(shape: Any, a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> bool:
    """Whether the box around a shape reaches into the convex hull of two boxes.

    The hull consists of the boxes (1 - t) a + t b, 0 <= t <= 1: along each axis those that overlap an interval belong
    to an interval of t.
    """
    low, high = shape.world_box()
    least = CLOSE * max(float(np.linalg.norm(a[1] - a[0])), 1e-6)
    begin, end = 0.0, 1.0
    for axis in range(3):
        # The box's low end must stay below the shape's high end, and the other way round.
        for start, stop, limit in (
            (a[0][axis], b[0][axis], high[axis] - least),
            (-a[1][axis], -b[1][axis], -low[axis] - least),
        ):
            slope = stop - start
            if slope == 0:
                if start >= limit:
                    return False
                continue
            root = (limit - start) / slope
            begin, end = (begin, min(end, root)) if slope > 0 else (max(begin, root), end)
    return bool(begin < end)

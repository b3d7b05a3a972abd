"""Outlines as a camera sees them whose rays start in many places, such as the eye of a stereo panorama.

Such a camera sees each point of space from one place, o = `sight`(y). With y(o, u) the point of an outline as it is
seen from o, at the fraction u of a part of it, what the camera sees is the curve

    y = y(sight(y), u),    dy/du = y_u + y_o sight_y dy/du.

Both are found by iteration from a place in the middle: the places are close to each other compared to what is seen, so
each step leaves a small part of the error. Corners and edges don't depend on o, and are found at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.integrators.projective.carried_rays import leaf
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["Sight", "sampled_from_many"]

Sight = Callable[[Point3f], tuple[Point3f, Any]]
"""The places from which points are seen, and whether there are any."""

MOST_STEPS = 40
CLOSE = 1e-6
"""The step that ends the iteration, relative to 1 + the largest coordinate; a thousand times as large ones fail."""


def sampled_from_many(
    shape: Any, middle: Point3f, sight: Sight, part: UInt32, along: Float, active: Bool
) -> SilhouetteSample3f:
    """A point of a part of the silhouette, each seen from the place of its own; `pdf` is per unit of `silhouette_d`.

    That is the length of the curve across the line of sight over that of `silhouette_d`: what counts on the film.

    Args:
        shape: the shape.
        middle: a place close to all those from which points are seen.
        sight: these places.
        part: the parts, as `Shape.precompute_silhouette` numbers them.
        along: the fractions of the parts.
        active: the lanes that matter.
    """

    def look(o: Point3f, change: Vector3f) -> tuple[SilhouetteSample3f, Vector3f, Point3f, Any, Vector3f]:
        """The point seen from o, and the place from which it is seen, with their derivatives by u."""
        with dr.resume_grad():
            u, place = leaf(along, Float(1)), leaf(Point3f(o), change)
            ss = shape.sample_precomputed_silhouette(place, part, u, active)
            seen_from, exists = sight(ss.p)
            by_p, by_o = dr.forward_to(ss.p, seen_from, flags=dr.ADFlag.ClearEdges)
        return dr.detach(ss), Vector3f(by_p), Point3f(dr.detach(seen_from)), exists, Vector3f(by_o)

    def step(k: UInt32, o: Point3f, change: Vector3f, rest: Float) -> tuple[UInt32, Point3f, Vector3f, Float]:
        _, _, found, _, by_u = look(o, change)
        size = 1 + dr.max(dr.abs(o)) + dr.max(dr.abs(by_u))
        return k + 1, found, by_u, dr.maximum(dr.max(dr.abs(found - o)), dr.max(dr.abs(by_u - change))) / size

    if shape.of_triangles:
        # Points of edges don't depend on the place that sees them.
        seen_from, exists = sight(shape.sample_precomputed_silhouette(middle, part, along, active).p)
        on_edge: SilhouetteSample3f = shape.sample_precomputed_silhouette(seen_from, part, along, active)
        on_edge.discontinuity_type = dr.select(active & exists, on_edge.discontinuity_type, 0)
        return on_edge

    lanes = dr.width(along)
    start = dr.zeros(Point3f, lanes) + middle
    state = dr.zeros(UInt32, lanes), start, dr.zeros(Vector3f, lanes), dr.full(Float, 1, lanes)
    _, o, change, rest = dr.while_loop(
        state, lambda k, _o, _c, rest: active & (k < MOST_STEPS) & (rest > CLOSE), step, label="sight of an outline"
    )
    ss, by_u, _, exists, _ = look(o, change)
    across = dr.cross(ss.n, ss.d)
    speed = dr.abs(dr.dot(by_u, across) * dr.rcp(dr.dot(ss.silhouette_d, across)))
    found = active & exists & (rest < 1000 * CLOSE) & (speed > 0)
    ss.pdf = dr.select(found, dr.rcp(speed), 0)
    ss.discontinuity_type = dr.select(found, ss.discontinuity_type, 0)
    return ss

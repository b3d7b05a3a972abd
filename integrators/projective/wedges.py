"""Wedges between surfaces: the light that is seen on both sides of the edge in which two of them meet.

Rays leave surfaces at a height h above them, see `SurfaceInteraction3f.offset_p`. Next to the edge of a wedge with an
angle of less than 90 degrees, that may be behind the surface on the other side, where there is no light. Two points
are clear of it at the distance 2 h / sin(angle) from the edge.

Where light arrives from behind the plane of the other surface, that throws a shadow, which begins at the edge but may
be narrower than such distances. So points also know the normal of this plane: their horizon.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr

from djpt.core.records import DirectionSample3f, Ray3f, RayFlags, SurfaceInteraction3f
from djpt.jit.types import Bool, Float, Vector3f
from djpt.shapes.silhouettes.foreground import clearance, toward_viewer

__all__ = ["BesideEdge", "above_horizon", "clear_of_wedges", "close_together"]

LEAST_SINE = 0.02
"""That of the narrowest wedge of which points are cleared."""
CLOSE = 8
"""How many heights of rays off each other's planes points may be of surfaces that form a wedge.

Points at the creases of meshes have been moved off them by a few already.
"""


class BesideEdge(NamedTuple):
    """Points on one side of an edge."""

    si: SurfaceInteraction3f
    horizon: Vector3f
    """The normal, on the side of the viewer, of the surface on the other side; 0 if that throws no shadow on points."""


def above_horizon(ds: DirectionSample3f, horizon: Vector3f) -> Bool:
    """Whether light reaches points with a horizon: that of lamps does, whose shadows have no sharp edges."""
    return Bool(~ds.delta | (dr.dot(horizon, ds.d) >= 0))


def close_together(a: SurfaceInteraction3f, b: SurfaceInteraction3f, d: Vector3f) -> Bool:
    """Whether points on both sides of an edge, seen along `d`, lie within a few heights of each other's planes."""
    gap, limit = a.p - b.p, CLOSE * dr.maximum(height(a, d), height(b, d))
    close = (dr.abs(dr.dot(a.n, gap)) < limit) & (dr.abs(dr.dot(b.n, gap)) < limit)
    return Bool(close & a.is_valid() & b.is_valid())


def clear_of_wedges(
    scene: Any, a: SurfaceInteraction3f, b: SurfaceInteraction3f, d: Vector3f, wedge: Bool
) -> tuple[BesideEdge, BesideEdge]:
    """Points on both sides of an edge, moved along their surfaces where these form a narrow wedge.

    Args:
        scene: the scene.
        a: the points on one side.
        b: those on the other side.
        d: the direction in which both are seen, in world space.
        wedge: where the surfaces meet at the edge.
    """
    m_a, m_b = (dr.mulsign(Vector3f(si.n), -dr.dot(si.n, d)) for si in (a, b))
    cosine = dr.dot(m_a, m_b)
    square = dr.maximum(1 - dr.square(cosine), LEAST_SINE**2)
    found = []
    for si, own, other in ((a, m_a, m_b), (b, m_b, m_a)):
        h = height(si, d)
        # In the surface, and away from the other one: a vector of the length of the sine.
        aside = dr.fma(own, -cosine, other) * clearance(h, square)
        above = Ray3f(si.p + aside + own * h, -own)
        moved = scene.ray_intersect(above, int(RayFlags.AllNonDifferentiable), active=wedge)
        lies = wedge & moved.is_valid() & (moved.t < 2 * h) & (moved.shape_index == si.shape_index)
        clear = dr.select(lies & (cosine < 0), toward_viewer(moved, d), si)
        found.append(BesideEdge(clear, dr.select(lies, other, 0)))
    return found[0], found[1]


def height(si: SurfaceInteraction3f, d: Vector3f) -> Float:
    """The height above a surface at which rays leave it."""
    return dr.norm(si.offset_p(d) - si.p)

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
from djpt.jit.types import Bool, Vector3f
from djpt.shapes.silhouettes.foreground import clearance, toward_viewer
from djpt.textures.patches import adjoin

__all__ = ["BesideEdge", "above_horizon", "clear_of_wedges"]

LEAST_SINE = 0.02
"""That of the narrowest wedge of which points are cleared."""


class BesideEdge(NamedTuple):
    """Points on one side of an edge."""

    si: SurfaceInteraction3f
    horizon: Vector3f
    """The normal, on the side of the viewer, of the surface on the other side; 0 if that throws no shadow on points."""


def above_horizon(ds: DirectionSample3f, horizon: Vector3f) -> Bool:
    """Whether light reaches points with a horizon: that of lamps does, whose shadows have no sharp edges."""
    return Bool(~ds.delta | (dr.dot(horizon, ds.d) >= 0))


def clear_of_wedges(
    scene: Any, a: SurfaceInteraction3f, b: SurfaceInteraction3f, d: Vector3f, active: Bool
) -> tuple[BesideEdge, BesideEdge]:
    """Points on both sides of an edge, moved along their surfaces where these form a narrow wedge.

    Args:
        scene: the scene.
        a: the points on one side.
        b: those on the other side.
        d: the direction in which both are seen, in world space.
        active: the lanes that matter.
    """
    m_a, m_b = (dr.mulsign(Vector3f(si.n), -dr.dot(si.n, d)) for si in (a, b))
    cosine = dr.dot(m_a, m_b)
    wedge = active & adjoin(a, b)
    square = dr.maximum(1 - dr.square(cosine), LEAST_SINE**2)
    found = []
    for si, own, other in ((a, m_a, m_b), (b, m_b, m_a)):
        height = dr.norm(si.offset_p(d) - si.p)
        # In the surface, and away from the other one: a vector of the length of the sine.
        aside = dr.fma(own, -cosine, other) * clearance(height, square)
        above = Ray3f(si.p + aside + own * height, -own)
        moved = scene.ray_intersect(above, int(RayFlags.AllNonDifferentiable), active=wedge)
        lies = wedge & moved.is_valid() & (moved.t < 2 * height) & (moved.shape_index == si.shape_index)
        clear = dr.select(lies & (cosine < 0), toward_viewer(moved, d), si)
        found.append(BesideEdge(clear, dr.select(lies, other, 0)))
    return found[0], found[1]

"""Narrow wedges between surfaces: the light that is seen on both sides of the edge in which two of them meet.

Rays leave surfaces at a height h above them, see `SurfaceInteraction3f.offset_p`. Next to the edge of a wedge with an
angle of less than 90 degrees, that may be behind the surface on the other side, where there is no light. Two points
are clear of it at the distance 2 h / sin(angle) from the edge.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import Ray3f, RayFlags, SurfaceInteraction3f
from djpt.jit.types import Bool, Vector3f
from djpt.shapes.silhouettes.foreground import clearance, toward_viewer
from djpt.textures.patches import adjoin

__all__ = ["clear_of_wedges"]

LEAST_SINE = 0.02
"""That of the narrowest wedge of which points are cleared."""


def clear_of_wedges(
    scene: Any, a: SurfaceInteraction3f, b: SurfaceInteraction3f, d: Vector3f, active: Bool
) -> tuple[SurfaceInteraction3f, SurfaceInteraction3f]:
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
    narrow = active & adjoin(a, b) & (cosine < 0)
    square = dr.maximum(1 - dr.square(cosine), LEAST_SINE**2)
    found = []
    for si, own, other in ((a, m_a, m_b), (b, m_b, m_a)):
        height = dr.norm(si.offset_p(d) - si.p)
        # In the surface, and away from the other one: a vector of the length of the sine.
        aside = dr.fma(own, -cosine, other) * clearance(height, square)
        above = Ray3f(si.p + aside + own * height, -own)
        moved = scene.ray_intersect(above, int(RayFlags.AllNonDifferentiable), active=narrow)
        lies = narrow & moved.is_valid() & (moved.t < 2 * height) & (moved.shape_index == si.shape_index)
        found.append(dr.select(lies, toward_viewer(moved, d), si))
    return found[0], found[1]

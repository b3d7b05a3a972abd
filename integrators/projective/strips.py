"""What smooth surfaces show in the strips beside their outlines, in which the edges of that are left to the outlines.

There reflected rays turn with the square root of the distance from the outline, and so does the fraction of the light
that glass reflects: from 1 at the outline to 0.8 at the inner border of the strip. The edges count by the turn of
rays. What changes smoothly doesn't, since its change is in the derivative within the surface: that fraction, and, where
the strip shows no edges, all else.
"""

from __future__ import annotations

import drjit as dr

from djpt.core.records import BSDFFlags, SurfaceInteraction3f, has_flag
from djpt.integrators.projective.smooth_chains import Chains
from djpt.jit.types import Bool, Vector3f
from djpt.shapes.silhouettes.foreground import seen_at, toward_viewer

__all__ = ["beside_outline"]


def beside_outline(
    chains: Chains, inner: SurfaceInteraction3f, d: Vector3f, rim: SurfaceInteraction3f, active: Bool
) -> tuple[SurfaceInteraction3f, Vector3f, Bool]:
    """Points at the inner borders of strips that reflect as much as outlines do, and the way in which they are seen.

    What also lets light pass straight on is seen as it is: that doesn't turn.

    Args:
        chains: what smooth surfaces show.
        inner: the points.
        d: the direction in which they are seen.
        rim: what is seen of the same surfaces at their outlines.
        active: the lanes that matter.

    Returns:
        The points, the way in which they are seen, and where something else is seen there than at the outlines.
    """
    flags = inner.bsdf().flags()
    mirrors = has_flag(flags, BSDFFlags.DeltaReflection) & ~has_flag(flags, BSDFFlags.Null)
    turned, onward = seen_at(inner, d, dr.abs(rim.wi.z))
    smooth = active & has_flag(flags, BSDFFlags.Delta)
    seen = dr.select(mirrors, turned, toward_viewer(inner, d))
    return seen, dr.select(mirrors, onward, d), smooth & chains.show_others(seen, rim, smooth)

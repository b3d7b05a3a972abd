"""Cubic B-spline curves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.records import Ray3f, RayFlags, SurfaceInteraction3f
from djpt.description.registry import register_shape
from djpt.jit.kernels import own_copy
from djpt.jit.types import Bool, Float, Point2f
from djpt.shapes.curve import Curves
from djpt.shapes.curve_segments import CurveSegments, cubic_piece_counts, cubic_pieces
from djpt.shapes.mitsuba_api import ShapeType

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.base import Silhouette

__all__ = ["BSplineCurve"]


class BSplineCurve(Curves):
    """Tubes along uniform cubic B-splines: the circles across them, whose radii are splines, too; open at the ends.

    Parameters: `filename` (at least four points per curve, see `djpt.shapes.curve`), `to_world`. uv = (the angle around
    the curve / 2 pi, (segment + v) / segments) with the parameter v of the segment; angles count from a direction
    across that is horizontal if z is up.

    Rays meet straight pieces, which are within 1 % of the radius of the curve; from there the surface point is moved
    onto the curve, so that its place, normal and uv are exact.
    """

    in_any_frame = True
    shape_kind = ShapeType.BSplineCurve
    least_points = 4

    def pieces(self) -> CurveSegments:
        return cubic_pieces(self.placed_points(), self.segments)

    def tabulate(self) -> None:
        super().tabulate()
        self._count()

    def parameters_changed(self, keys: Sequence[str]) -> None:
        super().parameters_changed(keys)
        if "control_points" in keys:
            self._count()

    def _count(self) -> None:
        counts = cubic_piece_counts(self.placed_points(), self.segments)
        self.piece_counts: Any = own_copy(counts.astype(np.uint32))
        """The number of pieces of each segment."""

    def eval_parameterization(
        self, uv: Any, ray_flags: int = RayFlags.All, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The surface point with the texture coordinates (u, v) in the unit square; `t` is 0."""
        silhouette: Any = self.silhouette()
        uv = Point2f(uv)
        prim, v = silhouette.segment_at(uv.y)
        ring, _ = silhouette.ring(prim, v, active)
        out = ring.out(2 * math.pi * uv.x)
        n = ring.normal(out)
        # From where the straight pieces aren't in the way.
        si: SurfaceInteraction3f = self.alone().ray_intersect(
            Ray3f(dr.fma(n, 0.1 * ring.place.r, ring.point(out)), -n), ray_flags, active=active
        )
        si.t = dr.select(active, Float(0), dr.inf)
        return si

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.bsplinecurve import BSplineCurveSilhouette

        return BSplineCurveSilhouette


register_shape("bsplinecurve", BSplineCurve)

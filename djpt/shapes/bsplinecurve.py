"""Cubic B-spline curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from djpt.description.registry import register_shape
from djpt.jit.kernels import own_copy
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
        self._count()

    def _count(self) -> None:
        counts = cubic_piece_counts(self.placed_points(), self.segments)
        self.piece_counts: Any = own_copy(counts.astype(np.uint32))
        """The number of pieces of each segment."""

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.bsplinecurve import BSplineCurveSilhouette

        return BSplineCurveSilhouette


register_shape("bsplinecurve", BSplineCurve)

"""Curves of straight segments."""

from __future__ import annotations

from djpt.description.registry import register_shape
from djpt.shapes.curve import Curves
from djpt.shapes.curve_segments import CurveSegments, linear_pieces
from djpt.shapes.mitsuba_api import ShapeType

__all__ = ["LinearCurve"]


class LinearCurve(Curves):
    """Curves of straight segments between control points: the hulls of balls about neighbouring points.

    Parameters: `filename` (at least two points per curve, see `djpt.shapes.curve`), `to_world`. uv = (the angle around
    the segment / 2 pi, (segment + v) / segments) with v along the segment; angles count from a direction across that is
    horizontal if z is up.
    """

    in_any_frame = True
    shape_kind = ShapeType.LinearCurve
    least_points = 2

    def pieces(self) -> CurveSegments:
        return linear_pieces(self.placed_points(), self.segments)


register_shape("linearcurve", LinearCurve)

"""All pieces of a scene, as kernels read them: control points, rows, and the surface of curves at a hit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.frame import Frame3f
from djpt.jit.kernels import float_in, maximum, minimum, own_copy, own_floats
from djpt.jit.types import Array4f, ArrayXu, Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.base import Surface
from djpt.shapes.cubic_curve import Place, cubic_place, local_axes, unit
from djpt.shapes.curve_segments import CUBIC, ELLIPSOID, LINE, WORDS, CurveSegments

__all__ = ["CurveSegmentSet"]

STEPS = 3
"""The steps from a piece to the cubic curve."""


class CurveSegmentSet:
    """The pieces of all shapes of a scene that have some. A hit knows the number of its piece among them."""

    def __init__(self, pieces: Sequence[CurveSegments]) -> None:
        first = np.cumsum([0, *(len(part.points) for part in pieces)])
        rows = []
        for start, part in zip(first, pieces, strict=False):
            own = part.rows.copy()
            own[:, 0] += np.uint32(start)
            rows.append(own)
        points = np.concatenate([part.points for part in pieces]).astype(np.float32)
        self._points = own_floats(points if len(points) else np.zeros((1, 4), np.float32))
        self._rows = own_copy(np.concatenate(rows))
        sorts = {int(sort) for part in pieces for sort in np.unique(part.rows[:, 3])}
        self._linear, self._cubic, self.has_ellipsoids = (sort in sorts for sort in (LINE, CUBIC, ELLIPSOID))
        self.has_curves = self._linear or self._cubic

    # ---- in kernels ------------------------------------------------------------------

    def segment(self, piece: UInt32, active: Bool | bool = True) -> UInt32:
        """The number of a piece's segment or ellipsoid in its shape."""
        return dr.gather(UInt32, self._rows, piece * WORDS + 1, active)

    def is_ellipsoid(self, piece: UInt32, active: Bool) -> Bool:
        """Whether a piece is an ellipsoid."""
        return dr.gather(UInt32, self._rows, piece * WORDS + 3, active) == ELLIPSOID

    def curve(
        self, piece: UInt32, p: Point3f, d: Vector3f, along: Float, radii: tuple[Float, Float], active: Bool
    ) -> Surface:
        """The surface point where a ray meets a piece of a curve; where not `active` it is unspecified.

        Args:
            piece: the number of the piece.
            p: the point on the piece, in world space.
            d: the direction of the ray.
            along: where `p` lies along the axis of the piece, from 0 to 1 between its ends.
            radii: the radii at both ends, in the length of the axis.
            active: where `piece` is the number of one.
        """
        words: Any = dr.gather(ArrayXu, self._rows, piece, active, shape=(WORDS, 1))
        first, number, count, sort, low, high = list(words)[:6]
        cubic = sort == CUBIC
        low, high = float_in(low), float_in(high)
        if not self._cubic:
            v, place, p = self._on_line(first, p, along, radii, active)
        elif not self._linear:
            v, place, p = self._on_cubic(first, p, d, dr.lerp(low, high, along), active)
        else:
            on_line = self._on_line(first, p, along, radii, active)
            on_cubic = self._on_cubic(first, p, d, dr.lerp(low, high, along), active)
            v, place, p = dr.select(cubic, on_cubic, on_line)

        tangent, out = unit(place.dc), unit(p - place.c)
        turned = dr.normalize(
            (dr.squared_norm(place.dc) - place.r * dr.dot(out, place.ddc)) * out - place.dr * place.dc
        )
        n = out if not self._cubic else turned if not self._linear else dr.select(cubic, turned, out)

        rotation, origin, twist = local_axes(tangent, place)
        angle = dr.atan2(dr.dot(rotation, out), dr.dot(origin, out))
        u = dr.select(angle < 0, angle + 2 * math.pi, angle) * (0.5 / math.pi)
        around = dr.cross(tangent, out)
        total = Float(count)
        dp_du = around * (2 * math.pi * place.r)
        slide = dr.fma(out, place.dr, place.dc)
        if self._cubic:
            bend = place.ddc - tangent * dr.dot(tangent, place.ddc)
            inv = dr.rsqrt(dr.maximum(dr.squared_norm(place.dc), 1e-30))
            lean = around * twist - tangent * (dr.dot(out, bend) * inv)
            curved = dr.fma(lean, place.r, slide)
            slide = curved if not self._linear else dr.select(cubic, curved, slide)
        s = dr.normalize(dr.fma(n, -dr.dot(n, around), around))
        uv = Point2f(u, (v + Float(number)) / total)
        return Surface(p, n, Frame3f(s, dr.cross(n, s), n), uv, dp_du, slide * total, Point2f(v, 0))

    def _on_line(
        self, first: UInt32, p: Point3f, along: Float, radii: tuple[Float, Float], active: Bool
    ) -> tuple[Float, Place, Point3f]:
        """The ball that touches the hull at a point, by its parameter."""
        a, b = (dr.gather(Array4f, self._points, first + k, active) for k in range(2))
        slope = radii[1] - radii[0]
        shrink = 1 - dr.square(slope)
        # Where one ball holds the other, all that is seen is the larger one.
        larger = dr.select(slope > 0, Float(1), 0)
        v = dr.select(shrink > 0, dr.fma(radii[0], slope, along) / shrink, larger)
        v = minimum(maximum(v, Float(0)), Float(1))
        axis = Vector3f(b.x - a.x, b.y - a.y, b.z - a.z)
        center = dr.fma(axis, v, Point3f(a.x, a.y, a.z))
        change = b.w - a.w
        return v, Place(center, axis, Vector3f(0), dr.fma(change, v, a.w), change, Float(0)), p

    def _on_cubic(self, first: UInt32, p: Point3f, d: Vector3f, v: Float, active: Bool) -> tuple[Float, Place, Point3f]:
        """The point of a cubic curve on a ray along `d`, starting near the point `p` and the parameter `v`.

        In turn, the parameter moves to the circle whose plane holds the point, and the point along the ray to where it
        enters the cylinder of the circle's radius, or is closest to it. What is left the point is moved across.
        """
        points = [dr.gather(Array4f, self._points, first + k, active) for k in range(4)]
        v = dr.clip(v, 0, 1)
        least, limit = 1e-4 * dr.squared_norm(d), dr.rcp(dr.norm(d))
        for _ in range(STEPS):
            place = cubic_place(points, v)
            out = p - place.c
            slope = dr.dot(out, place.ddc) - dr.squared_norm(place.dc)
            step = dr.dot(out, place.dc) / dr.select(slope < 0, slope, -1)
            v = dr.clip(v - dr.clip(step, -0.25, 0.25), 0, 1)
            place = cubic_place(points, v)
            out, tangent = p - place.c, unit(place.dc)
            across = dr.fma(tangent, -dr.dot(tangent, d), d)
            a, b = maximum(dr.squared_norm(across), least), dr.dot(out, across)
            discriminant = b * b - a * (dr.squared_norm(out) - dr.square(place.r))
            forward = -(b + dr.sqrt(maximum(discriminant, Float(0)))) / a
            p = dr.fma(d, dr.clip(forward, -limit * place.r, limit * place.r), p)
        place = cubic_place(points, v)
        out = p - place.c
        return v, place, dr.fma(out, place.r / maximum(dr.norm(out), Float(1e-30)), place.c)

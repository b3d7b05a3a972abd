"""The first point where a ray goes into a piece: of a curve, or an ellipsoid, which is a ball in its space."""

from __future__ import annotations

import math
from typing import Any

from djpt.jit.arithmetic import Arithmetic

__all__ = ["hit_piece"]


def hit_piece(m: Arithmetic, o: Any, d: Any, first: Any, last: Any) -> tuple[Any, Any]:
    """Where a line goes into a piece from outside; its axis is that from the origin to (0, 0, 1).

    `first` and `last` are the radii at the ends. A piece is the hull of the balls with these radii about the ends; or,
    if `first` is negative, a tube without ends: the circles of radius r(z) across the axis, r(0) = -first.

    Balls of radius r(v) = r + s v about the points of the axis touch their hull where z - v = -s r(v). With D = 1 - s^2
    its side is D (x^2 + y^2) = (r + s z)^2 for 0 <= z + s r <= D; the tube's has D = 1, for 0 <= z <= 1. A ray goes in
    at the first solution of the quadratic equation, whatever the sign of its leading coefficient.
    """
    tube = first < 0
    radius = m.abs(first)
    slope = last - radius
    inv = m.rcp(m.fma(d.x, d.x, m.fma(d.y, d.y, d.z * d.z)))
    # From the point closest to the middle, where the discriminant cancels least.
    start = -m.fma(o.x, d.x, m.fma(o.y, d.y, (o.z - 0.5) * d.z)) * inv
    x, y, z = m.fma(d.x, start, o.x), m.fma(d.y, start, o.y), m.fma(d.z, start, o.z)

    shrink, shift = m.select(tube, 1.0, 1.0 - slope * slope), m.select(tube, 0.0, radius * slope)
    here, change = m.fma(slope, z, radius), slope * d.z
    a = shrink * m.fma(d.x, d.x, d.y * d.y) - change * change
    b = shrink * m.fma(x, d.x, y * d.y) - change * here
    c = shrink * m.fma(x, x, y * y) - here * here
    discriminant = b * b - a * c
    root = m.sqrt(m.select(discriminant > 0, discriminant, 0.0))
    near = m.select(b > 0, (-b - root) * m.rcp(a), c * m.rcp(root - b))
    place = m.fma(d.z, near, z) + shift
    on_side = (discriminant >= 0) & (place >= 0) & (place <= shrink)
    t = m.select(on_side, near, math.inf)

    # The balls lie within the hull: where a ray goes into them first, it goes into the hull.
    for end, size in ((0.0, radius), (1.0, last)):
        rest = z - end
        middle = -m.fma(x, d.x, m.fma(y, d.y, rest * d.z)) * inv
        px, py, pz = m.fma(d.x, middle, x), m.fma(d.y, middle, y), m.fma(d.z, middle, rest)
        reach = (size * size - m.fma(px, px, m.fma(py, py, pz * pz))) * inv
        into = middle - m.sqrt(m.select(reach > 0, reach, 0.0))
        t = m.select((reach > 0) & ~tube & (into < t), into, t)
    return t < math.inf, start + t

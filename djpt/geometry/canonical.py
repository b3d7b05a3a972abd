"""Analytic shapes in their own space, where each is the same for all its instances.

The analytic shapes of a scene are unrolled if they are few. If they are many they stand in the BVH:
the record of a shape holds the map to its canonical space, and lanes that come to one take the ray
there. Affine maps keep distances along a ray, so `t` means the same in both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.jit.kernels import KERNELS, Arithmetic
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f

__all__ = ["FLAT_KINDS", "KINDS", "PIECE", "LocalSurface", "hit_kind", "hit_piece", "intersect", "surface"]

KINDS = ("rectangle", "disk", "cube", "sphere", "cylinder", "piece")
"""The square [-1, 1]^2, the unit disk, the cube [-1, 1]^3, the unit sphere, the unit cylinder 0 <= z <= 1; pieces of
curves, whose records have the number of the piece added to the kind, and two radii."""

PIECE = KINDS.index("piece")


@dataclass
class LocalSurface:
    """A surface point in canonical space; the normal points outwards, or along +z."""

    n: Vector3f
    uv: Point2f
    dp_du: Vector3f
    dp_dv: Vector3f
    triangle: UInt32
    """The primitive as Mitsuba counts it."""


FLAT_KINDS = 3
"""The number of kinds, the first of `KINDS`, that are flat, or meshes in Mitsuba."""


def intersect(
    kinds: Sequence[int], kind: UInt32, o: Point3f, d: Vector3f, maxt: Float, radii: Sequence[Float]
) -> tuple[Bool, Float]:
    """The first hit with 0 < t < maxt of a shape whose `kind` is among `kinds`, numbers into KINDS.

    `radii` are those of a piece.
    """
    hit, t = hit_kind(KERNELS, kinds[0], o, d, radii)
    for k in kinds[1:]:
        other_hit, other_t = hit_kind(KERNELS, k, o, d, radii)
        here = kind >= k if k == PIECE else kind == k
        hit, t = dr.select(here, other_hit, hit), dr.select(here, other_t, t)
    return hit & (t > 0) & (t < maxt), t


def surface(kinds: Sequence[int], kind: UInt32, p: Point3f) -> LocalSurface:
    """The normal, the texture coordinates and their derivatives at a point `p` on the surface."""
    result = SURFACES[KINDS[kinds[0]]](p)
    for k in kinds[1:]:
        result = dr.select(kind == k, SURFACES[KINDS[k]](p), result)
    return result


# ---- intersection ------------------------------------------------------------------------


def hit_kind(m: Arithmetic, kind: int, o: Any, d: Any, radii: Sequence[Any]) -> tuple[Any, Any]:
    """Whether a line hits a shape of a kind, and where; `radii` are those of a piece."""
    return hit_piece(m, o, d, *radii) if kind == PIECE else HITS[KINDS[kind]](m, o, d)


# Formulas of an arithmetic `m`, an origin and a direction. They return whether the line hits, and where.


def hit_rectangle(m: Arithmetic, o: Any, d: Any) -> tuple[Any, Any]:
    t = -o.z * m.rcp(d.z)
    x, y = m.fma(d.x, t, o.x), m.fma(d.y, t, o.y)
    return (m.abs(x) <= 1) & (m.abs(y) <= 1), t


def hit_disk(m: Arithmetic, o: Any, d: Any) -> tuple[Any, Any]:
    t = -o.z * m.rcp(d.z)
    x, y = m.fma(d.x, t, o.x), m.fma(d.y, t, o.y)
    return m.fma(x, x, y * y) <= 1, t


def hit_cube(m: Arithmetic, o: Any, d: Any) -> tuple[Any, Any]:
    entry, leave = -math.inf, math.inf
    for axis in range(3):
        inv = m.rcp(d[axis])
        middle, half = -o[axis] * inv, m.abs(inv)
        # In this order an axis that the ray runs across counts for nothing if it gives NaN.
        entry, leave = m.maximum(middle - half, entry), m.minimum(middle + half, leave)
    return entry <= leave, m.select(entry > 0, entry, leave)


def hit_sphere(m: Arithmetic, o: Any, d: Any) -> tuple[Any, Any]:
    # From the point closest to the centre: see `djpt.shapes.sphere`.
    inv = m.rcp(dot(m, d, d))
    middle = -dot(m, o, d) * inv
    closest = [m.fma(d[axis], middle, o[axis]) for axis in range(3)]
    discriminant = (1 - dot(m, closest, closest)) * inv
    reach = m.sqrt(m.select(discriminant > 0, discriminant, 0))
    near = middle - reach
    return discriminant >= 0, m.select(near > 0, near, middle + reach)


def hit_cylinder(m: Arithmetic, o: Any, d: Any) -> tuple[Any, Any]:
    inv = m.rcp(m.fma(d.x, d.x, d.y * d.y))
    middle = -m.fma(o.x, d.x, o.y * d.y) * inv
    x, y = m.fma(d.x, middle, o.x), m.fma(d.y, middle, o.y)
    discriminant = (1 - m.fma(x, x, y * y)) * inv
    reach = m.sqrt(m.select(discriminant > 0, discriminant, 0))
    near, far = middle - reach, middle + reach
    z_near, z_far = m.fma(d.z, near, o.z), m.fma(d.z, far, o.z)
    first = (near > 0) & (z_near >= 0) & (z_near <= 1)
    second = (z_far >= 0) & (z_far <= 1)
    return (discriminant >= 0) & (first | second), m.select(first, near, far)


def dot(m: Arithmetic, a: Any, b: Any) -> Any:
    """The dot product."""
    return m.fma(a[2], b[2], m.fma(a[1], b[1], a[0] * b[0]))


# ---- surface -----------------------------------------------------------------------------

UP = (0.0, 0.0, 1.0)


def on_rectangle(p: Point3f) -> LocalSurface:
    uv = Point2f(dr.fma(p.x, 0.5, 0.5), dr.fma(p.y, 0.5, 0.5))
    triangle = dr.select(uv.x + uv.y > 1, UInt32(1), UInt32(0))
    return LocalSurface(Vector3f(*UP), uv, Vector3f(2, 0, 0), Vector3f(0, 2, 0), triangle)


def on_disk(p: Point3f) -> LocalSurface:
    radius = dr.sqrt(dr.fma(p.x, p.x, p.y * p.y))
    inv = dr.select(radius > 0, dr.rcp(radius), 0)
    outward = Vector3f(dr.select(radius > 0, p.x * inv, 1), p.y * inv, 0)
    around = 2 * math.pi * Vector3f(-p.y, p.x, 0)
    return LocalSurface(Vector3f(*UP), Point2f(radius, turn(p)), outward, around, UInt32(0))


def on_cube(p: Point3f) -> LocalSurface:
    from djpt.shapes.cube import FACES, face_axis

    x, y, z = dr.abs(p.x), dr.abs(p.y), dr.abs(p.z)
    axis = dr.select((x >= y) & (x >= z), UInt32(0), dr.select(y >= z, UInt32(1), UInt32(2)))
    along: Float = dr.select(axis == 0, p.x, dr.select(axis == 1, p.y, p.z))
    result: LocalSurface | None = None
    for face, ((a, sign), (u, u_sign), (v, v_sign)) in enumerate(FACES):
        n, du, dv = (Vector3f(*(float(x) for x in face_axis(spec))) for spec in FACES[face])
        uv = Point2f(dr.fma(p[u], 0.5 * u_sign, 0.5), dr.fma(p[v], 0.5 * v_sign, 0.5))
        triangle = 2 * face + dr.select(uv.x + uv.y < 1, UInt32(1), UInt32(0))
        here = LocalSurface(n, uv, 2 * du, 2 * dv, triangle)
        chosen = (axis == a) & ((along > 0) == (sign > 0))
        result = here if result is None else dr.select(chosen, here, result)
    assert result is not None
    return result


def on_sphere(p: Point3f) -> LocalSurface:
    n = dr.normalize(p)
    rim = dr.sqrt(dr.fma(n.x, n.x, n.y * n.y))
    inv = dr.select(rim > 0, dr.rcp(rim), 0)
    cos_phi, sin_phi = dr.select(rim > 0, n.x * inv, 1), n.y * inv
    uv = Point2f(turn(n), dr.safe_acos(n.z) * dr.inv_pi)
    du = 2 * math.pi * Vector3f(-n.y, n.x, 0)
    return LocalSurface(n, uv, du, math.pi * Vector3f(n.z * cos_phi, n.z * sin_phi, -rim), UInt32(0))


def on_cylinder(p: Point3f) -> LocalSurface:
    around = 2 * math.pi * Vector3f(-p.y, p.x, 0)
    return LocalSurface(Vector3f(p.x, p.y, 0), Point2f(turn(p), p.z), around, Vector3f(*UP), UInt32(0))


def turn(p: Point3f) -> Float:
    """The angle about z, counted from the x axis, as a fraction of the full turn: phi / 2 pi in [0, 1)."""
    phi = dr.atan2(p.y, p.x)
    return dr.select(phi < 0, phi + 2 * math.pi, phi) * (1 / (2 * math.pi))


HITS: dict[str, Callable[[Arithmetic, Any, Any], tuple[Any, Any]]] = {
    "rectangle": hit_rectangle,
    "disk": hit_disk,
    "cube": hit_cube,
    "sphere": hit_sphere,
    "cylinder": hit_cylinder,
}
SURFACES: dict[str, Callable[[Point3f], LocalSurface]] = {
    "rectangle": on_rectangle,
    "disk": on_disk,
    "cube": on_cube,
    "sphere": on_sphere,
    "cylinder": on_cylinder,
}


# ---- pieces of curves, and ellipsoids, which are balls in their space --------------------------------------------


def hit_piece(m: Arithmetic, o: Any, d: Any, first: Any, last: Any) -> tuple[Any, Any]:
    """The entry of a line into a piece from outside; the piece's axis runs from the origin to (0, 0, 1).

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

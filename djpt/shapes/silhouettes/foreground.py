"""The surface that a viewer sees on this side of a silhouette."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import RAY_EPSILON, Ray3f, RayFlags, SurfaceInteraction3f
from djpt.jit.types import Bool, Float, Normal3f, Point3f, Vector3f
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["clearance", "foreground", "nothing_at", "seen_at", "toward_viewer"]

LEAST_COSINE = 1e-5
"""The least cosine of a viewer's direction with a shading normal that is bent towards it."""

CLEAR = 0.05
"""How far beside a silhouette other surfaces are looked for, relative to how much of the line of sight is."""

HEIGHTS = 2
"""How far above the other surface of a narrow wedge points are clear of it, in heights at which rays leave."""


def foreground(
    scene: Any, shapes: list[Any], ss: SilhouetteSample3f, active: Bool | bool
) -> tuple[SurfaceInteraction3f, Bool]:
    """The surface points at silhouettes, seen along `ss.d`, and whether they were found.

    A ray from just above the surface finds the triangle and all that belongs to it. Where the shading normal points
    away from the viewer, it is bent until it doesn't, unless samples are `unbent`: rounding decides for analytic
    shapes. Meshes with smooth normals are dark before their outline; if the inner border of this strip isn't sampled
    by itself (`Seams`), it counts as if it moved with the outline, with the sum of both jumps.

    Args:
        scene: the scene.
        shapes: `scene.silhouette_shapes()`, which `ss.scene_index` counts.
        ss: the silhouettes.
        active: the lanes that matter.
    """
    p, n = Point3f(ss.p), Normal3f(ss.n)
    for number, shape in enumerate(shapes):
        mine = ss.scene_index == number
        near, outer = shape.silhouette().foreground(ss, active & mine)
        p, n = dr.select(mine, near, p), dr.select(mine, outer, n)
    front = dr.dot(n, ss.d) <= 1e-3
    toward = dr.select(front, n, -n)
    height = dr.fma(RAY_EPSILON, 1 + dr.max(dr.abs(p)), ss.gap)
    si = scene.ray_intersect(Ray3f(dr.fma(toward, height, p), -toward), RayFlags.AllNonDifferentiable, active=active)
    found = si.is_valid() & (si.t < 4 * height) & active
    on_shape = Bool(False)
    for number, shape in enumerate(shapes):
        on_shape |= (ss.scene_index == number) & (si.shape == shape)

    side = dr.select(dr.dot(si.n, toward) > 0, Float(1), -1)
    si.sh_frame = dr.select(ss.unbent, si.sh_frame, bent_frame(si, ss.d, side))
    si.wi = si.sh_frame.to_local(-ss.d)
    return si, found & on_shape


def nothing_at(scene: Any, ss: SilhouetteSample3f, active: Bool | bool) -> Bool:
    """Whether no other surface is where silhouettes of curved shapes are.

    Rays start ahead of these and behind them, beyond what would be there, such as the floor that a tube stands on. The
    curve in which both meet isn't a silhouette; where surfaces meet, random lines find it.
    """
    if not any(shape.silhouette().offset > 0 for shape in scene.silhouettes.outlined()):
        return Bool(True)
    start, end = ss.toward_viewer().spawn_ray().o, ss.spawn_ray().o
    # Clear of the shape itself.
    beside = start + ss.n * (CLEAR * dr.norm(end - start))
    skips = active & (ss.offset > 0)
    return ~(skips & scene.ray_test(Ray3f(beside, end - start, maxt=Float(1)), skips))


def toward_viewer(si: SurfaceInteraction3f, d: Vector3f) -> SurfaceInteraction3f:
    """Surface points that are seen along `d`; where the shading normal points away, it is bent until it doesn't."""
    frame = bent_frame(si, d, dr.select(dr.dot(si.n, d) < 0, Float(1), -1))
    return si.replaced(sh_frame=frame, wi=dr.select(si.is_valid(), frame.to_local(-d), si.wi))


def seen_at(si: SurfaceInteraction3f, d: Vector3f, cosine: Float) -> tuple[SurfaceInteraction3f, Vector3f]:
    """Surface points that mirror light from where they do, but as if seen at another cosine; and the way they are seen.

    Args:
        si: the points.
        d: the direction in which they are seen.
        cosine: that of the angle with the normal which decides how much they reflect; not below that of bent normals.
    """
    n = dr.mulsign(Vector3f(si.sh_frame.n), -dr.dot(si.sh_frame.n, d))
    mirrored = dr.fma(n, -2 * dr.dot(n, d), d)
    c = dr.maximum(cosine, 2 * LEAST_COSINE)
    across = dr.normalize(dr.fma(mirrored, -dr.dot(mirrored, n), n))
    turned = dr.fma(mirrored, c, across * dr.safe_sqrt(1 - dr.square(c)))
    onward = dr.fma(turned, -2 * c, mirrored)
    shading = Normal3f(dr.mulsign(turned, dr.dot(si.sh_frame.n, n)))
    frame = frame_about(shading, si.sh_frame.s)
    outer = Normal3f(dr.mulsign(turned, dr.dot(si.n, n)))
    return si.replaced(n=outer, sh_frame=frame, wi=frame.to_local(-onward)), onward


def clearance(height: Float, sine: Float) -> Float:
    """How far off the edge of a narrow wedge points are clear of it, given the height at which rays leave."""
    return HEIGHTS * height / sine


def bent_frame(si: SurfaceInteraction3f, d: Vector3f, side: Float) -> Frame3f:
    """The shading frame, bent towards a viewer who looks along `d` at one `side`, 1 or -1, if it points away.

    Its tangent stays as near as it can, since materials may depend on it.
    """
    shading = si.sh_frame.n
    cosine = side * dr.dot(shading, d)
    bent = dr.normalize(shading - side * (cosine + LEAST_COSINE) * d)
    away = cosine > -LEAST_COSINE
    found: Frame3f = dr.select(away, frame_about(bent, si.sh_frame.s), si.sh_frame)
    return found


def frame_about(n: Normal3f, tangent: Vector3f) -> Frame3f:
    """The frame about a normal whose first tangent is as near as it can be to a given one."""
    s = dr.fma(n, -dr.dot(n, tangent), tangent)
    s = dr.select(dr.squared_norm(s) > 1e-6, dr.normalize(s), Frame3f.from_normal(n).s)
    return Frame3f(s, dr.cross(n, s), n)

"""Hits on shapes whose parameters have gradients: how the point of a ray moves with the surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import Ray3f, RayFlags, SurfaceInteraction3f
from djpt.jit.types import Float, Normal3f, Vector3f
from djpt.shapes.silhouettes.base import aligned, with_gradient

__all__ = ["attach"]


def attach(si: SurfaceInteraction3f, ray: Ray3f, flags: int, moving: Sequence[tuple[int, Any]]) -> SurfaceInteraction3f:
    """Attach hits to the parameters of moving shapes.

    A ray keeps its direction, and meets the moved surface where, to first order, it meets the moved tangent plane:

        t = <n, q - o> / <n, d>,    q: the point that sticks to the surface.

    Where d grazes the surface, hits slide without bound; with a cosine below `Silhouette.grazing` they stay.
    With `RayFlags.FollowShape` the hit is q itself. Values stay as they are. Derivatives of dp/dv are left out.

    Args:
        si: the hits.
        ray: the rays, attached or not.
        flags: `RayFlags`; `DetachShape` leaves everything out.
        moving: the shapes, each with its index in the scene.
    """
    if flags & RayFlags.DetachShape:
        return si
    p, n, uv, dp_du = si.p, Normal3f(si.n), si.uv, Vector3f(si.dp_du)
    frame = si.sh_frame
    shading, s = Normal3f(frame.n), Vector3f(frame.s)
    t = Float(si.t)
    still = dr.detach(si)
    for index, shape in moving:
        silhouette = shape.silhouette()
        mine = still.is_valid() & (still.shape_index == index)
        place, prim = silhouette.attached(dr.width(still.p)), still.prim_index
        followed = silhouette.follow(prim, silhouette.texture_place(still.uv, still.prim_uv), mine)
        if place is None or followed is None:
            continue
        if flags & RayFlags.FollowShape:
            distance, moved = dr.norm(followed - ray.o) * dr.rcp(dr.norm(ray.d)), followed
        else:
            cosine = dr.dot(still.n, ray.d)
            slides = dr.abs(dr.detach(cosine)) > silhouette.grazing * dr.norm(dr.detach(ray.d))
            mine &= slides
            distance = dr.dot(still.n, followed - ray.o) * dr.rcp(dr.select(slides, cosine, 1))
            moved = dr.fma(ray.d, distance, ray.o)
        surface = silhouette.surface(place, with_gradient(still.p, moved), prim, mine)
        t = dr.select(mine, with_gradient(still.t, distance), t)
        p = dr.select(mine, with_gradient(still.p, moved), p)
        n = dr.select(mine, with_gradient(still.n, aligned(surface.n, still.n)), n)
        turned_n = with_gradient(still.sh_frame.n, aligned(surface.shading, still.sh_frame.n))
        shading = dr.select(mine, turned_n, shading)
        s = dr.select(mine, with_gradient(still.sh_frame.s, tangent(still.sh_frame.s, turned_n, surface.dp_du)), s)
        uv = dr.select(mine, with_gradient(still.uv, surface.uv), uv)
        dp_du = dr.select(mine, with_gradient(still.dp_du, surface.dp_du), dp_du)
    valid = si.is_valid()
    turned = Frame3f(with_gradient(frame.s, s), with_gradient(frame.t, dr.cross(shading, s)), shading)
    result: SurfaceInteraction3f = si.replaced(
        p=p,
        n=n,
        uv=uv,
        dp_du=dp_du,
        sh_frame=turned,
        wi=with_gradient(si.wi, dr.select(valid, turned.to_local(-ray.d), -ray.d)),
    )
    result.found_at(t, valid)
    return result


def tangent(s: Vector3f, n: Normal3f, dp_du: Vector3f) -> Vector3f:
    """The tangent `s` of a shading frame about `n`, attached to dp/du where that is what it follows, else to `n`."""
    across = dr.fma(n, -dr.dot(n, dp_du), dp_du)
    follows = dr.dot(dr.detach(across), s) > 0.99 * dr.norm(dr.detach(across))
    return dr.normalize(dr.select(follows, across, dr.fma(n, -dr.dot(n, s), s)))

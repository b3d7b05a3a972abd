"""What bodies a point lies in, by the vote of rays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.records import RAY_EPSILON, BSDFFlags, Ray3f, has_flag
from djpt.errors import SceneError
from djpt.geometry.overlapping import OverlappingGeometry
from djpt.jit.types import Float, Point3f, Vector3f

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Surrounding", "index_around", "surroundings"]

CROSSINGS = 256
"""Most surfaces along a ray."""


@dataclass(frozen=True)
class Surrounding:
    """A closed shape around a point."""

    shape: Any
    votes: float
    """The share of the rays from the point that say so: 1 if it is certain."""
    eta: float | None
    """The relative index of refraction of its BSDF; None if that refracts nothing."""


def surroundings(scene: Scene, point: Sequence[float], rays: int = 64) -> list[Surrounding]:
    """The closed shapes that a point lies in, by the vote of rays in directions all around; the smallest first.

    A ray votes that the point is within a shape if it crosses its surface an odd number of times. Rays through edges,
    holes, or surfaces that touch may err; shapes for which no ray votes are left out.
    """
    shapes = scene.shapes()
    k = np.arange(rays)
    # Directions by the golden angle, moved off the axes, along which rays run within faces.
    z, turn = (2 * k + 1.1) / (rays + 0.2) - 1, 2.399963 * k + 0.7
    across = np.sqrt(1 - z * z)
    d = np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1).astype(np.float32)
    o = np.broadcast_to(np.asarray(point, np.float32), d.shape).copy()
    odd = np.zeros((rays, len(shapes)), np.bool_)
    active = np.ones(rays, np.bool_)
    for _ in range(CROSSINGS):
        ray = Ray3f(Point3f(*(o.T.copy())), Vector3f(*(d.T.copy())))
        hit = scene.ray_intersect_preliminary(ray)
        dr.eval(hit.t, hit.shape_index)
        t, index = np.array(hit.t), np.array(hit.shape_index)
        active &= np.isfinite(t)
        if not active.any():
            break
        odd[active, index[active]] ^= True
        there = o + d * np.where(active, t, 0)[:, None]
        o = there + d * RAY_EPSILON * (1 + np.abs(there).max(axis=1, keepdims=True))
    votes = odd.mean(axis=0)
    found = [Surrounding(s, float(v), eta_of(s)) for s, v in zip(shapes, votes, strict=True) if v > 0 and s.is_closed()]
    return sorted(found, key=lambda body: float(dr.prod(body.shape.bbox().extents())))


def index_around(
    scene: Scene, point: Sequence[float], priorities: Mapping[str, float] | None = None, rays: int = 64
) -> float:
    """The index of refraction at a point, relative to that outside of all bodies: the `ior` of a camera there.

    Where bodies overlap, as a liquid that reaches into the wall of its glass, the one with the highest priority fills
    the space (C. Schmidt and B. Budge, "Simple nested dielectrics in ray traced images", 2002).

    Args:
        scene: The scene.
        point: The point, in world space.
        priorities: Priorities by the ids of shapes, 0 for others; of bodies with the same the smallest counts. By
            default those of the scene, and of bodies with the same the first, as in images.
        rays: The number of rays.

    Raises:
        SceneError: The place is ambiguous: for some body more than a tenth of the rays, and fewer than nine, vote.
    """
    known = [body for body in surroundings(scene, point, rays) if body.eta is not None]
    for body in known:
        if 0.1 < body.votes < 0.9:
            raise SceneError(
                f"{body.shape.id()}: whether the point {tuple(point)} lies within is ambiguous: {body.votes:.0%} of "
                f"{rays} rays say so. The surface may be open, or the point lie on it"
            )
    around = [body for body in known if body.votes >= 0.9]
    if not around:
        return 1.0
    geometry = scene.geometry
    if priorities is None and isinstance(geometry, OverlappingGeometry):
        ranks = {id(geometry.contents.shapes[i]): rank for rank, i in enumerate(geometry.bodies)}
        first = max(around, key=lambda body: ranks.get(id(body.shape), -1))
    else:
        given = {} if priorities is None else priorities
        first = max(around, key=lambda body: given.get(body.shape.id(), 0.0))  # the first, thus smallest, of equals
    assert first.eta is not None
    return first.eta


def eta_of(shape: Any) -> float | None:
    """The relative index of a shape's BSDF; None if that refracts nothing."""
    bsdf = shape.bsdf()
    if bsdf is None or not has_flag(bsdf.flags(), BSDFFlags.Transmission) or has_flag(bsdf.flags(), BSDFFlags.Null):
        return None
    eta = getattr(bsdf, "eta", None)
    return float(eta.numpy()[0]) if isinstance(eta, Float) and dr.width(eta) == 1 else None

"""Hits of rays that carry gradients: where a moved ray meets the same surface."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import PreliminaryIntersection3f, Ray3f, SurfaceInteraction3f
from djpt.jit.types import Float, Point3f, Vector3f

__all__ = ["distance_on_plane", "distance_to", "is_attached", "make_ends"]


def is_attached(ray: Ray3f) -> bool:
    """Whether hits of the ray depend on anything that is being differentiated."""
    return bool(dr.grad_enabled(ray.o) or dr.grad_enabled(ray.d))


def distance_on_plane(ray: Ray3f, pi: PreliminaryIntersection3f, p: Point3f, n: Vector3f) -> Float:
    """The distance of a hit, differentiable with respect to the ray, from the hit's point and normal (both detached).

    A moved ray meets a surface where, to first order, it meets the tangent plane:

        t = <n, p - o> / <n, d>.
    """
    t = dr.dot(n, p - ray.o) * dr.rcp(dr.dot(n, ray.d))
    return with_derivative(pi, t)


def distance_to(ray: Ray3f, pi: PreliminaryIntersection3f, p: Point3f) -> Float:
    """The distance of a hit, differentiable with respect to the ray, if the point stays: norm(p - o) / norm(d)."""
    return with_derivative(pi, dr.norm(p - ray.o) * dr.rcp(dr.norm(ray.d)))


def with_derivative(pi: PreliminaryIntersection3f, t: Float) -> Float:
    """The distance that was found, with the derivative of `t` where something was hit."""
    found = dr.detach(pi.t)
    attached: Any = dr.replace_grad(found, t)  # type: ignore[func-returns-value]
    return dr.select(found < dr.inf, attached, found)


def make_ends(si: SurfaceInteraction3f) -> None:
    """Give each field of a surface point a node of its own in the graph of derivatives, from which nothing follows.

    uv, for example, is computed from the point, and after a traversal Dr.Jit keeps the derivatives of the graph's ends
    only: that of the point would be lost.
    """
    for name in ("t", "p", "n", "uv", "dp_du", "dp_dv", "wi"):
        si.__dict__[name] = si.__dict__[name] + 0
    frame = si.sh_frame
    si.sh_frame = Frame3f(frame.s + 0, frame.t + 0, frame.n + 0)

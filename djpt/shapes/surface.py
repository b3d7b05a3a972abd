"""The geometry at a point, as shading needs it."""

from __future__ import annotations

from dataclasses import dataclass

from djpt.core.frame import Frame3f
from djpt.jit.types import Point2f, Point3f, Vector3f

__all__ = ["Surface"]


@dataclass
class Surface:
    """A point on a surface."""

    p: Point3f
    n: Vector3f
    """Geometric normal."""
    sh_frame: Frame3f
    uv: Point2f
    dp_du: Vector3f
    dp_dv: Vector3f
    prim_uv: Point2f
    """Barycentric weights of a triangle's second and third corner; 0 on other shapes."""

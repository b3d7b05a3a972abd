"""One light, the point that it is sampled for, and a bitmap with bright and dark texels for it."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import DirectionSample3f, SurfaceInteraction3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float, Point2f, Point3f, TensorXf, Vector3f

__all__ = ["TEXELS", "TURNED", "bitmap", "lit", "local_frame", "looked_at", "reference"]


def local_frame(wi: Any, width: int = 1) -> SurfaceInteraction3f:
    """A surface point in its own frame, seen from `wi`."""
    z = Vector3f(0, 0, 1)
    return SurfaceInteraction3f(
        t=dr.full(Float, 1, width),
        p=Point3f(0),
        n=z,
        sh_frame=Frame3f(Vector3f(1, 0, 0), Vector3f(0, 1, 0), z),
        uv=Point2f(0.3, 0.6),
        dp_du=Vector3f(1, 0, 0),
        dp_dv=Vector3f(0, 1, 0),
        wi=dr.normalize(Vector3f(*wi)),
    )


def lit(**emitters: Any) -> Any:
    """A scene with one emitter, and a speck far away."""
    speck = {"type": "sphere", "center": [5e3, -5e3, -5e3], "radius": 1e-3}
    return djpt.load_dict({"type": "scene", **emitters, "speck": speck})


def reference() -> SurfaceInteraction3f:
    """The point that light is sampled for: the origin, without a surface to step off."""
    return local_frame((0, 0, 1))


def looked_at(scene: Any, d: Any) -> tuple[Any, Any, Any]:
    """What a ray from the origin meets, as if sampled; the radiance of its emitter; whether there is an emitter."""
    ray = djpt.Ray3f(Point3f(0), d, maxt=Float(dr.inf))
    si = scene.ray_intersect(ray)
    ds = DirectionSample3f.between(Point3f(0), ray, si)
    emitter = si.emitter(scene)
    return ds, emitter.eval(si), emitter.is_valid()


rng = np.random.default_rng(5)
TEXELS = (6 * rng.random((5, 7, 3)) ** 3).astype(np.float32)
TEXELS[2, 3] = 0

TURNED = T().translate([0.3, 1, 0]).rotate([0, 0, 1], 40).scale([1.5, -1, 1])


def bitmap(texels: np.ndarray = TEXELS, **keys: Any) -> dict[str, Any]:
    return {"type": "bitmap", "data": TensorXf(texels), "raw": True, **keys}

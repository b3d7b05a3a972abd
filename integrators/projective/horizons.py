"""Light at the horizon of triangles, which smooth meshes cut off.

Where normals are interpolated, a surface may face light that its triangle doesn't: the triangle stands in its own way.
With h the cosine between the light and the normal of the triangle, and A the light for h > 0, A [h > 0] arrives there,
and as the triangle turns, its derivative has the term A delta(h) dh. It is an integral over the same paths as A itself,
if a kernel k(h) on the bright side stands for delta: one whose mean is 0, so that the error is of second order in its
width. Light is therefore multiplied by 1 + k(h) (h - h_0), with h_0 the value of h without gradients.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.lookup import is_one_of
from djpt.core.records import SHADOW_EPSILON, SurfaceInteraction3f
from djpt.jit.types import Bool, Float, Vector3f
from djpt.shapes.silhouettes.seams import turns_dark

__all__ = ["horizon_weight"]

WINDOW = 0.05
"""The width of the kernel: the largest cosine at which light counts."""

BELOW = 1e-3
"""The cosine, below the horizon, of rays that ask whether the triangle stands in the way."""


def horizon_weight(scene: Any, si: SurfaceInteraction3f, d: Vector3f, distance: Float, active: Bool) -> Float:
    """1, with the relative derivative of light that arrives along `d` by the horizon of the triangle at `si`.

    Args:
        scene: the scene.
        si: the surface points, attached.
        d: the directions to the light, attached.
        distance: how far away it is, at most infinite.
        active: the lanes that matter.
    """
    smooth = [number for number, shape in scene.moving() if turns_dark(shape)]
    if not smooth:
        return Float(1)
    still = dr.detach(si)
    n = dr.mulsign(si.n, still.wi.z)
    h = dr.dot(n, d)
    here = dr.detach(h)
    near = active & is_one_of(still.shape_index, smooth) & (here > 0) & (here < WINDOW)
    ray = still.spawn_ray(dr.normalize(dr.detach(d - n * (h + BELOW))))
    ray.maxt = dr.detach(distance) * (1 - SHADOW_EPSILON)
    near &= scene.ray_test(ray, near)
    kernel = dr.fma(here, -6 / WINDOW**2, 4 / WINDOW)
    return 1 + dr.select(near, kernel * (h - here), 0)

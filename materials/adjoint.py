"""The adjoint of scattering at surfaces with shading normals."""

from __future__ import annotations

import drjit as dr

from djpt.records import SurfaceInteraction3f
from djpt.types import Float, Vector3f

__all__ = ["side_correction"]


def side_correction(si: SurfaceInteraction3f, arriving: Vector3f, leaving: Vector3f, wo: Vector3f) -> Float:
    """What f abs(cos) is multiplied by where light, and not importance, is scattered from `arriving` to `leaving`.

    cos(wi, ns) cos(wo, ng) / (cos(wi, ng) cos(wo, ns)), ns the shading normal, ng the geometric one; 0 where the two
    disagree on a direction's side. Directions are in world space, `wo` is `leaving` in the shading frame. 1 without
    shading normals.

    E. Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, 5.3.2.
    """
    wi_geometric, wo_geometric = -dr.dot(si.n, arriving), dr.dot(si.n, leaving)
    ok = (wi_geometric * si.wi.z > 0) & (wo_geometric * wo.z > 0)
    ratio = dr.abs(si.wi.z * wo_geometric * dr.rcp(dr.select(ok, wi_geometric * wo.z, 1)))
    return dr.select(ok, ratio, 0)

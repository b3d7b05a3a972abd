"""The adjoint of scattering: light that travels from lights, where BSDFs are written for paths from the camera."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, TransportMode, has_flag
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDF

__all__ = ["eval_pdf_light", "sample_light"]

FROM_LIGHT, FROM_CAMERA = BSDFContext(TransportMode.Importance), BSDFContext()


def eval_pdf_light(
    bsdf: BSDF, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
) -> tuple[Color3f, Float, Float]:
    """The factor of flux that arrives from `si.wi`, per solid angle of `wo`, and the densities of both ways.

    The value is f(wo, wi) abs(cos(wi, ns) cos(wo, ng) / cos(wi, ng)): that of a path from the camera, which comes from
    `wo` and goes on to `wi`, with the cosines that light sees. ns is the shading normal, ng the geometric one; it is 0
    where the two disagree on a direction's side. The densities are that of `sample_light` at `wo`, and that with which
    a path from the camera, coming from `wo`, goes on to `si.wi`.

    E. Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, 5.3.2.
    """
    value, back = bsdf.eval_pdf(FROM_CAMERA, si.replaced(wi=wo), si.wi, active)
    return value * dr.abs(geometric_ratio(si, wo)), bsdf.pdf(FROM_LIGHT, si, wo, active), back


def sample_light(
    bsdf: BSDF, si: SurfaceInteraction3f, sample1: Float, sample2: Point2f, active: Bool | bool = True
) -> tuple[BSDFSample3f, Color3f]:
    """Sample where light that arrives from `si.wi` goes, with the value of `eval_pdf_light` over the density."""
    bs, weight = bsdf.sample(FROM_LIGHT, si, sample1, sample2, active)
    ratio = geometric_ratio(si, bs.wo)
    corrected = weight * dr.select(ratio != 0, dr.abs(si.wi.z * ratio * dr.rcp(bs.wo.z)), 0)
    if bsdf.is_symmetric:
        return bs, corrected
    value, _, _ = eval_pdf_light(bsdf, si, bs.wo, active)
    exact = dr.select(bs.pdf > 0, value * dr.rcp(bs.pdf), 0)
    return bs, dr.select(has_flag(bs.sampled_type, BSDFFlags.Delta), corrected, exact)


def geometric_ratio(si: SurfaceInteraction3f, wo: Vector3f) -> Float:
    """cos(wo, ng) / cos(wi, ng); 0 where shading and geometric normal disagree on the side of `si.wi` or `wo`."""
    n = si.sh_frame.to_local(si.n)
    wi_cos, wo_cos = dr.dot(n, si.wi), dr.dot(n, wo)
    ok = (wi_cos * si.wi.z > 0) & (wo_cos * wo.z > 0)
    return dr.select(ok, wo_cos * dr.rcp(dr.select(ok, wi_cos, 1)), 0)

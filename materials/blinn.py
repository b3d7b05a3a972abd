"""Blinn's highlight."""

from __future__ import annotations

import math

import drjit as dr

from djpt.description.registry import register_bsdf
from djpt.jit.types import Float, Point2f, Vector3f
from djpt.materials.phong import Phong, cosine_power, power

__all__ = ["Blinn"]


class Blinn(Phong):
    """f = k_d / pi + k_s N cos^n theta_h, on the side of the normal only; black from behind.

    theta_h is the angle between the normal and the half vector of `wi` and `wo`. The factor
    N = (n + 2) (n + 4) / (8 pi (n + 2^(-n/2))) makes the highlight reflect the fraction k_s of light that falls
    straight onto the surface (F. Giesen, "Phong Normalization Factor Derivation", 2009), and less of the rest.

    Parameters: those of `Phong`; a highlight as wide as Phong's takes about four times the exponent.

    Half vectors are sampled with the density (n + 1) / (2 pi) cos^n theta_h; the density of `wo` is this over
    4 wi . h.

    J. Blinn, "Models of Light Reflection for Computer Synthesized Pictures", SIGGRAPH 1977; as the shading of
    T. Whitted, "An Improved Illumination Model for Shaded Display", 1980.
    """

    in_any_frame = True
    symmetric = True

    def highlight(self, wi: Vector3f, wo: Vector3f, n: Float) -> tuple[Float, Float]:
        h = wi + wo
        length = dr.norm(dr.select(dr.squared_norm(h) > 0, h, Vector3f(0, 0, 1)))
        lobe = power(h.z * dr.rcp(length), n)
        norm = (n + 2) * (n + 4) * dr.rcp((8 * math.pi) * (n + dr.exp2(-0.5 * n)))
        # The length of wi + wo is 2 wi . h.
        return lobe * norm, lobe * (n + 1) * dr.rcp((4 * math.pi) * length)

    def sample_highlight(self, wi: Vector3f, n: Float, sample: Point2f) -> Vector3f:
        h = cosine_power(n, sample)
        return 2 * dr.dot(wi, h) * h - wi


register_bsdf("blinn", Blinn)

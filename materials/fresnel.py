"""Reflection and refraction at a smooth interface: Snell's law, Fresnel's equations and Schlick's approximation.

Cosines are signed: positive on the side of the normal. `eta` is the index behind the interface (where the
cosine is negative) over the index in front of it, so `eta_it` = `eta` for light from the front and 1 / `eta`
from behind. All functions take Dr.Jit arrays of any float type.
"""

from __future__ import annotations

from typing import TypeVar

import drjit as dr

from djpt.jit.types import Bool, Color3f, Float, Normal3f, Vector3f

__all__ = [
    "fresnel",
    "fresnel_conductor",
    "fresnel_diffuse_reflectance",
    "fresnel_schlick",
    "reflect",
    "refract",
    "schlick",
]

Value = TypeVar("Value", Float, Color3f)


def _sqrt(x: Value) -> Value:
    """The square root; 0, with derivative 0, where x is not positive."""
    return dr.sqrt(dr.select(x > 0, x, 0))


def _snell(cos_theta_i: Float, eta: Float) -> tuple[Float, Float, Float, Bool]:
    """(abs cos theta_t, eta_it, eta_ti, whether reflection is total), by sin theta_i = eta_it sin theta_t."""
    outside = cos_theta_i >= 0
    inv_eta = dr.rcp(eta)
    eta_it = dr.select(outside, eta, inv_eta)
    eta_ti = dr.select(outside, inv_eta, eta)
    squared = dr.fma(dr.fma(cos_theta_i, cos_theta_i, -1), dr.square(eta_ti), 1)
    return _sqrt(squared), eta_it, eta_ti, squared <= 0


def fresnel(cos_theta_i: Float, eta: Float) -> tuple[Float, Float, Float, Float]:
    """The unpolarised reflectance of an interface of two dielectrics, and the transmitted ray's angle.

    With the amplitudes a_s = (cos i - eta_it cos t) / (cos i + eta_it cos t) and
    a_p = (eta_it cos i - cos t) / (eta_it cos i + cos t), it is (a_s^2 + a_p^2) / 2 (E. Hecht, "Optics", 4th ed.,
    section 4.6.2).

    Args:
        cos_theta_i: between the normal and the direction the light comes from.
        eta: relative index of refraction, > 0.

    Returns:
        (reflectance, cos_theta_t, eta_it, eta_ti). The reflectance is 1 at total internal reflection (and
        `cos_theta_t` 0) and 0 at `eta` = 1. `cos_theta_t` has the opposite sign of `cos_theta_i`.
    """
    cos_t, eta_it, eta_ti, total = _snell(cos_theta_i, eta)
    cos_i = dr.abs(cos_theta_i)
    s, p = eta_it * cos_t, eta_it * cos_i
    d_s, d_p = cos_i + s, p + cos_t
    # Both quotients over one denominator; where it may vanish the result is known: total reflection, or no interface.
    # Rounding must not lift the rest above 1, or what is transmitted would be negative.
    sum_of_squares = dr.square((cos_i - s) * d_p) + dr.square((p - cos_t) * d_s)
    reflectance = 0.5 * sum_of_squares * dr.square(dr.rcp(d_s * d_p))
    reflectance = dr.select(~total & (reflectance < 1), reflectance, 1)
    reflectance = dr.select(eta == 1, 0, reflectance)
    return reflectance, dr.mulsign(-cos_t, cos_theta_i), eta_it, eta_ti


def schlick(cos_theta: Float, r0: Value) -> Value:
    """The reflectance R0 + (1 - R0) (1 - cos theta)^5 for cos theta in [0, 1].

    C. Schlick, "An Inexpensive BRDF Model for Physically-based Rendering", Computer Graphics Forum 13(3), 1994.
    """
    x = dr.select(cos_theta < 1, 1 - cos_theta, 0)
    x5 = dr.square(dr.square(x)) * x
    return dr.fma(1 - r0, x5, r0)


def fresnel_schlick(cos_theta_i: Float, eta: Float) -> tuple[Float, Float, Float, Float]:
    """The reflectance of a dielectric interface by Schlick's approximation, and the transmitted ray's angle.

    Arguments and results are those of `fresnel`. `schlick` is given R0 = ((eta - 1) / (eta + 1))^2 and the cosine of
    the larger of the two angles, which lies in the thinner medium: from the denser side it is the transmitted angle,
    so that the reflectance reaches 1 at the critical angle. It is exactly 0 at `eta` = 1.
    """
    cos_t, eta_it, eta_ti, total = _snell(cos_theta_i, eta)
    r0 = dr.square((eta - 1) * dr.rcp(eta + 1))
    reflectance = schlick(dr.select(eta_it > 1, dr.abs(cos_theta_i), cos_t), r0)
    reflectance = dr.select(total, 1, reflectance)
    reflectance = dr.select(eta == 1, 0, reflectance)
    return reflectance, dr.mulsign(-cos_t, cos_theta_i), eta_it, eta_ti


def fresnel_conductor(cos_theta_i: Float, eta: Value, k: Value) -> Value:
    """The unpolarised reflectance of an interface with a conductor of relative index eta + i k, eta and k >= 0.

    With a + i b = sqrt((eta + i k)^2 - sin^2 i) and s = a^2 + b^2, it is (r_s + r_p) / 2, where
    r_s = (s - 2 a cos i + cos^2 i) / (s + 2 a cos i + cos^2 i) and
    r_p = r_s (s cos^2 i - 2 a cos i sin^2 i + sin^4 i) / (s cos^2 i + 2 a cos i sin^2 i + sin^4 i)
    (K. D. Moeller, "Optics", 1988). For `cos_theta_i` >= 0, light from outside.

    At k = 0 the slope by k is 0 where sin i < eta, and negative beyond, where reflection is total. Towards the critical
    angle it grows like 1 / sqrt(sin^2 i - eta^2), whose mean over directions is finite.
    """
    cos_2 = dr.square(cos_theta_i)
    sin_2 = 1 - cos_2
    product = eta * k
    difference = (eta - k) * (eta + k) - sin_2  # a^2 - b^2, while a b = eta k
    s = _sqrt(dr.square(difference) + 4 * dr.square(product))
    # The larger of a and b is a sum, the smaller one follows from the product: no cancellation, and the derivative
    # by eta is right at eta = 0, too. a = v / u, and u is multiplied out: (r_s + r_p) / 2 is a single quotient.
    larger = _sqrt(0.5 * (s + dr.abs(difference)))
    u = dr.select(difference > 0, 1, larger)
    v = 2 * cos_theta_i * dr.select(difference > 0, larger, product)
    t_s = (s + cos_2) * u
    t_p = (s * cos_2 + dr.square(sin_2)) * u
    denominator = (t_s + v) * dr.fma(v, sin_2, t_p)
    # Where nothing is reflected the difference is rounding alone.
    least = dr.select(t_s > v, t_s - v, 0)
    return dr.select(denominator > 1e-30, least * t_p * dr.rcp(denominator), 1)


def fresnel_diffuse_reflectance(eta: Float) -> Float:
    """The reflectance for diffuse light from the front, that is the mean of `fresnel` weighted by 2 cos theta_i.

    Polynomial fits. eta < 1: W. G. Egan and T. W. Hilgeman, "Optical Properties of Inhomogeneous Materials", 1979
    (0.6 % off down to 1 / eta = 2; beyond 3.8 the bound 1 - 0.08 eta^2 takes its place, since it
    exceeds 1). eta >= 1: E. d'Eon and G. Irving, "A Quantized-Diffusion Model for Rendering
    Translucent Materials", SIGGRAPH 2011 (0.2 % off up to eta = 10).
    """
    x = dr.rcp(eta)
    below = 0.0636 * x + 0.6681 + eta * (0.7099 - 1.4399 * eta)
    # What enters is eta^2 times what leaves, of which at least 0.08 does.
    below = dr.minimum(below, 1 - dr.maximum(0.08 * dr.square(eta), 1e-6))
    above = 4.98554 - 1.36881 * x
    for coefficient in (-7.80989, 6.75335, -3.4793, 0.919317):
        above = above * x + coefficient
    return dr.select(eta < 1, below, above)


def reflect(wi: Vector3f, m: Normal3f | None = None) -> Vector3f:
    """The mirror image of `wi` about the unit normal `m` (None: +z)."""
    if m is None:
        return Vector3f(-wi.x, -wi.y, wi.z)
    return dr.fma(m, 2 * dr.dot(wi, m), -wi)


def refract(wi: Vector3f, m: Normal3f | None, cos_theta_t: Float, eta_ti: Float) -> Vector3f:
    """The refracted direction, away from the surface; `fresnel` gives `cos_theta_t` and `eta_ti` for dot(wi, m)."""
    if m is None:
        return Vector3f(-eta_ti * wi.x, -eta_ti * wi.y, cos_theta_t)
    return dr.fma(m, dr.fma(dr.dot(wi, m), eta_ti, cos_theta_t), wi * -eta_ti)

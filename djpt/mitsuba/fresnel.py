"""Reflection and refraction at smooth interfaces, in all forms that scripts call them in.

The renderer's own functions are in `djpt.materials.fresnel`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.forms import forms
from djpt.description.properties import Properties
from djpt.errors import ArgumentError, near_miss
from djpt.jit.types import Float, Vector3f, backend, converting
from djpt.materials import fresnel as interface
from djpt.materials.ior import IOR

__all__ = [
    "fresnel",
    "fresnel_conductor",
    "fresnel_diffuse_reflectance",
    "fresnel_polarized",
    "lookup_ior",
    "reflect",
    "refract",
]

Complex2f = backend.Complex2f


@converting
def fresnel(cos_theta_i: Float, eta: Float) -> tuple[Float, Float, Float, Float]:
    """The unpolarised reflectance of an interface of two dielectrics: see `djpt.materials.fresnel.fresnel`.

    Args:
        cos_theta_i: between the normal and the direction the light comes from.
        eta: relative index of refraction, > 0: the one behind the interface over the one in front.

    Returns:
        (reflectance, cos_theta_t, eta_it, eta_ti).
    """
    return interface.fresnel(cos_theta_i, eta)


def fresnel_conductor(cos_theta_i: Any, eta: Any, k: Any = None) -> Any:
    """The unpolarised reflectance of a conductor, for light from outside.

    Args:
        cos_theta_i: between the normal and the direction the light comes from.
        eta: the relative index of refraction eta + i k: complex, or a pair. Its imaginary part may have either sign.
        k: if given, the imaginary part, and `eta` is the real one; both may be colours.
    """
    cos = cos_theta_i if dr.is_array_v(cos_theta_i) else Float(cos_theta_i)
    if k is not None:
        return interface.fresnel_conductor(cos, eta, k)
    index = eta if type(eta) is Complex2f else Complex2f(eta)
    return interface.fresnel_conductor(cos, dr.real(index), dr.abs(dr.imag(index)))


def fresnel_polarized(cos_theta_i: Any, eta: Any) -> tuple[Any, Any, Float, Any, Any]:
    """The amplitudes of waves that an interface reflects.

    By Snell's law with complex indices and Fresnel's equations, a_s = (cos i - eta_it cos t) / (cos i + eta_it cos t)
    and a_p = (eta_it cos i - cos t) / (eta_it cos i + cos t). Waves are exp(i (omega t - k x)), for which absorption is
    a negative imaginary part of the index (D. Clarke, "Stellar Polarimetry", 2010, appendix A).

    Args:
        cos_theta_i: between the normal and the direction the light comes from.
        eta: relative index of refraction, real or complex.

    Returns:
        (a_s, a_p, cos_theta_t, eta_it, eta_ti): amplitudes across and along the plane of incidence, complex; the
        cosine of the transmitted ray, 0 at total internal reflection; indices in the direction of travel, complex.
    """
    cos_i = Float(cos_theta_i)
    index = Complex2f(eta)
    index = Complex2f(dr.real(index), -dr.abs(dr.imag(index)))
    outside = cos_i >= 0
    inverse = dr.rcp(index)
    eta_it, eta_ti = dr.select(outside, index, inverse), dr.select(outside, inverse, index)

    cos_2 = 1 - dr.square(eta_ti) * dr.fma(-cos_i, cos_i, 1)
    cos_t = dr.sqrt(cos_2)
    # Of the two roots the one that decays.
    cos_t = Complex2f(dr.real(cos_t), -dr.abs(dr.imag(cos_t)))
    cos = dr.abs(cos_i)
    a_s = (cos - eta_it * cos_t) / (cos + eta_it * cos_t)
    a_p = (eta_it * cos - cos_t) / (eta_it * cos + cos_t)
    nothing = (dr.imag(index) == 0) & ((dr.real(index) == 0) | (dr.abs(dr.real(index)) == 1))
    a_s, a_p = (dr.select(nothing, Complex2f(0), a) for a in (a_s, a_p))
    transmitted = dr.select(dr.real(cos_2) >= 0, dr.mulsign(-dr.real(cos_t), cos_i), 0)
    return a_s, a_p, transmitted, eta_it, eta_ti


@converting
def fresnel_diffuse_reflectance(eta: Float) -> Float:
    """The reflectance for diffuse light from the front: see `djpt.materials.fresnel.fresnel_diffuse_reflectance`."""
    return interface.fresnel_diffuse_reflectance(eta)


def reflect(wi: Any, m: Any = None) -> Vector3f:
    """The mirror image of `wi` about the unit normal `m`, +z by default."""
    return interface.reflect(Vector3f(wi), None if m is None else Vector3f(m))


@forms("wi cos_theta_t eta_ti", "wi m cos_theta_t eta_ti")
def refract(*, wi: Any, m: Any = None, cos_theta_t: Any, eta_ti: Any) -> Vector3f:
    """The refracted direction, away from the surface with the unit normal `m`, +z by default.

    Args:
        wi: where the light comes from.
        m: the normal; it may be left out, as the second of three arguments.
        cos_theta_t: the cosine of the refracted direction, given by `fresnel`.
        eta_ti: the inverse relative index in the direction of travel, given by `fresnel`.
    """
    return interface.refract(Vector3f(wi), None if m is None else Vector3f(m), Float(cos_theta_t), Float(eta_ti))


def lookup_ior(properties: Properties, name: str, default: str | float) -> float:
    """The index of refraction under a key: a number, or the name of a medium, such as "bk7" or "water"."""
    value = properties.get(name, default)
    if not isinstance(value, str):
        return float(value)
    if value.lower() not in IOR:
        raise ArgumentError(f"lookup_ior(): unknown medium '{value}'{near_miss(value.lower(), IOR)}")
    return IOR[value.lower()]

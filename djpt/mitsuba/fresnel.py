"""Reflection and refraction at smooth and rough interfaces, in all forms that scripts call them in.

The renderer's own functions are in `djpt.materials.fresnel` and `djpt.materials.microfacet`.
"""

from __future__ import annotations

import enum
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.forms import forms
from djpt.description.properties import Properties
from djpt.errors import ArgumentError, near_miss
from djpt.jit.types import Float, Normal3f, Point2f, Vector2f, Vector3f, backend, converting
from djpt.materials import fresnel as interface
from djpt.materials import microfacet
from djpt.materials.ior import IOR

__all__ = [
    "MicrofacetDistribution",
    "MicrofacetType",
    "eval_reflectance",
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


# ---- microfacet normals ----------------------------------------------------------------------


class MicrofacetType(enum.IntEnum):
    """The distributions of normals."""

    Beckmann = 0
    """Gaussian slopes."""
    GGX = 1
    """Trowbridge and Reitz's, with longer tails."""


class MicrofacetDistribution:
    """A distribution of microfacet normals about +z: see `djpt.materials.microfacet.MicrofacetDistribution`.

    Args:
        type: `MicrofacetType.Beckmann` or `GGX`, or the name of one; or `Properties` with the keys `distribution`,
            `alpha` or `alpha_u` and `alpha_v`, `sample_visible`, and nothing else.
        alpha_u: roughness along x, raised to 1e-4 if it is smaller.
        alpha_v: roughness along y, that along x by default. Instead, `sample_visible` may stand here, or the roughness
            of an isotropic surface may be given as `alpha`.
        sample_visible: whether only the normals that `wi` sees are sampled.
    """

    def __init__(
        self,
        type: Any,
        alpha_u: Any = None,
        alpha_v: Any = None,
        sample_visible: bool | None = None,
        *,
        alpha: Any = None,
    ) -> None:
        if isinstance(type, Properties):
            type, alpha_u, alpha_v, sample_visible = from_properties(type)
        if isinstance(alpha_v, bool):
            alpha_v, sample_visible = None, alpha_v
        if (alpha_u is None) == (alpha is None):
            raise ArgumentError("MicrofacetDistribution(): one roughness is needed, 'alpha' or 'alpha_u'")
        self._type = as_type(type)
        along = Float(alpha if alpha_u is None else alpha_u)
        self._set(along, along if alpha_v is None else Float(alpha_v), sample_visible is not False)

    def _set(self, alpha_u: Float, alpha_v: Float, sample_visible: bool) -> None:
        # Of two equal numbers Dr.Jit makes one variable.
        if (alpha_u.index, alpha_u.index_ad) == (alpha_v.index, alpha_v.index_ad):
            alpha_v = alpha_u
        name = self._type.name.lower()
        self._normals = microfacet.MicrofacetDistribution(name, alpha_u, alpha_v, sample_visible)

    def type(self) -> MicrofacetType:
        """The kind of distribution."""
        return self._type

    def alpha(self) -> Float:
        """The roughness, of anisotropic surfaces that along x."""
        return self._normals.alpha_u

    def alpha_u(self) -> Float:
        """The roughness along x."""
        return self._normals.alpha_u

    def alpha_v(self) -> Float:
        """The roughness along y."""
        return self._normals.alpha_v

    def sample_visible(self) -> bool:
        """Whether only visible normals are sampled."""
        return self._normals.sample_visible

    def is_isotropic(self) -> bool:
        """Whether both roughnesses are the same variable."""
        return self._normals.isotropic

    def is_anisotropic(self) -> bool:
        """Whether the roughnesses differ."""
        return not self._normals.isotropic

    def scale_alpha(self, value: Any) -> None:
        """Multiply both roughnesses."""
        factor = Float(value)
        along = self.alpha_u() * factor
        self._set(along, along if self.is_isotropic() else self.alpha_v() * factor, self.sample_visible())

    @converting
    def eval(self, m: Vector3f) -> Float:
        """The density D(m), per unit solid angle."""
        return self._normals.eval(m)

    @converting
    def pdf(self, wi: Vector3f, m: Vector3f) -> Float:
        """The density of `sample` at `m`."""
        return self._normals.pdf(wi, m)

    @converting
    def smith_g1(self, v: Vector3f, m: Vector3f) -> Float:
        """Smith's shadowing for one direction."""
        return self._normals.smith_g1(v, m)

    @converting
    def G(self, wi: Vector3f, wo: Vector3f, m: Vector3f) -> Float:
        """The shadowing for two directions, separable."""
        return self._normals.G(wi, wo, m)

    @converting
    def sample(self, wi: Vector3f, sample: Point2f) -> tuple[Normal3f, Float]:
        """A normal and its density."""
        return self._normals.sample(wi, sample)

    @converting
    def sample_visible_11(self, cos_theta_i: Float, sample: Point2f) -> Vector2f:
        """The slopes of a normal of roughness 1 that is visible from a direction in the plane of x and z."""
        n = self._normals.sample_11(cos_theta_i, sample)
        return Vector2f(-n.x / n.z, -n.y / n.z)

    def __repr__(self) -> str:
        return (
            f"MicrofacetDistribution[\n  type = {self._type.name.lower()},\n  alpha_u = {self.alpha_u()},\n"
            f"  alpha_v = {self.alpha_v()},\n  sample_visible = {int(self.sample_visible())}\n]"
        )


def as_type(type: Any) -> MicrofacetType:
    """The kind of distribution by its number or name, in any case."""
    if isinstance(type, str):
        by_name = {kind.name.lower(): kind for kind in MicrofacetType}
        if type.lower() in by_name:
            return by_name[type.lower()]
        raise ArgumentError(f"MicrofacetDistribution(): unknown type '{type}'{near_miss(type.lower(), by_name)}")
    return MicrofacetType(int(type))


def from_properties(props: Properties) -> tuple[str, float, float | None, bool]:
    """Type, both roughnesses and whether visible normals are sampled, as rough materials take them from a scene."""
    name = microfacet.distribution_name(props)
    visible = props.boolean("sample_visible", True)
    if "alpha_u" in props or "alpha_v" in props:
        if "alpha" in props:
            raise props.error("alpha", "can't be combined with 'alpha_u' and 'alpha_v'")
        return name, props.float("alpha_u"), props.float("alpha_v"), visible
    return name, props.float("alpha", 0.1), None, visible


@converting
def eval_reflectance(type: Any, alpha_u: Any, alpha_v: Any, wi: Vector3f, eta: float) -> Float:
    """The share of light from `wi` that a rough dielectric surface reflects, by quadrature over visible normals.

    The integral of G1(wo, m) F(dot(wi, m)) over the square that normals are sampled from, by a Gauss rule with 32 x 32
    nodes, or 128 x 128 from the denser side (`eta` <= 1), where reflection becomes total at an angle.
    """
    distribution = MicrofacetDistribution(type, alpha_u, alpha_v)
    nodes, weights = np.polynomial.legendre.leggauss(32 if eta > 1 else 128)
    total = dr.zeros(Float, dr.width(wi))
    x, y = (Float((grid.ravel() + 1) / 2) for grid in np.meshgrid(nodes, nodes))
    weight = Float(np.outer(weights, weights).ravel() / 4)
    # One lane per node and direction.
    count, lanes = len(x), dr.width(wi)
    node = dr.repeat(Point2f(x, y), lanes)
    direction = dr.tile(wi, count)
    m, _ = distribution.sample(direction, node)
    wo = interface.reflect(direction, m)
    reflected = interface.fresnel(dr.dot(direction, m), Float(eta))[0] * distribution.smith_g1(wo, m)
    reflected = dr.select((wo.z > 0) & (direction.z > 0), reflected, 0) * dr.repeat(weight, lanes)
    dr.scatter_add(total, reflected, dr.tile(dr.arange(dr.uint32_array_t(Float), lanes), count))
    return total

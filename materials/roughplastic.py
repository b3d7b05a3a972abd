"""Rough plastic: a diffuse base under a clear coat with a rough surface."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import BSDFContext, BSDFFlags, SurfaceInteraction3f
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_bsdf
from djpt.dispatch.tables import entry_at
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float, opaque
from djpt.jit.types import Bool, Color3f, Float, Point2f, TensorXf, UInt32, Vector3f
from djpt.materials.base import BSDFAtPoint, SharedWorkBSDF
from djpt.materials.dielectric import optional_texture, tint
from djpt.materials.fresnel import fresnel, reflect, refract
from djpt.materials.ior import ETA, ior
from djpt.materials.microfacet import MIN_ALPHA, MicrofacetDistribution, RoughCoatAtPoint, distribution_name

__all__ = ["RoughPlastic"]

INV_PI = 1 / math.pi

KNOTS = 64
"""Angles at which the coat's transmittance is tabulated, by equal steps of the cosine."""


class RoughPlastic(SharedWorkBSDF):
    """A rough dielectric's reflection over a diffuse base; black from behind.

    With F, D, G and m as for `RoughConductor`, but the F of a dielectric:

        f = F D G / (4 cos theta_i cos theta_o) + T(theta_i) T(theta_o) / (pi eta^2) * rho / (1 - rho' R).

    T is the fraction of light that a rough interface lets through, R what it reflects of diffuse light from
    within, rho' = 1, which keeps the colour of the base, or rho (`nonlinear`). T and R are integrals over all
    microfacets: they are tabulated when alpha or eta change, with their derivatives if those are wanted.

    Parameters:
        diffuse_reflectance: rho (texture in [0, 1], default 0.5).
        nonlinear: see above (default false).
        int_ior, ext_ior: index of refraction of the coat and around it (> 0, or a name of `djpt.materials.ior.IOR`;
            defaults `polypropylene`, `air`), which must differ. As a parameter their quotient, `eta`.
        distribution: of the microfacets, `beckmann` (default) or `ggx`.
        alpha: roughness in [0, 1] (default 0.1; at least 1e-4 counts); a number, not a texture.
        sample_visible: sample only microfacets that are seen (default true).
        specular_reflectance: a factor on the coat's reflection (texture in [0, 1]; default: none), which real coats
            don't have.
    """

    in_any_frame = True
    symmetric = True
    values: ClassVar[Mapping[str, ParamFlags]] = {
        "alpha": ParamFlags.Differentiable | ParamFlags.Discontinuous,
        "eta": ParamFlags.Differentiable | ParamFlags.Discontinuous,
    }
    allowed: ClassVar[Mapping[str, Allowed]] = {**ETA, "alpha": Allowed(0.0, 1.0)}
    tables: ClassVar[Mapping[str, ParamFlags]] = {
        "coat": ParamFlags.NonDifferentiable,
        "coat_by_alpha": ParamFlags.NonDifferentiable,
        "coat_by_eta": ParamFlags.NonDifferentiable,
    }
    children = ("diffuse_reflectance", "specular_reflectance")
    statics: ClassVar[Sequence[str]] = ("distribution", "sample_visible", "nonlinear")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        int_ior, ext_ior = ior(props, "int_ior", "polypropylene"), ior(props, "ext_ior", "air")
        if int_ior == ext_ior:
            raise props.error("int_ior", f"must differ from 'ext_ior', found {int_ior:.9g} for both: no coat")
        self.eta = as_float(int_ior / ext_ior)
        self.diffuse_reflectance = props.texture("diffuse_reflectance", 0.5, low=0.0, high=1.0)
        self.specular_reflectance = optional_texture(props, "specular_reflectance")
        self.nonlinear = props.boolean("nonlinear", False)
        self.distribution = distribution_name(props)
        self.sample_visible = props.boolean("sample_visible", True)
        self.alpha = as_float(props.float("alpha", 0.1, low=0.0, high=1.0))
        self.parameters_changed(["alpha", "eta"])

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("diffuse_reflectance", self.diffuse_reflectance)
        for name, flags in self.values.items():
            callback.put(name, getattr(self, name), flags)
        if self.specular_reflectance is not None:
            callback.put("specular_reflectance", self.specular_reflectance)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        if not {"alpha", "eta"} & set(keys):
            return
        alpha, eta = opaque(self.alpha), opaque(self.eta)
        # In kernels, a `Table` stands in the place of each tensor.
        self.coat: Any = coat(self.distribution, alpha, eta)
        # Differences: reflection has kinks, at total reflection, which derivatives of a quadrature miss.
        wide, far = opaque(0.05 * dr.maximum(alpha, MIN_ALPHA)), opaque(0.01 * eta)
        self.coat_by_alpha: Any = self._change((alpha + wide, eta), (alpha - wide, eta), wide, self.alpha)
        self.coat_by_eta: Any = self._change((alpha, eta + far), (alpha, eta - far), far, self.eta)
        # Now, so that no rendering's kernel contains this work.
        dr.eval(self.coat, self.coat_by_alpha, self.coat_by_eta)

    def _change(self, after: tuple[Float, Float], before: tuple[Float, Float], step: Float, wanted: Float) -> TensorXf:
        """The change of `coat` per unit of the parameter `wanted`; zeros, which aren't read, if it has no gradients."""
        if not dr.grad_enabled(wanted):
            return TensorXf(dr.zeros(Float, 2 * KNOTS), (1, KNOTS, 2))
        change = coat(self.distribution, *after).array - coat(self.distribution, *before).array
        return TensorXf(change * dr.rcp(2 * step), (1, KNOTS, 2))

    def components(self) -> tuple[int, ...]:
        coat, base = BSDFFlags.GlossyReflection, BSDFFlags.DiffuseReflection
        return int(coat | BSDFFlags.FrontSide), int(base | BSDFFlags.FrontSide)

    def coat_at(self, index: UInt32, active: Bool | bool) -> Point2f:
        """An entry of the table, attached to alpha and eta."""
        entry = entry_at(self.coat, index, active)
        if dr.grad_enabled(self.alpha):
            entry = dr.fma(entry_at(self.coat_by_alpha, index, active), self.alpha - dr.detach(self.alpha), entry)
        if dr.grad_enabled(self.eta):
            entry = dr.fma(entry_at(self.coat_by_eta, index, active), self.eta - dr.detach(self.eta), entry)
        return entry

    def transmittance_of_coat(self, cos: Float, active: Bool | bool) -> Float:
        """The coat's transmittance T, interpolated linearly between the knots."""
        x = dr.select(cos > 0, cos, 0) * (KNOTS - 1)
        index = UInt32(x)
        index = dr.select(index < KNOTS - 2, index, KNOTS - 2)
        ends = self.coat_at(index, active)
        return dr.lerp(ends.x, ends.y, x - Float(index))

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return RoughPlasticAtPoint(self, si, active, *self.asked(ctx))

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.diffuse_reflectance.eval(si, active)


class RoughPlasticAtPoint(RoughCoatAtPoint):
    """A `RoughPlastic` at one point, seen from `wi`: the work that evaluation and sampling share."""

    def __init__(
        self,
        bsdf: RoughPlastic,
        si: SurfaceInteraction3f,
        active: Bool | bool,
        shines: bool = True,
        scatters: bool = True,
    ) -> None:
        """`shines` and `scatters`: whether each lobe is asked for."""
        self.shines, self.scatters = shines, scatters
        self.bsdf, self.wi, self.active = bsdf, si.wi, active
        self.surface = MicrofacetDistribution(bsdf.distribution, bsdf.alpha, bsdf.alpha, bsdf.sample_visible)
        self.g1_i = self.surface.smith_g1_over_cos(si.wi)
        self.tint = tint(bsdf.specular_reflectance, si, active)
        through = bsdf.transmittance_of_coat(si.wi.z, active)
        trapped = bsdf.coat_at(UInt32(KNOTS - 1), active).x
        base = bsdf.diffuse_reflectance.eval(si, active)
        returned = dr.rcp(1 - base * trapped) if bsdf.nonlinear else dr.rcp(1 - trapped)
        self.base = base * (returned * dr.square(dr.rcp(bsdf.eta)) * through)
        """The base's f cos theta_o, without the factor T(theta_o) cos theta_o / pi."""
        # Both lobes are drawn by how much they reflect on average.
        diffuse = bsdf.diffuse_reflectance.mean()
        specular = 1 if bsdf.specular_reflectance is None else bsdf.specular_reflectance.mean()
        lobe_s, lobe_d = (1 - through) * specular, through * diffuse
        total = lobe_s + lobe_d
        self.p_specular = dr.detach(lobe_s * dr.rcp(dr.select(total > 0, total, 1)))
        if not (shines and scatters):
            self.p_specular = Float(shines)

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        ok, cos, visible, pdf = self.facets(wo)
        glossy = fresnel(cos, self.bsdf.eta)[0] * visible * self.surface.smith_g1_over_cos(wo) * wo.z
        cosine = wo.z * INV_PI
        base = self.base * (self.bsdf.transmittance_of_coat(wo.z, self.active) * cosine)
        value = self.tint * glossy + base if self.shines and self.scatters else self.tint * glossy
        if not self.shines:
            value = base
        pdf = dr.lerp(cosine, pdf, self.p_specular)
        return dr.select(ok, value, 0), dr.select(ok, pdf, 0)


# ---- the coat as a whole --------------------------------------------------------------


def coat(distribution: str, alpha: Float, eta: Float) -> TensorXf:
    """The table of a rough interface, (1, KNOTS, 2).

    Entries 0 .. KNOTS - 2 hold the transmittance T at the ends of an interval of cos theta, and the last one the
    diffuse reflectance R from within: 2 int r(mu) mu dmu.
    """
    surface = MicrofacetDistribution(distribution, alpha, alpha)
    through = integrals(surface, eta, transmitted=True)
    mu = knots()
    trapped = dr.sum(integrals(surface, dr.rcp(eta), transmitted=False) * mu) * (2 / KNOTS)
    index = dr.arange(UInt32, 2 * KNOTS)
    knot = index // 2 + index % 2
    table = dr.select(index < 2 * KNOTS - 2, dr.gather(Float, through, knot, knot < KNOTS), trapped)
    return TensorXf(table, (1, KNOTS, 2))


def knots() -> Float:
    """The tabulated cosines; the first one is just above 0."""
    mu = dr.arange(Float, KNOTS) * (1 / (KNOTS - 1))
    return dr.select(mu > 1e-6, mu, 1e-6)


def integrals(surface: MicrofacetDistribution, eta: Float, transmitted: bool) -> Float:
    """The fraction of light that a rough interface reflects or transmits, at each knot: (KNOTS,).

    By quadrature over the sample space of the microfacets: visible normals have the density D_wi(m), so that the
    integrand is G1(wo, m) times F or 1 - F.
    """
    # As many nodes as Mitsuba takes, whose values these are to be: total reflection needs more.
    denser = dr.detach(eta)[0] > 1 if not recording() else transmitted
    count = 32 if denser else 128
    x, w = quadrature(count)
    nodes, weights = Float((x + 1) / 2), Float(w / 2)
    lane = dr.arange(UInt32, KNOTS * count**2)
    i, j, knot = lane % count, (lane // count) % count, lane // count**2
    mu = dr.gather(Float, knots(), knot)
    wi = Vector3f(dr.sqrt(1 - dr.square(mu)), 0, mu)
    m = surface.sample_normal(wi, Point2f(dr.gather(Float, nodes, i), dr.gather(Float, nodes, j)))
    f, cos_t, _, eta_ti = fresnel(dr.dot(wi, m), eta)
    if transmitted:
        wo = refract(wi, m, cos_t, eta_ti)
        share = dr.select(wo.z < 0, surface.smith_g1(wo, m) * (1 - f), 0)
    else:
        wo = reflect(wi, m)
        share = dr.select(wo.z > 0, surface.smith_g1(wo, m) * f, 0)
    return dr.block_sum(share * dr.gather(Float, weights, i) * dr.gather(Float, weights, j), count**2)


@cache
def quadrature(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The nodes of Gauss' and Legendre's quadrature in (-1, 1), and their weights; found by solving for eigenvalues."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes, weights


register_bsdf("roughplastic", RoughPlastic)

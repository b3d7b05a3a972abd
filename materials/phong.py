"""Phong's highlight."""

from __future__ import annotations

import math
from collections.abc import Sequence

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.numeric import as_array
from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.errors import ParameterError, SceneError
from djpt.jit.kernels import maximum
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32, Vector3f
from djpt.materials.base import BSDF

__all__ = ["Phong", "cosine_power", "power"]

INV_PI = 1 / math.pi


class Phong(BSDF):
    """f = k_d / pi + k_s (n + 2) / (2 pi) max(cos alpha, 0)^n, on the side of the normal only; black from behind.

    alpha is the angle between `wo` and the mirror image of `wi`.

    Parameters: `diffuse_reflectance` (k_d, texture, default 0.5), `specular_reflectance` (k_s, texture, default
    0.2), `exponent` (n, scalar texture, > 0, default 30). k_d + k_s <= 1 in each channel, or more light would be
    reflected than arrives: checked for constant textures, for others up to you.

    The lobes are chosen in proportion to the means of k_d and k_s; the highlight is sampled with the density
    (n + 1) / (2 pi) cos^n alpha, samples below the horizon are lost.

    E. Lafortune and Y. Willems, "Using the Modified Phong Reflectance Model for Physically Based Rendering", 1994.
    """

    in_any_frame = True
    symmetric = True
    children = ("diffuse_reflectance", "specular_reflectance", "exponent")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.diffuse_reflectance = props.texture("diffuse_reflectance", 0.5, low=0.0, high=1.0)
        self.specular_reflectance = props.texture("specular_reflectance", 0.2, low=0.0, high=1.0)
        self.exponent = props.texture_1("exponent", 30.0, low=0.0, low_open=True)
        problem = self._excess()
        if problem:
            raise SceneError(f"{props.node}: {problem}")

    def _excess(self) -> str:
        """A message if the reflectances add up to more than 1, else an empty one."""
        if not (self.diffuse_reflectance.is_constant and self.specular_reflectance.is_constant):
            return ""
        diffuse, specular = (
            as_array(dr.detach(t.eval(None))) for t in (self.diffuse_reflectance, self.specular_reflectance)
        )
        channel = int((diffuse + specular).argmax())
        if diffuse[channel] + specular[channel] <= 1 + 1e-6:
            return ""
        return (
            "'diffuse_reflectance' and 'specular_reflectance' must not add up to more than 1, "
            f"found {diffuse[channel]:.6g} + {specular[channel]:.6g} in the {('red', 'green', 'blue')[channel]} channel"
        )

    def parameters_changed(self, keys: Sequence[str]) -> None:
        problem = self._excess()
        if problem:
            raise ParameterError(f"{self.id()}: {problem}")

    def components(self) -> tuple[int, ...]:
        lobes = BSDFFlags.DiffuseReflection, BSDFFlags.GlossyReflection
        return tuple(int(lobe | BSDFFlags.FrontSide) for lobe in lobes)

    def highlight(self, wi: Vector3f, wo: Vector3f, n: Float) -> tuple[Float, Float]:
        """The highlight's f / k_s and its density, per unit solid angle of `wo`."""
        lobe = power(dr.dot(mirrored(wi), wo), n)
        return lobe * (n + 2) * (0.5 * INV_PI), lobe * (n + 1) * (0.5 * INV_PI)

    def sample_highlight(self, wi: Vector3f, n: Float, sample: Point2f) -> Vector3f:
        """A direction with the density of `highlight`."""
        local = cosine_power(n, sample)
        axis = mirrored(wi)
        return Frame3f.from_normal(axis).to_world(local)

    def _weights(self, si: SurfaceInteraction3f, active: Bool | bool) -> Float:
        """The probability of sampling the highlight."""
        diffuse, specular = self.diffuse_reflectance.mean(), self.specular_reflectance.mean()
        return dr.detach(specular * dr.rcp(maximum(diffuse + specular, Float(1e-8))))

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        n = dr.detach(self.exponent.eval_1(si, active))
        glossy = sample1 < self._weights(si, active)
        wo = dr.select(glossy, self.sample_highlight(si.wi, n, sample2), square_to_cosine_hemisphere(sample2))
        value, pdf = self.eval_pdf(ctx, si, wo, active)
        kind = dr.select(glossy, UInt32(BSDFFlags.GlossyReflection), UInt32(BSDFFlags.DiffuseReflection))
        bs = BSDFSample3f.of(wo, pdf, kind, sampled_component=dr.select(glossy, UInt32(1), UInt32(0)))
        return bs, value * dr.select(pdf > 0, dr.rcp(pdf), 0)

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        above = (si.wi.z > 0) & (wo.z > 0)
        f, density = self.highlight(si.wi, wo, self.exponent.eval_1(si, active))
        diffuse, specular = self.diffuse_reflectance.eval(si, active), self.specular_reflectance.eval(si, active)
        value = (diffuse * INV_PI + specular * f) * wo.z
        pdf = dr.lerp(wo.z * INV_PI, density, self._weights(si, active))
        return dr.select(above, value, 0), dr.select(above, pdf, 0)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.diffuse_reflectance.eval(si, active)


def mirrored(w: Vector3f) -> Vector3f:
    """The direction into which a mirror reflects `w`."""
    return Vector3f(-w.x, -w.y, w.z)


def power(cosine: Float, n: Float) -> Float:
    """The power cosine^n; 0 where the cosine isn't positive."""
    positive = cosine > 0
    return dr.select(positive, dr.exp2(n * dr.log2(dr.select(positive, cosine, 1))), 0)


def cosine_power(n: Float, sample: Point2f) -> Vector3f:
    """A direction about +z with the density (n + 1) / (2 pi) cos^n theta."""
    z = power(1 - sample.x, dr.rcp(n + 1))
    r = dr.sqrt(maximum(dr.fma(-z, z, 1), Float(0)))
    sin, cos = dr.sincos(2 * math.pi * sample.y)
    return Vector3f(r * cos, r * sin, z)


register_bsdf("phong", Phong)

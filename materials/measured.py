"""Measured materials: reflection as a goniophotometer has recorded it."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.description.files import resolve
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.description.tensor_files import read_tensors
from djpt.distributions.marginal_2d import MarginalContinuous2D0, MarginalContinuous2D2
from djpt.errors import FileError
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDFAtPoint, SharedWorkBSDF
from djpt.materials.fresnel import reflect

__all__ = ["Measured"]

AXES = {"theta_i": 1, "phi_i": 1, "ndf": 2, "sigma": 2, "vndf": 4, "luminance": 4, "rgb": 5, "jacobian": 1}
"""The fields of a file, with the number of their axes."""


class Measured(SharedWorkBSDF):
    """A material in a file of the measured database; black from behind.

    Reflectance is stored over a square that the distribution of visible microfacets is warped to, so that little
    varies over it: f cos theta_o = s(u) D(m) / (4 sigma(wi)), with the half vector m, the square's point u that leads
    to m, the distribution D of microfacets and their projected area sigma. Directions are sampled by the brightness of
    s, then by the warp.

    J. Dupuy and W. Jakob, "An Adaptive Parameterization for Efficient Material Acquisition and Rendering" (TOG 37(6),
    2018); measurements: https://rgl.epfl.ch/materials (files whose names end in ``_rgb.bsdf``).

    Parameters: `filename` (required) of a tensor file with the fields of `AXES` in single precision: angles of
    incidence, `vndf` and `luminance` (phi_i, theta_i, rows, columns), `rgb` (phi_i, theta_i, 3, rows, columns), `ndf`
    and `sigma` (rows, columns). There are no parameters to edit.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        with props.naming("filename"):
            path = resolve(props.string("filename"))
            fields = checked(read_tensors(path), str(path))
            axes = [fields["phi_i"].tolist(), fields["theta_i"].tolist()]
            self.ndf, self.sigma = (
                MarginalContinuous2D0(fields[name], normalize=False, enable_sampling=False) for name in ("ndf", "sigma")
            )
            self.vndf = MarginalContinuous2D2(fields["vndf"], axes)
            self.luminance = MarginalContinuous2D2(fields["luminance"], axes)
            self.channels = tuple(
                MarginalContinuous2D2(fields["rgb"][:, :, channel], axes, normalize=False, build_hierarchy=False)
                for channel in range(3)
            )
        turn = 2 * math.pi / float(np.ptp(fields["phi_i"])) if len(fields["phi_i"]) > 2 else 0.0
        self.isotropic = len(fields["phi_i"]) <= 2
        self.symmetry = round(turn)
        """The number of times that the measured angles make up a full turn; 0 for isotropic materials."""
        self.weighted = bool(fields["jacobian"][0])
        """True if s has to be multiplied by D / (4 sigma)."""

    def components(self) -> tuple[int, ...]:
        return (int(BSDFFlags.GlossyReflection | BSDFFlags.FrontSide),)

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return MeasuredAtPoint(self, si, active)


class MeasuredAtPoint:
    """A `Measured` at one point, seen from `wi`: the work that evaluation and sampling share."""

    def __init__(self, bsdf: Measured, si: SurfaceInteraction3f, active: Bool | bool) -> None:
        self.bsdf = bsdf
        self.above = si.wi.z > 0
        self.active = active
        # Symmetric materials were measured from one side.
        one, flip = Float(1), -dr.sign(si.wi.y)
        self.flip_y = flip if bsdf.symmetry >= 2 else one
        self.flip_x = -dr.sign(si.wi.x) if bsdf.symmetry == 4 else self.flip_y
        self.wi = self.mirrored(Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z)))  # numbers, from behind, too
        self.phi_i = dr.atan2(self.wi.y, self.wi.x)
        theta_i = elevation(self.wi)
        self.angles = [self.phi_i, theta_i]
        self.area = bsdf.sigma.eval(on_square(theta_i, self.phi_i), (), self.active)

    def mirrored(self, v: Vector3f) -> Vector3f:
        """A direction on the side that was measured, or back."""
        return Vector3f(v.x * self.flip_x, v.y * self.flip_y, v.z)

    def value(self, sample: Point2f, u_m: Point2f) -> Color3f:
        """The value f cos theta_o for a half vector at `u_m`, to which `sample` is warped."""
        bsdf = self.bsdf
        value = Color3f(*(channel.eval(sample, self.angles, self.active) for channel in bsdf.channels))
        return value * (bsdf.ndf.eval(u_m, (), self.active) / (4 * self.area)) if bsdf.weighted else value

    def solid_angle(self, u_m: Point2f, sin_theta: Float, cos: Float) -> Float:
        """The solid angle of `wo` per unit of the square at `u_m`; `cos` is that of wi with the half vector."""
        return dr.maximum(2 * math.pi**2 * u_m.x * sin_theta, 1e-6) * 4 * cos

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        ok = self.above & (wo.z > 0)
        wo = self.mirrored(wo)
        h = self.wi + wo
        m = h * dr.rsqrt(dr.select(ok, dr.squared_norm(h), 1))
        phi = dr.atan2(m.y, m.x)
        u_m = on_square(elevation(m), phi - self.phi_i if self.bsdf.isotropic else phi)
        u_m = Point2f(u_m.x, u_m.y - dr.floor(u_m.y))
        sample, density = self.bsdf.vndf.invert(u_m, self.angles, self.active)
        cos, sin_theta = dr.dot(self.wi, m), dr.safe_sqrt(dr.fma(m.x, m.x, dr.square(m.y)))
        pdf = density * self.bsdf.luminance.eval(sample, self.angles, self.active)
        pdf = pdf / dr.select(ok, self.solid_angle(u_m, sin_theta, cos), 1)
        return dr.select(ok, self.value(sample, u_m), 0), dr.select(ok, pdf, 0)

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        bright, density = self.bsdf.luminance.sample(Point2f(sample2.y, sample2.x), self.angles, self.active)
        u_m, visible = self.bsdf.vndf.sample(bright, self.angles, self.active)
        theta, phi = dr.square(u_m.x) * (math.pi / 2), (2 * u_m.y - 1) * math.pi
        (sin_theta, cos_theta), (sin_phi, cos_phi) = (
            dr.sincos(theta),
            dr.sincos(phi + self.phi_i if self.bsdf.isotropic else phi),
        )
        m = Vector3f(cos_phi * sin_theta, sin_phi * sin_theta, cos_theta)
        wo, cos = reflect(self.wi, m), dr.dot(self.wi, m)
        ok = self.above & (wo.z > 0) & (cos > 0)
        pdf = dr.select(ok, density * visible / dr.select(ok, self.solid_angle(u_m, sin_theta, cos), 1), 0)
        weight = self.value(bright, u_m) * dr.rcp(dr.select(pdf > 0, pdf, 1))
        bs = BSDFSample3f.of(self.mirrored(wo), pdf, BSDFFlags.GlossyReflection)
        return bs, dr.select(pdf > 0, weight, 0)


def elevation(d: Vector3f) -> Float:
    """The angle of a unit vector with +z, exact for small angles, too."""
    return 2 * dr.safe_asin(0.5 * dr.norm(d - Vector3f(0, 0, 1)))


def on_square(theta: Float, phi: Float) -> Point2f:
    """The point of the unit square for an elevation and an azimuth."""
    return Point2f(dr.sqrt(theta * (2 / math.pi)), (phi + math.pi) * (0.5 / math.pi))


def checked(fields: dict[str, NDArray[Any]], path: str) -> dict[str, NDArray[Any]]:
    """Return the fields of a file; raise `FileError` if they don't make up a measurement in colours."""
    if "wavelengths" in fields and "rgb" not in fields:
        raise FileError(f"'{path}' has spectra: rendering is in colours, which are in the file that ends in _rgb.bsdf")
    for name, count in AXES.items():
        if name not in fields:
            raise FileError(f"'{path}' isn't a measured material: it has no field '{name}'")
        found, wanted = fields[name], "uint8" if name == "jacobian" else "float32"
        if found.ndim != count or found.dtype != wanted:
            raise FileError(f"'{path}': '{name}' must be {wanted} with {count} axes, found {found.dtype}{found.shape}")
    angles = (len(fields["phi_i"]), len(fields["theta_i"]))
    square = fields["luminance"].shape[2:]
    expected = {
        "vndf": (*angles, *fields["vndf"].shape[2:]),
        "luminance": (*angles, *square),
        "rgb": (*angles, 3, *square),
    }
    for name, shape in expected.items():
        if fields[name].shape != shape:
            raise FileError(f"'{path}': '{name}' must have the shape {shape}, found {fields[name].shape}")
    return fields


register_bsdf("measured", Measured)

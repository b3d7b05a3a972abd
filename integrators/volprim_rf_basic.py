"""Radiance fields made of ellipsoids: Gaussians that emit, and cover what is behind them."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.core.srgb import srgb_to_linear
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.integrators.ad_integrator import UNBOUNDED, RBIntegrator
from djpt.jit.types import Bool, Color3f, Float, Point3f, UInt32, Vector3f, backend

__all__ = ["BasicVolumetricPrimitiveRadianceFieldIntegrator"]

DENSEST = 0.9999
"""The largest fraction of light that one ellipsoid covers."""
ENOUGH = 0.01
"""A ray ends where no channel has more than this fraction of it left."""
STEP = 1e-4
"""Distance behind a hit, in units of the ray's direction, at which the ray goes on."""


class BasicVolumetricPrimitiveRadianceFieldIntegrator(RBIntegrator):
    """Ellipsoids along a ray, from front to back, each as a Gaussian that is seen through.

    L = sum over hits k of c_k a_k prod over j < k of (1 - a_j), with a = min(opacity exp(-r^2 / 2), 0.9999), r the
    least distance of the ray from the centre in units of the scales, and c = max(0, 1/2 + sum of c_lm Y_lm(d)) the
    colour in the direction d of the ray. A ray counts an ellipsoid where it enters it; other shapes end it. All
    light is that of the ellipsoids.

    The ellipsoids need the attributes `opacities` (1 number) and `sh_coeffs` (3 (n + 1)^2 numbers for the degree n:
    red, green and blue of each function, in the order of `drjit.sh_eval`). There are derivatives by both, and by `data`
    (centres, scales and quaternions), as far as the Gaussians depend on it: which ellipsoids a ray meets is fixed.

    Parameters: `max_depth` (ellipsoids that a ray counts at most, -1: any number; default 64), `srgb_primitives` (the
    sum is encoded in sRGB, default true; derivatives include the decoding, which Mitsuba's leave out).

    B. Kerbl, G. Kopanas, T. Leimkuehler and G. Drettakis, "3D Gaussian Splatting for Real-Time Radiance Field
    Rendering", SIGGRAPH 2023; N. Moenne-Loccoz et al., "3D Gaussian Ray Tracing", SIGGRAPH Asia 2024.
    """

    pure = True
    needs_light = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        depth = props.integer("max_depth", 64, low=-1)
        self.max_depth = UNBOUNDED if depth < 0 else depth
        self.srgb_primitives = props.boolean("srgb_primitives", True)

    def to_string(self) -> str:
        """The name of the class."""
        return f"{type(self).__name__}[]"

    def eval_transmission(self, si: Any, ray: Any, active: Bool | bool) -> Float:
        """The fraction of light that the ellipsoid of each hit lets through along the whole ray."""
        data = si.shape.each(lambda shape, mine: attribute(shape, "ellipsoid", si, mine & active), [Float(0)] * 10)
        opacity = si.shape.each(lambda shape, mine: attribute(shape, "opacities", si, mine & active)[0], Float(0))
        to_world = dr.quat_to_matrix(backend.Matrix3f, backend.Quaternion4f(*data[6:]))
        scale = Vector3f(*data[3:6])
        # Where the Gaussian is round, its peak along the ray is the point next to the centre.
        o = Vector3f(to_world.T @ (ray.o - Point3f(*data[:3]))) / scale
        d = Vector3f(to_world.T @ ray.d) / scale
        peak = o - d * (dr.dot(o, d) / dr.squared_norm(d))
        density = dr.exp(-0.5 * dr.squared_norm(peak))
        return 1 - dr.minimum(opacity * density, DENSEST)

    def eval_sh_emission(self, si: Any, ray: Any, active: Bool | bool) -> Color3f:
        """The colour that the ellipsoid of each hit has in the ray's direction; black elsewhere."""

        def emission(shape: Any, mine: Bool) -> Color3f:
            coefficients = attribute(shape, "sh_coeffs", si, mine & active)
            degree = math.isqrt(len(coefficients) // 3) - 1
            total = Color3f(0.5)
            for i, y in enumerate(dr.sh_eval(ray.d, max(0, degree))):
                total = total + y * Color3f(*coefficients[3 * i : 3 * i + 3])
            return dr.maximum(total, 0)

        return Color3f(
            si.shape.each(lambda s, mine: emission(s, mine) if s.is_ellipsoids() else Color3f(0), Color3f(0))
        )

    @dr.syntax
    def sample(  # type: ignore[no-untyped-def, override]
        self, mode, scene, sampler, ray, δL, state_in, active, **kwargs
    ):
        primal = mode == dr.ADMode.Primal
        # The state of loops is an array from the start: what seems constant at first may not stay so.
        zero, longest = dr.opaque(Float, 0, sampler.wavefront_size()), dr.opaque(UInt32, self.max_depth)
        o, d = Point3f(dr.detach(ray.o)) + zero, Vector3f(dr.detach(ray.d)) + zero
        L = Color3f(0 if primal else state_in) + zero
        change = Color3f(0 if δL is None else δL) + zero
        if dr.hint(not primal and self.srgb_primitives, mode="scalar"):
            slope = decoding(L)
            if dr.hint(mode == dr.ADMode.Backward, mode="scalar"):
                change = change * slope
        β, depth = Color3f(1) + zero, UInt32(zero)
        active = Bool(active) & (zero == 0)

        while dr.hint(active, label="ellipsoids"):
            here = Ray3f(o, d)
            si = scene.ray_intersect(here, active=active)
            active &= si.is_valid() & si.shape.is_ellipsoids()
            with dr.resume_grad(when=not primal):
                emission = self.eval_sh_emission(si, here, active)
                passed = self.eval_transmission(si, here, active)
                Le = β * (1 - passed) * emission
                Le = dr.select(active & dr.isfinite(Le), Le, 0)
            L = L + dr.detach(Le) if primal else L - dr.detach(Le)
            β = dr.select(active, β * dr.detach(passed), β)

            if dr.hint(not primal, mode="scalar"):
                with dr.resume_grad():
                    Lo = Le + L * (passed / dr.detach(passed))
                    Lo = dr.select(active & dr.isfinite(Lo), Lo, 0)
                    if dr.hint(dr.grad_enabled(Lo), mode="scalar"):
                        if dr.hint(mode == dr.ADMode.Backward, mode="scalar"):
                            dr.backward_from(change * Lo)
                        else:
                            change = change + dr.forward_to(Lo)

            o = dr.select(active, dr.detach(si.p) + d * STEP, o)
            depth += dr.select(active, UInt32(1), 0)
            active &= (dr.max(β) > ENOUGH) & (depth < longest)

        if dr.hint(primal, mode="scalar"):
            shown = srgb_to_linear(L) if self.srgb_primitives else L
            return shown, Bool(True), [], L
        if dr.hint(self.srgb_primitives and mode == dr.ADMode.Forward, mode="scalar"):
            change = change * slope
        return change, Bool(True), [], state_in


def attribute(shape: Any, name: str, si: Any, active: Bool) -> list[Float]:
    """The numbers of an attribute of ellipsoids at hits; a 0 for each number of `ellipsoid` on other shapes."""
    if not shape.is_ellipsoids():
        return [Float(0)] * 10
    return list(shape.eval_attribute_x(name, si, active))


def decoding(encoded: Color3f) -> Color3f:
    """The derivative of `djpt.math.srgb_to_linear`."""
    with dr.resume_grad():
        x = Color3f(dr.detach(encoded))
        dr.enable_grad(x)
        dr.set_grad(x, 1)
        return Color3f(dr.detach(dr.forward_to(srgb_to_linear(x))))


register_integrator("volprim_rf_basic", BasicVolumetricPrimitiveRadianceFieldIntegrator)

"""The common part of normal maps and bump maps: a BSDF in a frame that a texture has tilted."""

from __future__ import annotations

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.jit.kernels import maximum
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDFAtPoint, NestingBSDF

__all__ = ["PerturbedBSDF"]

TINY = 1e-20
"""Vectors of a smaller squared length have no direction."""

WINDOW = 0.05
"""The largest cosine between `wi` and the plane of a tilted normal at which the jump there is differentiated."""

BESIDE = 1e-4
"""The cosine at which what is on the other side of a jump is evaluated."""


class PerturbedBSDF(NestingBSDF):
    """The nested BSDF, seen in a frame about another normal.

    Parameters: one nested BSDF, under any key (its parameters are listed under `nested_bsdf`), and

    * `flip_invalid_normals` (default true): a normal that `wi` sees from the other side than the surface is
      turned about z, by half a revolution: V. Schuessler, E. Heitz, J. Hanika and C. Dachsbacher,
      "Microfacet-based Normal Mapping for Robust Monte Carlo Path Tracing", SIGGRAPH Asia 2017, call it
      the usual remedy;
    * `use_shadowing_function` (default true): light from near the horizon is faded out, instead of being cut
      off where the tilted normal can't see it: A. C. Estevez, P. Lecocq and C. Stein, "A Microfacet-Based
      Shadowing Function to Solve the Bump Terminator Problem", Ray Tracing Gems, 2019.

    Directions that lie above one of the two horizons and below the other are black: no light leaks through.

    Where a normal turns away from `wi`, the value jumps, and as the normals or `wi` move, so does the place of the
    jump. With g the cosine between both, A the value for g > 0 and B that for g < 0, the derivative has the term
    (A - B) delta(g) dg. For delta stands a window of the width 0.1, whose error is of second order.
    """

    statics = ("flip_invalid_normals", "use_shadowing_function")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.flip_invalid_normals = props.boolean("flip_invalid_normals", True)
        self.use_shadowing_function = props.boolean("use_shadowing_function", True)

    # ---- the frame -----------------------------------------------------------------------

    def normal(self, si: SurfaceInteraction3f, active: Bool | bool) -> Vector3f:
        """The normal that the texture asks for, in the shading frame; of any length."""
        raise NotImplementedError

    def tangent(self, si: SurfaceInteraction3f) -> Vector3f:
        """The direction that the frame's `s` follows, in the shading frame."""
        return Vector3f(1, 0, 0)

    def tilted(self, si: SurfaceInteraction3f, active: Bool | bool) -> tuple[Frame3f, SurfaceInteraction3f]:
        """The new frame, relative to the old one, and `si` as the nested BSDF sees it."""
        return self.about(si, self.normal(si, active))

    def about(self, si: SurfaceInteraction3f, n: Vector3f) -> tuple[Frame3f, SurfaceInteraction3f]:
        """`tilted`, for the normal `n`."""
        if self.flip_invalid_normals:
            n = dr.select(si.wi.z * dr.dot(si.wi, n) <= 0, Vector3f(-n.x, -n.y, n.z), n)
        n = direction(n, Vector3f(0, 0, 1))
        tangent = self.tangent(si)
        s = direction(dr.fma(n, -dr.dot(n, tangent), tangent), Vector3f(0, 1, 0))
        frame = Frame3f(s, dr.cross(n, s), n)
        world = Frame3f(*(si.sh_frame.to_world(axis) for axis in (frame.s, frame.t, frame.n)))
        return frame, si.replaced(sh_frame=world, wi=frame.to_local(si.wi))

    def shadowing(self, frame: Frame3f, wo: Vector3f) -> Float:
        """The masking function of a GGX distribution that is as rough as the normal is tilted."""
        if not self.use_shadowing_function:
            return Float(1)
        # An eighth of the squared tangent, at most 1.
        squared_alpha = 0.125 * squared_tangent(frame.n.z, 1 / 9)
        return 2 * dr.rcp(1 + dr.sqrt(dr.fma(squared_alpha, squared_tangent(wo.z, TINY), 1)))

    def sh_frame(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Frame3f:
        return self.tilted(si, active)[1].sh_frame

    # ---- the BSDF ------------------------------------------------------------------------

    def components(self) -> tuple[int, ...]:
        return self.nested_bsdf.components()

    def has_jumps(self, interpolated: bool = False) -> bool:
        """Whether light is cut off at the surface's horizon, or a smooth lobe is turned to the other side of it."""
        smooth = BSDFFlags.DeltaReflection | BSDFFlags.DeltaTransmission
        return interpolated or not self.use_shadowing_function or has_flag(self.flags(), smooth)

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return PerturbedAtPoint(self, ctx, si, active)

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.nested_bsdf.eval_null_transmission(self.tilted(si, active)[1], active)


class PerturbedAtPoint:
    """A `PerturbedBSDF` at one point, seen from `wi`: the nested BSDF in the tilted frame."""

    def __init__(self, bsdf: PerturbedBSDF, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> None:
        self.bsdf = bsdf
        n = bsdf.normal(si, active)
        self.frame, tilted = bsdf.about(si, n)
        self.nested = bsdf.nested_bsdf.at_point(ctx, tilted, active)
        self.jump = Jump(bsdf, ctx, si, n, active) if dr.grad_enabled(n) or dr.grad_enabled(si.wi) else None

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        value, pdf = self.seen(self.frame, self.nested, wo)
        return value if self.jump is None else self.jump.attached(self, wo, value, Float(1)), pdf

    def seen(self, frame: Frame3f, nested: BSDFAtPoint, wo: Vector3f) -> tuple[Color3f, Float]:
        """The value and the density of a nested BSDF in a frame."""
        local = frame.to_local(wo)
        value, pdf = nested.eval_pdf(local)
        # Where both frames see `wo` on the same side.
        ok = wo.z * local.z > 0
        return dr.select(ok, value * self.bsdf.shadowing(frame, wo), 0), dr.select(ok, pdf, 0)

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        bs, weight = self.nested.sample(sample1, sample2)
        wo = self.frame.to_world(bs.wo)
        # Derivatives need the directions of a black BSDF, too.
        sampled = bs.pdf > 0 if dr.grad_enabled(weight) else dr.any(weight != 0)
        ok = (wo.z * bs.wo.z > 0) & sampled
        weight = dr.select(ok, weight * self.bsdf.shadowing(self.frame, wo), 0)
        pdf = dr.select(ok, bs.pdf, 0)
        if self.jump is not None:
            smooth = dr.select(ok & ~has_flag(bs.sampled_type, BSDFFlags.Delta), dr.rcp(dr.detach(bs.pdf)), 0)
            weight = self.jump.attached(self, wo, weight, smooth)
        return bs.replaced(wo=wo, pdf=pdf), weight


class Jump:
    """The derivative of the jump of a `PerturbedBSDF` where its normal turns away from `wi`."""

    def __init__(
        self, bsdf: PerturbedBSDF, ctx: BSDFContext, si: SurfaceInteraction3f, n: Vector3f, active: Bool | bool
    ) -> None:
        n = direction(n, Vector3f(0, 0, 1))
        g = dr.dot(si.wi, n) * dr.sign(dr.detach(si.wi.z))
        still, here, wi = dr.detach(n), dr.detach(g), dr.detach(si.wi)
        self.near = Bool(active) & (dr.abs(here) < WINDOW)
        # A - B is this side less the other one, or the other way round.
        self.passed = dr.mulsign((g - here) * (0.5 / WINDOW), here)
        beyond = dr.fma(wi, dr.sign(wi.z) * (dr.mulsign(Float(-BESIDE), here) - here), still)
        self.frame, tilted = bsdf.about(dr.detach(si), beyond)
        self.nested = bsdf.nested_bsdf.at_point(ctx, tilted, self.near)

    def attached(self, point: PerturbedAtPoint, wo: Vector3f, here: Color3f, factor: Float) -> Color3f:
        """The value `here` of a function that is `factor` times that of the BSDF, with the jump's derivative."""
        wo = dr.detach(wo)
        beyond, _ = point.seen(self.frame, self.nested, wo)
        step = dr.detach(here) - dr.detach(beyond) * factor
        jump = dr.select(self.near & (factor > 0), step * self.passed, 0)
        return dr.replace_grad(here, here + jump)  # type: ignore[func-returns-value, return-value]


def direction(v: Vector3f, otherwise: Vector3f) -> Vector3f:
    """The unit vector along `v`; `otherwise` where `v` has no direction."""
    squared = dr.squared_norm(v)
    usable = squared > TINY
    return dr.select(usable, v * dr.rsqrt(dr.select(usable, squared, 1)), otherwise)


def squared_tangent(cosine: Float, least: float) -> Float:
    """The squared tangent of an angle; squared cosines below `least` count as `least`."""
    squared = maximum(dr.square(cosine), Float(least))
    return maximum(1 - squared, Float(0)) * dr.rcp(squared)

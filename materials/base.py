"""The contract of BSDFs."""

from __future__ import annotations

import math
from typing import ClassVar

from djpt.description.plugin import Plugin
from djpt.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.types import Bool, Color3f, Float, Point2f, Vector3f

__all__ = ["BSDF"]


class BSDF(Plugin):
    """How a surface scatters light: f(wi, wo) and a way to sample it.

    All methods run in kernels, once per class, with per-lane values (see `djpt.dispatch`).

    * `si.wi` and `wo` point away from the surface, in the shading frame (normal +z).
    * `eval` gives f(wi, wo) abs(cos theta_o): the cosine is included. Zero means black.
    * Densities are per unit solid angle of `wo`; delta lobes are never seen by `eval` and `pdf`.
    * `sample` gives a direction and the weight f abs(cos) / pdf; the weight is 0 where nothing
      was sampled.
    * Where `active` is false the results mean nothing: callers mask.

    Sampling decisions are detached. Derivatives of smooth lobes are taken from `eval`, at the sampled
    direction: `wo`, `pdf` and the weight that `sample` returns are used as if they were constants. The
    weight of a delta lobe, which `eval` can't see, keeps its derivative: it must be the lobe's value over
    `dr.detach` of the probability of choosing it.
    """

    kind: ClassVar[str] = "bsdf"
    absorbs: bool = False
    """Is light attenuated within the body that the surface encloses? See `transmittance`."""

    def flags(self) -> int:
        """The `BSDFFlags` of all lobes together."""
        return int(BSDFFlags.Empty)

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        """Sample `wo`; `sample1` picks the lobe, `sample2` the direction."""
        raise NotImplementedError

    def eval(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Color3f:
        """f(wi, wo) abs(cos theta_o)."""
        raise NotImplementedError

    def pdf(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Float:
        """Density of `sample` at `wo`."""
        raise NotImplementedError

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        """`eval` and `pdf` together; override where they share work."""
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def eval_pdf_sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        wo: Vector3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Color3f, Float, BSDFSample3f, Color3f]:
        """`eval_pdf` and `sample` together: what a path vertex needs, in one dispatch."""
        value, pdf = self.eval_pdf(ctx, si, wo, active)
        sample, weight = self.sample(ctx, si, sample1, sample2, active)
        return value, pdf, sample, weight

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The share of light that passes straight through the surface, by a `Null` lobe."""
        return Color3f(0)

    def transmittance(self, distance: Float) -> Color3f:
        """What is left of light after a distance within the body that the surface encloses."""
        return Color3f(1)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The albedo shown by the `aov` integrator: by default pi f at normal incidence and exitance."""
        up = SurfaceInteraction3f(**{**vars(si), "wi": Vector3f(0, 0, 1)})
        return self.eval(BSDFContext(), up, Vector3f(0, 0, 1), active) * math.pi

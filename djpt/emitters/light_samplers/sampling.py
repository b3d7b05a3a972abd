"""Light sampling: an emitter is chosen, then a direction towards it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr

from djpt.core.records import DirectionSample3f, Observer, Ray3f, Reference, SurfaceInteraction3f
from djpt.dispatch.ensemble import Detached, Ensemble, Lookup
from djpt.dispatch.family import Family
from djpt.emitters.base import Emitter
from djpt.emitters.pointer import EmitterPtr
from djpt.jit.kernels import computed_where
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f

__all__ = ["LightSample", "LightSampler", "LightSampling", "MetLight"]


class LightSampler:
    """A distribution over a scene's emitters, for a point that light is to be sampled at.

    Built on the host, before kernels are traced; the methods run in kernels.
    """

    uses_normal = False
    """True if the choice depends on the surface normal at the point."""

    def __init__(self, emitters: Sequence[Emitter]) -> None:
        """`emitters`: at least one, in the order in which the scene numbers them."""
        self.count = len(emitters)

    def choose(self, p: Point3f, n: Vector3f | None, u: Float) -> tuple[UInt32, Float, Float]:
        """Choose an emitter for the point `p`: its number, the inverse of its probability, and a fresh uniform number.

        `u` in [0, 1) makes the choice; what it leaves undecided is the new number in [0, 1). The inverse
        probability is 0 where no emitter was chosen. `n` may be None (no surface); its side doesn't matter.
        """
        raise NotImplementedError

    def probability(self, p: Point3f, n: Vector3f | None, index: UInt32) -> Float:
        """The probability that `choose` gives emitter number `index`; unspecified beyond the last."""
        raise NotImplementedError


@dataclass
class MetLight:
    """The emission of the surface, or of the environment, that a ray has hit."""

    radiance: Color3f
    """The radiance that it sends along the ray."""
    pdf: Float
    """The density per unit solid angle with which light sampling would have chosen the ray's direction."""


@dataclass
class LightSample:
    """A direction towards an emitter."""

    ds: DirectionSample3f
    """`ds.pdf` includes the probability of choosing the emitter."""
    weight: Color3f
    """Radiance / pdf, without visibility."""


@dataclass
class LightSampling:
    """The emitters of a scene, a way to choose among them, and a way to read their values."""

    emitters: Ensemble[Emitter]
    light_sampler: LightSampler
    lookup: Lookup

    def sample(self, ref: Observer, sample: Point2f, active: Bool | bool = True) -> LightSample:
        """Choose an emitter and sample a direction towards it from `ref`.

        `sample.x` chooses and is then stretched for use in the emitter. Without emitters the weight is 0.
        """
        if not len(self.emitters):
            nothing = DirectionSample3f.of(
                ref.p, Normal3f(0), Point2f(0), Vector3f(0, 0, 1), Float(0), Float(0), Float(0), Bool(False), UInt32(0)
            )
            return LightSample(nothing, Color3f(0))
        index, inverse, u = self.light_sampler.choose(ref.p, ref.n, sample.x)
        ds, weight = self._emitter(index).sample_direction(ref, Point2f(u, sample.y), active)
        if self.light_sampler.count > 1:
            probability = dr.select(inverse > 0, dr.rcp(inverse), 0)
            ds.pdf, ds.weight, weight = ds.pdf * probability, ds.weight * inverse, weight * inverse
        return LightSample(ds, weight)

    def pdf(self, ref: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample` at `ds`, per unit solid angle at `ref`."""
        pdf = self._emitter(ds.emitter_index).pdf_direction(ref, ds, active)
        if len(self.emitters) < 2:
            return pdf
        return pdf * self.light_sampler.probability(ref.p, ref.n, ds.emitter_index)

    def at_vertex(
        self,
        ref: Reference,
        ray: Ray3f,
        si: SurfaceInteraction3f,
        sample: Point2f,
        active: Bool,
        weighted: Bool,
        inside: Bool | None = None,
    ) -> tuple[MetLight, LightSample]:
        """All that a path vertex needs of the emitters: the light that `ray` from `ref` met at `si`, and a sample.

        Lanes that aren't `active` need no sample, those that aren't `weighted` no density, and those `inside` of a
        medium, at no surface, no light. A lone environment is looked up once for both.
        """
        lone = self.emitters.plugins[0] if len(self.emitters) == 1 else None
        if lone is not None and lone.shares_lookup and not lone.is_moving() and lone.carrier is None:
            environment = self.emitters.groups[0].at(UInt32(0), self.lookup)
            radiance, pdf, weight, d = environment.eval_or_sample(si, sample, active)
            ds = DirectionSample3f.of(
                si.p + d, -d, Point2f(0), d, Float(dr.inf), pdf, weight, Bool(False), UInt32(0)
            )  # fmt: skip
            met = dr.select(si.is_valid(), 0, radiance)
            return MetLight(met, pdf), LightSample(ds, radiance * weight)
        ds, emitter = DirectionSample3f.between(ref.p, ray, si), si.emitter()
        if len(self.emitters.groups) < 2 or not isinstance(self.lookup, Detached):
            return MetLight(emitter.eval(si), self.pdf(ref, ds)), self.sample(si, sample, active)
        # Emitters of several kinds are long code, which few packets need: most rays end on surfaces that don't emit.
        shines = emitter.is_valid() if inside is None else emitter.is_valid() & ~inside
        # Copies, because fields that are first read in a branch exist in it alone.
        seen = computed_where(shines, lambda: self._met(emitter, ref, si.replaced(), ds.replaced()), label="emission")
        light = computed_where(active, lambda: self.sample(si.replaced(), sample, active), label="light sample")
        return seen, light

    def _met(self, emitter: EmitterPtr, ref: Observer, si: SurfaceInteraction3f, ds: DirectionSample3f) -> MetLight:
        """The light of `emitter` that a ray from `ref`, described by `ds`, has met at `si`."""
        radiance, pdf = emitter.eval_and_pdf(si, ref, ds)
        return MetLight(radiance, pdf * self.light_sampler.probability(ref.p, ref.n, ds.emitter_index))

    def _emitter(self, index: UInt32) -> EmitterPtr:
        return EmitterPtr.into(Family(self.emitters, self.lookup), index)

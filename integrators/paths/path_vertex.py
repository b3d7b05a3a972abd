"""Vertices at which subpaths from lights and from the camera scatter light: on surfaces, and in media."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import (
    BSDFContext,
    BSDFFlags,
    BSDFSample3f,
    PhaseFunctionContext,
    Ray3f,
    Reference,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.core.records.interactions import MediumInteraction3f
from djpt.integrators.volpath import vertex_of
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.materials.base import BSDF, eval_pdf_light, sample_light
from djpt.materials.pointer import at_fixed_direction
from djpt.media.flight import of_channel
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["MediumVertex", "NextVertex", "PathVertex", "Scattering", "is_half_open", "next_vertex", "phase_evaluated"]


@dataclass
class MediumVertex:
    """The medium that scatters light at a vertex, on the lanes whose vertex is in one."""

    inside: Bool
    """True at vertices in a medium, else the vertex is on a surface."""
    medium: UInt32
    """The medium of the ray that has come there."""
    wi: Vector3f
    """The direction back along that ray, in world space."""


@dataclass
class Scattering:
    """The results of scattering at a vertex: a value for a given direction, and a sampled direction."""

    value: Color3f
    """f abs(cos) towards the given direction, or the phase function."""
    pdf: Float
    back: Float
    """The density of the way back: `BSDF.eval_pdf_both`."""
    sample: BSDFSample3f
    weight: Color3f
    back_of_sample: Float
    """The density of the way back from the sampled direction."""
    d: Vector3f | None = None
    """In media, the sampled direction in world space at vertices in one; None in scenes without."""


Evaluated = tuple[Color3f, Float, Float]
"""A value, the density of its direction, and that of the way back."""


@dataclass
class PathVertex:
    """A point where light is scattered."""

    si: SurfaceInteraction3f
    """The point; in media the fields of a surface mean nothing, but for the normal, which is 0."""
    medium_vertex: MediumVertex | None
    """None in scenes whose media don't scatter light."""

    @property
    def reference(self) -> Reference:
        """The vertex as the reference point of light sampling."""
        return Reference(self.si.p, self.si.n)

    def is_smooth(self) -> Bool:
        """True where other paths can be joined there."""
        smooth = has_flag(self.si.bsdf().flags(), BSDFFlags.Smooth)
        return smooth if self.medium_vertex is None else smooth | self.medium_vertex.inside

    def medium(self, nowhere: int) -> UInt32 | None:
        """The number of its medium, `nowhere` on surfaces; None in scenes whose media don't scatter light."""
        at = self.medium_vertex
        return None if at is None else dr.select(at.inside, at.medium, nowhere)

    def cos(self, d: Vector3f) -> Float:
        """The cosine of a direction with the normal, without its sign; 1 in media."""
        cos = dr.abs(dr.dot(self.si.n, d))
        return cos if self.medium_vertex is None else dr.select(self.medium_vertex.inside, 1, cos)

    def ray(self, d: Vector3f) -> Ray3f:
        """The ray that leaves in a world direction."""
        return self.in_medium(self.si.spawn_ray(d))

    def ray_to(self, p: Point3f) -> Ray3f:
        """The ray to another vertex, with maxt = 1."""
        return self.in_medium(self.si.spawn_ray_to(p))

    def in_medium(self, ray: Ray3f) -> Ray3f:
        """A ray that leaves the vertex, in its medium."""
        if self.medium_vertex is not None and ray.medium is not None:
            ray.medium = dr.select(self.medium_vertex.inside, self.medium_vertex.medium, ray.medium)
        return ray

    def direction(self, s: Scattering) -> Vector3f:
        """The sampled direction in world space."""
        d = self.si.to_world(s.sample.wo)
        return d if self.medium_vertex is None or s.d is None else dr.select(self.medium_vertex.inside, s.d, d)

    def passes(self, s: Scattering) -> Bool:
        """True where the sampled direction goes straight through a surface."""
        return self._on_surface() & has_flag(s.sample.sampled_type, BSDFFlags.Null)

    def _on_surface(self) -> Bool:
        valid = self.si.is_valid()
        return valid if self.medium_vertex is None else valid & ~self.medium_vertex.inside

    # ---- scattering --------------------------------------------------------------------

    def evaluate(self, scene: Scene, from_camera: bool, d: Vector3f) -> Evaluated:
        """The value f abs(cos) of a path from the camera, or its adjoint, and the densities of both ways."""
        wo = self.si.to_local(d)
        found: Evaluated = self.si.bsdf().visit(lambda bsdf: evaluated(bsdf, self.si, from_camera, wo, True))
        if self.medium_vertex is None:
            return found
        both: Evaluated = dr.select(self.medium_vertex.inside, self._of_phase(scene, d), found)
        return both

    def scatter(
        self, scene: Scene, from_camera: bool, d: Vector3f | None, sampler: SampleStream, active: Bool
    ) -> Scattering:
        """Evaluate towards a world direction and sample another one, with the densities of both ways.

        Without a direction the value means nothing.
        """
        wo = self.si.wi if d is None else self.si.to_local(d)
        sample1, sample2 = sampler.next_1d(), sampler.next_2d()
        on_surface = active if self.medium_vertex is None else active & ~self.medium_vertex.inside

        def method(bsdf: BSDF) -> tuple[Any, ...]:
            if from_camera:
                bs, weight = bsdf.sample(BSDFContext(), self.si, sample1, sample2, on_surface)
            else:
                bs, weight = sample_light(bsdf, self.si, sample1, sample2, on_surface)
            bs = dr.detach(bs)
            towards = evaluated(bsdf, self.si, from_camera, wo, on_surface)
            there, _, back = evaluated(bsdf, self.si, from_camera, bs.wo, on_surface)
            return (*towards, bs, at_fixed_direction(bs, weight, there), back)

        s = Scattering(*self.si.bsdf().visit(method, on_surface))
        if self.medium_vertex is None:
            return s
        return self._scattered_in_medium(scene, s, self.medium_vertex.wi if d is None else d, sample1, sample2)

    def _scattered_in_medium(
        self, scene: Scene, s: Scattering, d: Vector3f, sample1: Float, sample2: Point2f
    ) -> Scattering:
        """Scattering at a vertex: `s` on surfaces, by the phase function in media."""
        assert self.medium_vertex is not None
        inside, mei = self.medium_vertex.inside, medium_point(self.si.p, self.medium_vertex.wi)
        phase = scene.media.phases(self.medium_vertex.medium)
        wo, weight, pdf = phase.sample(PhaseFunctionContext(None), mei, sample1, sample2, inside)
        sample = BSDFSample3f.of(s.sample.wo, pdf, BSDFFlags.GlossyReflection)
        here = (*self._of_phase(scene, d), sample, weight, self._of_phase(scene, wo)[2])
        there = (s.value, s.pdf, s.back, s.sample, s.weight, s.back_of_sample)
        return Scattering(*dr.select(inside, here, there), wo)

    def _of_phase(self, scene: Scene, d: Vector3f) -> Evaluated:
        """The phase function towards a world direction, and the densities of both ways: it is the same for light."""
        medium_vertex = self.medium_vertex
        assert medium_vertex is not None
        return phase_evaluated(scene, medium_vertex.medium, self.si.p, medium_vertex.wi, d, medium_vertex.inside)


def phase_evaluated(scene: Scene, medium: UInt32, p: Point3f, wi: Vector3f, wo: Vector3f, active: Bool) -> Evaluated:
    """The phase function of a medium at a point, from a world direction to another, and the densities of both ways."""
    phase, ctx = scene.media.phases(medium), PhaseFunctionContext(None)
    value, pdf = phase.eval_pdf(ctx, medium_point(p, wi), wo, active)
    _, back = phase.eval_pdf(ctx, medium_point(p, wo), wi, active)
    return value, pdf, back


def medium_point(p: Point3f, wi: Vector3f) -> MediumInteraction3f:
    """A point in a medium, for light arriving from a direction."""
    return MediumInteraction3f.on(Ray3f(p, -wi), Float(0), p)


def evaluated(bsdf: BSDF, si: SurfaceInteraction3f, from_camera: bool, wo: Vector3f, active: Bool | bool) -> Evaluated:
    """The value f abs(cos) of a path from the camera, or its adjoint, and the densities of both ways."""
    if from_camera:
        return bsdf.eval_pdf_both(BSDFContext(), si, wo, active)
    return eval_pdf_light(bsdf, si, wo, active)


# ---- from vertex to vertex -------------------------------------------------------------------


@dataclass
class NextVertex:
    """The vertex that a ray has reached."""

    vertex: PathVertex
    transmittance: Color3f
    """Transmittance of media, over the density of having come that far."""
    emitted: Color3f | None
    """The light that media have added on the way; None if none of them glows."""
    length: Float
    """How far the ray reaches if nothing scatters it before: up to a surface, or to its end."""


def next_vertex(
    scene: Scene, ray: Ray3f, si: SurfaceInteraction3f, throughput: Color3f, sampler: SampleStream
) -> NextVertex:
    """The next vertex of a path on its way to the surface `si`: there, or before it in a medium.

    `throughput` is that of the path, by which media choose a channel.
    """
    if not scene.media.scatter:
        return NextVertex(PathVertex(si, None), scene.media.transmittance(ray, si.t), None, si.t)
    length = dr.select(si.is_valid(), si.t, ray.maxt)
    flight = scene.media.fly(ray, length, None, throughput, sampler)
    assert ray.medium is not None
    medium_vertex = MediumVertex(flight.scattered, ray.medium, -ray.d)
    transmittance = flight.value * dr.rcp(of_channel(flight.pdf, None))
    return NextVertex(
        PathVertex(vertex_of(ray, si, flight), medium_vertex),
        transmittance,
        flight.emitted if scene.media.emit else None,
        length,
    )


def is_half_open(scene: Scene) -> bool:
    """True if paths go straight through surfaces that scatter light, too, without a vertex."""
    return scene.media.scatter and any(
        has_flag(bsdf.flags(), BSDFFlags.Null) and has_flag(bsdf.flags(), BSDFFlags.Smooth)
        for bsdf in scene.bsdfs.plugins
    )

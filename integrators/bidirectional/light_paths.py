"""Paths that leave lights: how they begin, and the vertices that they leave for other paths to join."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import RAY_EPSILON, EmissionSample, EmitterFlags, Ray3f, SurfaceInteraction3f, has_flag
from djpt.core.records.record import Record
from djpt.emitters.pointer import EmitterPtr
from djpt.integrators.paths.path_vertex import MediumVertex, PathVertex
from djpt.jit.kernels import maximum
from djpt.jit.types import Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["CompactInteraction", "Departure", "LightVertex", "departure", "is_beam", "vertices"]


class CompactInteraction(Record):
    """The fields of a surface point that BSDFs and emitters look at.

    What nobody reads costs nothing: LLVM leaves it out.
    """

    p: Point3f
    n: Normal3f
    sh_frame: Frame3f
    uv: Point2f
    dp_du: Vector3f
    dp_dv: Vector3f
    prim_uv: Point2f
    wi: Vector3f
    face: UInt32
    shape_index: UInt32

    @staticmethod
    def fields_of(si: SurfaceInteraction3f) -> dict[str, Any]:
        """The fields that are kept of a surface point."""
        return {name: getattr(si, name) for name in SURFACE}

    def interaction(self, scene: Scene, media: tuple[UInt32, ...] = ()) -> SurfaceInteraction3f:
        """The surface point, with the medium of the ray that has met it, if that matters."""
        kept = {name: getattr(self, name) for name in SURFACE}
        si: SurfaceInteraction3f = SurfaceInteraction3f.holding(**kept, media=media, scene_ref={scene: ()})
        return si


SURFACE = tuple(CompactInteraction.DRJIT_STRUCT)


@dataclass
class Departure:
    """A ray that leaves an emitter."""

    o: Point3f
    """The origin, off the surface."""
    emitter: EmitterPtr
    inverse: Float
    """1 / the probability of choosing the emitter."""
    sample: EmissionSample

    def ray(self, scene: Scene) -> Ray3f:
        """The ray, in its medium."""
        return Ray3f(self.o, self.sample.ray.d, medium=scene.medium_at(self.o))


def departure(scene: Scene, sampler: SampleStream) -> Departure:
    """Choose an emitter, and sample a ray that leaves it."""
    index, inverse, _ = scene.lights.choice.choose(Point3f(0), None, sampler.next_1d())
    emitter = scene.emitter_ptr(index)
    es = emitter.sample_emission(sampler.next_2d(), sampler.next_2d())
    # Off the surface, along the ray, whichever side that is.
    a = dr.abs(es.ray.o)
    largest = maximum(maximum(a.x, a.y), a.z)
    o = dr.fma(es.ray.d, dr.fma(largest, RAY_EPSILON, RAY_EPSILON), es.ray.o)
    return Departure(o, emitter, inverse, es)


def is_beam(flags: Any) -> Any:
    """True if light leaves a surface in one direction only: flags are `EmitterFlags`."""
    return has_flag(flags, EmitterFlags.Surface) & has_flag(flags, EmitterFlags.DeltaDirection)


class LightVertex(CompactInteraction):
    """A vertex of a light path, as local memory keeps it: the surface point, and what arrives there."""

    flux: Color3f
    vcm: Float
    vc: Float
    depth: UInt32

    @staticmethod
    def at(path_vertex: PathVertex, flux: Color3f, vcm: Float, vc: Float, depth: UInt32) -> LightVertex:
        """The vertex where a light path of `depth` edges has arrived with a flux.

        For `vcm` and `vc` see `djpt.integrators.bidirectional.subpath.End`.
        """
        kept = CompactInteraction.fields_of(path_vertex.si)
        kind, medium_vertex = LightVertex, path_vertex.medium_vertex
        if medium_vertex is not None:
            kind = MediumLightVertex
            kept.update(medium=dr.select(medium_vertex.inside, medium_vertex.medium, NOWHERE), back=medium_vertex.wi)
        vertex: LightVertex = kind.holding(**kept, flux=flux, vcm=vcm, vc=vc, depth=depth)
        return vertex

    def vertex(self, scene: Scene) -> PathVertex:
        """The vertex as connections see it."""
        return PathVertex(self.interaction(scene), None)


class MediumLightVertex(LightVertex):
    """A vertex of a light path that may be a point in a medium."""

    medium: UInt32
    """The number of the medium; `NOWHERE` on surfaces."""
    back: Vector3f
    """The direction back along the ray, in world space."""

    def vertex(self, scene: Scene) -> PathVertex:
        plain = super().vertex(scene)
        inside = self.medium != NOWHERE
        return PathVertex(plain.si, MediumVertex(inside, dr.select(inside, self.medium, 0), self.back))


NOWHERE = 0xFFFFFFFF
"""The number of no medium."""


def vertices(scene: Scene, size: int) -> Any:
    """Local memory for some vertices of a light path."""
    return dr.alloc_local(MediumLightVertex if scene.media.scatter else LightVertex, size)

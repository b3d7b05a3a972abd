"""Paths that grow from a light and from the camera, and how they are weighted where they meet.

A path of k edges can be put together in many ways: s vertices from the light and t = k + 1 - s from the camera. The
sample of way s with density p_s counts with the weight

    w_s = h(p_s) / (sum over i of h(p_i)),    h(p) = p (balance heuristic) or p^2 (power heuristic).

Neighbouring densities differ by two factors only, p_(i+1) / p_i = (density of vertex i from the light) / (its density
from the camera), so both ends carry what the sum needs of their side: two numbers, which a vertex updates.

E. Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, chapter 10; the recursion is that of
I. Georgiev, "Implementing Vertex Connection and Merging", 2012, without merging.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import (
    RAY_EPSILON,
    BSDFFlags,
    EmissionSample,
    EmitterFlags,
    Ray3f,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.core.records.record import Record, of_scene
from djpt.emitters.pointer import EmitterPtr
from djpt.integrators.base import SMALL
from djpt.integrators.paths.path_vertex import MediumVertex, PathVertex, Scattering
from djpt.jit.kernels import maximum
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = [
    "CameraHit",
    "CameraLane",
    "CameraStep",
    "CompactInteraction",
    "Departure",
    "Lane",
    "LightHit",
    "LightStep",
    "LightVertex",
    "Subpath",
    "balance",
    "carried",
    "departure",
    "is_beam",
    "meeting",
    "mis_weight",
    "power",
    "scaled",
    "vertices",
    "with_derivative",
]

Heuristic = Callable[[Float], Float]


def balance(density: Float) -> Float:
    """The balance heuristic: strategies count by their densities."""
    return density


def power(density: Float) -> Float:
    """The power heuristic with the exponent 2."""
    return dr.square(density)


def mis_weight(others: Float) -> Float:
    """1 / (1 + others), `others` being the sum of h(density) over that of the strategy at hand; 0 if it is infinite."""
    return dr.select(others < dr.inf, dr.rcp(1 + others), 0)


def meeting(vcm: Float, vc: Float, density: Float, back: Float, h: Heuristic) -> Float:
    """The fraction of one side, whose last vertex has `vcm` and `vc`, in the sum of a weight.

    `density` is that of reaching this vertex from the other side, per unit area, and `back` that of going on from
    there to the vertex before it, per unit solid angle.
    """
    return h(density) * (vcm + vc * h(back))


@dataclass
class Subpath:
    """A path that grows from the camera or from a light, up to its last vertex."""

    ray: Ray3f
    """The next edge."""
    throughput: Color3f
    """Importance carried from the camera, or power from a light, over the density of the path."""
    vcm: Float
    """h(1 / density of the last vertex); at first times that of the vertex before, if that is sampled directly."""
    vc: Float
    """The sum of h(density ratio) over all strategies with fewer vertices on this side, over that of the last edge."""
    before: Float
    """Distance from the ray's origin back to the point where its directions part; inf if the rays are parallel."""
    eta: Float | None
    """Product of relative indices of refraction; None in scenes without refraction."""
    depth: UInt32
    """The number of edges, the next one included."""
    zero_weight: Color3f | None = None
    """While derivatives are replayed, the factor of each channel that was set aside, or 1: see `scaled`. Else None."""
    merging: Float | None = None
    """What mergings at the vertices of a light path would add to `vc`, if a camera path comes to them that merges; None
    if paths aren't merged."""
    merges: Bool | None = None
    """True if a camera path is merged along its last edge, and at its end; None if paths aren't merged."""

    def arrived(self, vertex: PathVertex, transmittance: Color3f, h: Heuristic) -> Subpath:
        """The subpath with the vertex that its ray has reached: densities are per unit area there.

        `transmittance` is what media have left.
        """
        cos = h(vertex.cos(self.ray.d))
        hit = vertex.si.is_valid()
        inverse = dr.rcp(dr.select(hit, cos, 1))
        distance = vertex.si.t + self.before
        spread = dr.select(hit & (self.before < dr.inf), h(dr.square(distance)), 1)
        return replace(
            self,
            throughput=self.throughput * transmittance,
            vcm=self.vcm * spread * inverse,
            vc=self.vc * inverse,
            merging=None if self.merging is None else self.merging * inverse,
        )

    def scattered(self, vertex: PathVertex, s: Scattering, throughput: Color3f, h: Heuristic) -> Subpath:
        """The subpath continued from a vertex by the scattering `s`, with the given throughput."""
        delta = has_flag(s.sample.sampled_type, BSDFFlags.Delta)
        return Subpath(
            ray=vertex.ray(vertex.direction(s)),
            throughput=throughput,
            vcm=dr.select(delta, 0, h(dr.rcp(s.sample.pdf))),
            vc=carried(self.vc, self.vcm, vertex, s, h),
            before=Float(0),
            eta=None if self.eta is None else self.eta * s.sample.eta,
            depth=self.depth + 1,
            zero_weight=self.zero_weight,
        )

    def passing(self, vertex: PathVertex, passes: Bool, other: Subpath) -> Subpath:
        """`other`, or where the path `passes` a surface as if it weren't there, the same edge continued."""
        return replace(
            other,
            vcm=dr.select(passes, self.vcm, other.vcm),
            vc=dr.select(passes, self.vc, other.vc),
            before=dr.select(passes, self.before + vertex.si.t, other.before),
            depth=dr.select(passes, self.depth, other.depth),
            merging=None if self.merging is None else dr.select(passes, self.merging, other.merging),
            merges=None if self.merges is None else dr.select(passes, self.merges, other.merges),
        )


def carried(ratios: Float, added: Float, vertex: PathVertex, s: Scattering, h: Heuristic) -> Float:
    """A sum of ratios of densities, such as `vc`, behind a scattering at a vertex, where `added` joins it."""
    cos = vertex.cos(vertex.direction(s))
    delta = has_flag(s.sample.sampled_type, BSDFFlags.Delta)
    # No strategy joins two vertices at a delta lobe, whose densities of both ways are equal.
    on = ratios * h(s.back_of_sample) + added
    return dr.select(delta, ratios * h(cos), h(cos * dr.rcp(s.sample.pdf)) * on)


def scaled(
    throughput: Color3f, zero_weight: Color3f | None, weight: Color3f, differs: Callable[[], Bool]
) -> tuple[Color3f, Color3f | None]:
    """A throughput times the weight of a vertex, and what is set aside of it.

    As in `PathState.weighted`, replays go on where a weight is 0 or too small to divide by: the first such factor of
    each channel is set aside where the vertex `differs`. The throughput keeps the derivative of the product.
    """
    product = throughput * weight
    if zero_weight is None or not dr.grad_enabled(weight):
        return product, zero_weight
    factor = dr.detach(weight)
    small = (zero_weight == 1) & (dr.abs(factor) < SMALL) & differs()
    value = dr.detach(throughput) * dr.select(small, 1, factor)
    return with_derivative(value, product), dr.select(small, factor, zero_weight)


def with_derivative(value: Color3f, other: Color3f) -> Color3f:
    """The colour `value` with the derivative of another one."""
    return dr.replace_grad(value, other)  # type: ignore[func-returns-value, return-value]


@dataclass
class Lane:
    """Loop state of either walk."""

    subpath: Subpath
    sampler: Any
    active: Bool
    vertices: Any
    """The vertices of the light path, in local memory."""
    count: UInt32
    """Their number."""


@dataclass
class CameraLane(Lane):
    """Loop state of the walk from the camera."""

    radiance: Color3f
    covered: Bool


@dataclass
class LightHit:
    """The next vertex of a light path, before light is scattered there."""

    vertex: PathVertex
    incoming: Subpath
    """The path before it has arrived."""
    subpath: Subpath
    """The path that has arrived."""
    flux: Color3f
    light_vertex: LightVertex
    """The fields that connections read."""
    joins: Bool
    """True where other paths can be joined to it."""
    active: Bool
    """True where there is something."""


@dataclass
class LightStep:
    """Scattering at a vertex of a light path. Colours are attached where the scene's values are, and not weighted."""

    position: Point2f
    """The place on the film that shows it, in [0, 1)^2 of the crop window."""
    shown: Color3f | None
    """The light that the film receives there; None from sensors that light can't be traced to."""
    weight: Float
    """The weight of `shown` against the other strategies."""
    subpath: Subpath
    """The continued path."""
    active: Bool
    """True where it does."""


@dataclass
class CameraHit:
    """The next vertex of a camera path, before light is scattered there. Colours are as in `LightStep`."""

    vertex: PathVertex
    incoming: Subpath
    """The path before it has arrived."""
    subpath: Subpath
    """The path that has arrived."""
    emitted: Color3f | None
    """The light that media have added on the way, and that other paths have left here; None if there is neither."""
    met: Color3f
    """The emission that the path has hit."""
    weight: Float
    """The weight of `met` against the other strategies."""
    joins: Bool
    """True where light paths can be joined to the vertex."""
    active: Bool
    """True where there is something, and an edge left to go on from it."""


@dataclass
class CameraStep:
    """Scattering at a vertex of a camera path, without connections. Colours are as in `LightStep`."""

    scattering: Scattering
    lit: Color3f
    """The light of the light sample."""
    weight: Float
    """The weight of `lit` against the other strategies."""
    covers: Bool
    """True where there is a surface that the path doesn't pass straight through."""


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
        """The surface point, with the medium of the ray that has hit it, if needed."""
        kept = {name: getattr(self, name) for name in SURFACE}
        si: SurfaceInteraction3f = SurfaceInteraction3f.holding(**kept, media=media, scene_ref=of_scene(scene))
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
    merging: Float
    """These three are those of the `Subpath`; `merging` is 0 if paths aren't merged."""
    depth: UInt32

    @staticmethod
    def at(path_vertex: PathVertex, flux: Color3f, subpath: Subpath) -> LightVertex:
        """The vertex where a light path has arrived with a flux."""
        kept = CompactInteraction.fields_of(path_vertex.si)
        kind, medium_vertex = LightVertex, path_vertex.medium_vertex
        if medium_vertex is not None:
            kind = MediumLightVertex
            kept.update(medium=dr.select(medium_vertex.inside, medium_vertex.medium, NOWHERE), back=medium_vertex.wi)
        vertex: LightVertex = kind.holding(
            **kept,
            flux=flux,
            vcm=subpath.vcm,
            vc=subpath.vc,
            merging=Float(0) if subpath.merging is None else subpath.merging,
            depth=subpath.depth,
        )
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

"""The records that flow between plugins: rays, intersections, samples.

All are dataclasses of Dr.Jit arrays, so they can be loop state, gathered and selected.
Directions named `wi` and `wo` are in the local shading frame and point away from the
surface; everything else is in world space unless a field says otherwise.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import drjit as dr

from djpt.frame import Frame3f
from djpt.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f

__all__ = [
    "ALL_COMPONENTS",
    "BSDFContext",
    "BSDFFlags",
    "BSDFSample3f",
    "DirectionSample3f",
    "EmissionSample",
    "EmitterFlags",
    "PositionSample3f",
    "PreliminaryIntersection3f",
    "Ray3f",
    "Reference",
    "SceneView",
    "SurfaceInteraction3f",
    "TransportMode",
    "has_flag",
]

RAY_EPSILON = 1500 * 2.0**-24
"""Offset of a spawned ray along the normal, relative to 1 + the largest coordinate (Mitsuba's value)."""

SHADOW_EPSILON = 10 * RAY_EPSILON
"""A shadow ray stops short of the light by this share of its length."""


class BSDFFlags(enum.IntFlag):
    """Properties of a BSDF's lobes; the values are Mitsuba's."""

    Empty = 0x0
    Null = 0x1
    DiffuseReflection = 0x2
    DiffuseTransmission = 0x4
    GlossyReflection = 0x8
    GlossyTransmission = 0x10
    DeltaReflection = 0x20
    DeltaTransmission = 0x40
    Anisotropic = 0x1000
    SpatiallyVarying = 0x2000
    NonSymmetric = 0x4000
    FrontSide = 0x8000
    BackSide = 0x10000
    Reflection = 0xAA
    Transmission = 0x155
    Diffuse = 0x6
    Glossy = 0x18
    Smooth = 0x1E
    Delta = 0x61
    All = 0x1FF


class EmitterFlags(enum.IntFlag):
    """Properties of an emitter; the values are Mitsuba's."""

    Empty = 0x0
    DeltaPosition = 0x1
    DeltaDirection = 0x2
    Delta = 0x3
    Infinite = 0x4
    Surface = 0x8
    SpatiallyVarying = 0x10


def has_flag(flags: Any, flag: int) -> Any:
    """True where `flags` shares a bit with `flag`; works on ints and on `UInt32`."""
    return (flags & int(flag)) != 0


class TransportMode(enum.IntEnum):
    """The quantity that a path carries."""

    Radiance = 0
    Importance = 1


ALL_COMPONENTS = 0xFFFFFFFF
"""The value of `BSDFContext.component` that stands for all lobes."""


@dataclass
class BSDFContext:
    """What BSDFs are asked for: the direction of transport, and lobes.

    It is structure: kernels are traced for it.
    """

    mode: TransportMode = TransportMode.Radiance
    """From the camera (radiance) or from the light (importance)."""
    type_mask: int = int(BSDFFlags.All)
    """The `BSDFFlags` of the lobes that are asked for."""
    component: int = ALL_COMPONENTS
    """The number of the only lobe that is asked for; by default all are."""

    def __post_init__(self) -> None:
        self.mode, self.type_mask = TransportMode(int(self.mode)), int(self.type_mask)
        self.component = ALL_COMPONENTS if self.component is None else int(self.component) & ALL_COMPONENTS

    @property
    def asks_for_all(self) -> bool:
        """Whether no lobe is left out."""
        return self.component == ALL_COMPONENTS and not int(BSDFFlags.All) & ~self.type_mask

    def is_enabled(self, type: BSDFFlags | int, component: int = 0) -> bool:
        """Whether the lobe number `component`, of the type `type`, is asked for."""
        return not int(type) & ~self.type_mask and self.component in (ALL_COMPONENTS, component)

    def of_part(self, first: int) -> BSDFContext:
        """The context for a nested BSDF whose lobes are numbered from `first` on in the BSDF around it."""
        return self if self.component == ALL_COMPONENTS else replace(self, component=self.component - first)

    def reverse(self) -> None:
        """Turn the direction of transport round."""
        self.mode = TransportMode(1 - self.mode)


@dataclass
class Ray3f:
    """o + t d for 0 < t < maxt. `d` need not have unit length; `maxt` is in units of it."""

    o: Point3f = field(default_factory=lambda: Point3f(0))
    d: Vector3f = field(default_factory=lambda: Vector3f(0, 0, 1))
    maxt: Float = field(default_factory=lambda: Float(dr.inf))
    medium: UInt32 | None = None
    """The number of the medium that the ray runs through: see `djpt.media`. None in scenes without media."""

    def __call__(self, t: Float) -> Point3f:
        """The point at parameter `t`."""
        return dr.fma(self.d, t, self.o)


@dataclass
class PreliminaryIntersection3f:
    """The result of a traversal: enough to compute the rest later."""

    t: Float
    """Distance in units of the ray's `d`; infinity on a miss."""
    face: UInt32
    """The scene's own number of the face that was hit: see `Scene`."""
    shape_index: UInt32
    """Index into ``scene.shapes()``; 0 on a miss."""
    prim_index: UInt32 | None = None
    """The triangle within its shape, as Mitsuba counts; 0 for shapes that aren't made of triangles."""
    prim_uv: Point2f | None = None
    """Barycentric weights of the second and third corner of a mesh's triangle; 0 for other shapes."""
    near: Any = None
    """The hit in the coordinates of the search for triangles: see `djpt.geometry.query.Near`."""

    def is_valid(self) -> Bool:
        """True where something was hit."""
        return self.t < dr.inf


@dataclass
class Reference:
    """A point that light is sampled for."""

    p: Point3f
    n: Vector3f | None
    """The geometric normal of the surface there, of either sign; None if the choice of emitters doesn't look at it."""


class SceneView(Protocol):
    """The scene as a surface point sees it."""

    def bsdf_at(self, si: SurfaceInteraction3f) -> Any:
        """The `djpt.dispatch.pointers.BSDFPtr` of the shape at `si`."""

    def emitter_at(self, si: SurfaceInteraction3f) -> Any:
        """The `djpt.dispatch.pointers.EmitterPtr` of what shines at `si`: the shape, or the environment on a miss."""

    def emitter_index_at(self, si: SurfaceInteraction3f) -> UInt32:
        """The number of the emitter seen at `si`; the count of emitters means none."""

    def primitive_index(self, si: SurfaceInteraction3f) -> UInt32:
        """The primitive of its shape that `si` lies on, as Mitsuba counts."""

    def medium_beyond(self, si: SurfaceInteraction3f, d: Vector3f) -> UInt32 | None:
        """The medium of a ray that leaves `si` in the world direction `d`."""


@dataclass
class SurfaceInteraction3f:
    """A point on a surface with its frame, and the way back to its shape, BSDF and emitter."""

    t: Float
    p: Point3f
    n: Normal3f
    """Geometric normal, unit length, on the outer side of the shape (never flipped to the ray)."""
    sh_frame: Frame3f
    """Shading frame: `n` is the shading normal, `s` follows dp/du."""
    uv: Point2f
    dp_du: Vector3f
    dp_dv: Vector3f
    wi: Vector3f
    """Direction back along the ray, in the shading frame; the world direction on a miss."""
    shape_index: UInt32
    """Index into ``scene.shapes()``; 0 on a miss."""
    face: UInt32
    """The scene's own number of the face: see `Scene`."""
    valid: Bool
    scene: Any = None
    medium: UInt32 | None = None
    """The medium of the ray that arrived; None in scenes without media."""
    prim_uv: Point2f | None = None
    """Barycentric weights of the second and third corner of a mesh's triangle; 0 on other shapes."""

    @property
    def prim_index(self) -> UInt32:
        """The triangle within its shape, as Mitsuba counts; 0 for shapes that aren't made of triangles."""
        return self.scene.primitive_index(self)

    @property
    def shape(self) -> UInt32:
        """Mitsuba's name for `shape_index`."""
        return self.shape_index

    def is_valid(self) -> Bool:
        """True where the ray hit a surface."""
        return self.valid

    def to_local(self, v: Vector3f) -> Vector3f:
        """World direction to the shading frame."""
        return self.sh_frame.to_local(v)

    def to_world(self, v: Vector3f) -> Vector3f:
        """Shading frame to world."""
        return self.sh_frame.to_world(v)

    def offset_p(self, d: Vector3f) -> Point3f:
        """The point moved off the surface, to the side that `d` points to.

        The step is RAY_EPSILON (1 + max abs(p)) along the geometric normal, as in Mitsuba.
        """
        a = dr.abs(self.p)
        largest = dr.select(a.x > a.y, a.x, a.y)
        largest = dr.select(largest > a.z, largest, a.z)
        step = dr.fma(largest, RAY_EPSILON, RAY_EPSILON)
        return dr.fma(self.n, dr.mulsign(step, dr.dot(self.n, d)), self.p)

    def spawn_ray(self, d: Vector3f) -> Ray3f:
        """An unbounded ray that leaves the surface in direction `d`."""
        return Ray3f(self.offset_p(d), d, Float(dr.inf), self.target_medium(d))

    def spawn_ray_to(self, target: Point3f) -> Ray3f:
        """The segment to `target`: `d` is not normalised, `maxt` is just short of 1."""
        o = self.offset_p(target - self.p)
        return Ray3f(o, target - o, Float(1 - SHADOW_EPSILON), self.target_medium(target - self.p))

    def target_medium(self, d: Vector3f) -> UInt32 | None:
        """The medium of a ray that leaves the surface in the world direction `d`; None in scenes without media."""
        return None if self.medium is None else self.scene.medium_beyond(self, d)

    def bsdf(self, ray: Ray3f | None = None) -> Any:
        """The BSDF at this point, a `djpt.dispatch.pointers.BSDFPtr` (`ray` is accepted for Mitsuba's signature)."""
        return self.scene.bsdf_at(self)

    def emitter(self, scene: SceneView | None = None, active: Bool | bool = True) -> Any:
        """The light of the shape, or of the sky on a miss; a null `djpt.dispatch.pointers.EmitterPtr` without one."""
        return (scene or self.scene).emitter_at(self)


@dataclass
class PositionSample3f:
    """A point sampled on a surface; `pdf` is per unit area."""

    p: Point3f
    n: Normal3f
    uv: Point2f
    pdf: Float


@dataclass
class DirectionSample3f:
    """A point on an emitter as seen from a reference point; `pdf` is per unit solid angle there.

    `weight` is 1 / pdf (0 where pdf is 0). Emitters fill in both, since most of them know both
    without a division.
    """

    p: Point3f
    n: Normal3f
    uv: Point2f
    d: Vector3f
    """Unit direction from the reference point to `p`."""
    dist: Float
    pdf: Float
    weight: Float
    delta: Bool
    """True where the emitter can't be hit by chance (a point light): MIS weight 1."""
    emitter_index: UInt32

    @staticmethod
    def between(ref: Point3f, ray: Ray3f, si: SurfaceInteraction3f) -> DirectionSample3f:
        """The hit of a ray described as if its emitter had been sampled from `ref`.

        `ray` started at `ref`, moved off the surface there. `pdf` and `weight` are left at 0; `n` is
        the normal of the side that shines.
        """
        index = si.scene.emitter_index_at(si)
        to_p = si.p - ref
        dist_squared = dr.squared_norm(to_p)
        inv_dist = dr.rsqrt(dist_squared)
        # On a miss the emitter is the environment, known by its direction alone.
        d = dr.select(si.valid, to_p * inv_dist, ray.d)
        return DirectionSample3f(
            si.p, si.sh_frame.n, si.uv, d, dist_squared * inv_dist, Float(0), Float(0), Bool(False), index
        )


@dataclass
class EmissionSample:
    """A ray that leaves an emitter, and the two densities that it was drawn with.

        weight = radiance cos / (pdf_position pdf_direction)

    In place of radiance cos, lights at a point have their intensity (W sr^-1), and lights of a single direction
    their power per area (W m^-2). The probability of choosing the emitter isn't included.
    """

    ray: Ray3f
    """From the emitter, without an offset from its surface. `d` has unit length."""
    weight: Color3f
    """Its mean is the emitter's power."""
    n: Normal3f
    """Normal of the side that shines; the ray's direction for light from a point or from infinity."""
    uv: Point2f
    """Texture coordinates at the ray's origin; those of the picture that a light throws or shows; else 0."""
    cos: Float
    """Cosine between the ray and `n`: 1 for light from a point or from infinity."""
    pdf_position: Float
    """Per unit area of the surface; across the ray for light from infinity; 1 for light from a point."""
    pdf_direction: Float
    """Per unit solid angle; 1 for light that leaves each point in one direction only."""
    finite: Bool
    """False for light from infinity: its rays start somewhere outside of the scene."""
    delta: Bool
    """True where position or direction has a delta distribution, whose density is given as 1."""


@dataclass
class BSDFSample3f:
    """A direction sampled from a BSDF; without arguments, a sample without a direction.

    In scripts, fields may be given Python numbers: the engine converts them.
    """

    wo: Vector3f = field(default_factory=lambda: Vector3f(0))
    """Sampled direction in the shading frame."""
    pdf: Float = field(default_factory=lambda: Float(0))
    """Density per unit solid angle; for a delta lobe the probability of choosing it."""
    eta: Float = field(default_factory=lambda: Float(1))
    """Relative index of refraction crossed, 1 for reflection."""
    sampled_type: UInt32 = field(default_factory=lambda: UInt32(0))
    """`BSDFFlags` of the lobe that was sampled."""
    sampled_component: UInt32 = field(default_factory=lambda: UInt32(0))

    @staticmethod
    def of(
        wo: Vector3f,
        pdf: Float | float,
        sampled_type: UInt32 | int,
        *,
        eta: Float | float = 1,
        sampled_component: UInt32 | int = 0,
    ) -> BSDFSample3f:
        """A sample of the lobe `sampled_type` (`BSDFFlags`), from numbers or Dr.Jit arrays."""
        return BSDFSample3f(wo, Float(pdf), Float(eta), UInt32(sampled_type), UInt32(sampled_component))

    @staticmethod
    def none() -> BSDFSample3f:
        """A sample without a direction: `wo` and `pdf` are 0."""
        return BSDFSample3f()

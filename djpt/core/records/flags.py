"""The flags and settings of queries; the values of flags are Mitsuba's."""

from __future__ import annotations

import copy
import enum
from dataclasses import dataclass
from typing import Any, TypeVar

__all__ = [
    "ALL_COMPONENTS",
    "BSDFContext",
    "BSDFFlags",
    "DiscontinuityFlags",
    "EmitterFlags",
    "PhaseFunctionContext",
    "PhaseFunctionFlags",
    "RayFlags",
    "SurfaceDetail",
    "TransportMode",
    "has_flag",
]


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
    Delta1D = 0x180
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


class PhaseFunctionFlags(enum.IntFlag):
    """Properties of a phase function; the values are Mitsuba's."""

    Empty = 0x0
    Isotropic = 0x1
    """The density is the same in all directions."""
    Anisotropic = 0x2
    Microflake = 0x4
    """Extinction, too, depends on the direction: see `djpt.phase.PhaseFunction.projected_area`."""


class RayFlags(enum.IntFlag):
    """The fields of a surface interaction that are computed, and what their derivatives follow; Mitsuba's values.

    djpt computes the fields of `All` whatever is asked for, since Dr.Jit drops what isn't used.
    """

    Empty = 0x0
    Minimal = 0x1
    UV = 0x2
    dPdUV = 0x4
    ShadingFrame = 0x8
    dNGdUV = 0x10
    dNSdUV = 0x20
    FollowShape = 0x80
    """The point moves with the shape, whatever the ray does: its derivative with respect to the ray is 0."""
    DetachShape = 0x100
    """Derivatives with respect to the shape are left out; those with respect to the ray stay."""
    All = 0xE
    AllNonDifferentiable = 0x10E
    Shading = 0xE
    """The name of `All` in Mitsuba after 3.9."""
    Default = 0xE
    """Another one."""
    NormalPartials = 0x20
    """The name of `dNSdUV` there."""


class SurfaceDetail(enum.IntEnum):
    """The parts of a surface point that are computed; each includes those before."""

    FRAME = 0
    """The place, the normals and the shading frame; dp/du without its length."""
    UV = 1
    """uv as well."""
    PARTIALS = 2
    """dp/du and dp/dv as well."""


class DiscontinuityFlags(enum.IntFlag):
    """Kinds of visibility silhouettes, and how their directions are encoded; the values are Mitsuba's."""

    Empty = 0x0
    PerimeterType = 0x1
    """Edges: where a surface ends, or its normal jumps."""
    InteriorType = 0x2
    """Silhouettes of smooth surfaces, where they turn away from the viewer."""
    DirectionLune = 0x4
    """Directions at an edge are those in which one of its two faces is seen from the front."""
    DirectionSphere = 0x8
    """Directions at an edge are all."""
    HeuristicWalk = 0x10
    """Projections onto a mesh go on to a neighbouring triangle, most likely where the surface turns away."""
    Creases = 0x20
    """Also edges of whose faces both are seen, if shading jumps there; not in Mitsuba."""
    AllTypes = 0x3


def has_flag(flags: Any, flag: int) -> Any:
    """True where `flags` shares a bit with `flag`; works on ints and on `UInt32`."""
    return (flags & int(flag)) != 0


class TransportMode(enum.IntEnum):
    """The quantity that a path carries."""

    Radiance = 0
    Importance = 1


ALL_COMPONENTS = 0xFFFFFFFF
"""The value of `BSDFContext.component` that stands for all lobes."""

ALL_PHASE_FUNCTIONS = 0x7
"""The value of `PhaseFunctionContext.type_mask` that leaves out no component."""


C = TypeVar("C", bound="ComponentContext")


class ComponentContext:
    """A query of plugins with several components: the direction of transport, and components."""

    mode: TransportMode
    type_mask: int
    component: int

    def __post_init__(self) -> None:
        self.mode, self.type_mask = TransportMode(int(self.mode)), int(self.type_mask)
        self.component = ALL_COMPONENTS if self.component is None else int(self.component) & ALL_COMPONENTS

    def of_part(self: C, first: int) -> C:
        """The context for a nested plugin whose components are numbered from `first` on in the one around it."""
        if self.component == ALL_COMPONENTS:
            return self
        part = copy.copy(self)
        part.component = self.component - first & ALL_COMPONENTS
        return part

    def reverse(self) -> None:
        """Turn the direction of transport round."""
        self.mode = TransportMode(1 - self.mode)


@dataclass
class BSDFContext(ComponentContext):
    """A query of BSDFs: the direction of transport, and lobes.

    It is structure: kernels are traced for it.
    """

    mode: TransportMode = TransportMode.Radiance
    """From the camera (radiance) or from the light (importance)."""
    type_mask: int = int(BSDFFlags.All)
    """The `BSDFFlags` of the lobes that are asked for."""
    component: int = ALL_COMPONENTS
    """The number of the only lobe that is asked for; by default all are."""

    @property
    def asks_for_all(self) -> bool:
        """True if no lobe is left out."""
        return self.component == ALL_COMPONENTS and not int(BSDFFlags.All) & ~self.type_mask

    def is_enabled(self, type: BSDFFlags | int, component: int = 0) -> bool:
        """True if the lobe number `component`, of the type `type`, is asked for."""
        return not int(type) & ~self.type_mask and self.component in (ALL_COMPONENTS, component)


@dataclass
class PhaseFunctionContext(ComponentContext):
    """A query of phase functions: the direction of transport, and components.

    It is structure: kernels are traced for it.
    """

    sampler: Any = None
    """A source of further random numbers, for the phase functions of scripts; djpt's own need none."""
    mode: TransportMode = TransportMode.Radiance
    """From the camera (radiance) or from the light (importance)."""
    type_mask: int = ALL_PHASE_FUNCTIONS
    """The `PhaseFunctionFlags` of the components that are asked for."""
    component: int = ALL_COMPONENTS
    """The number of the only component that is asked for; by default all are."""

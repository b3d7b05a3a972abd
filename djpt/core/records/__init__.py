"""The records that flow between plugins: rays, intersections, samples.

All are structures of Dr.Jit arrays, so they can be loop state, gathered and selected.
Directions named `wi` and `wo` are in the local shading frame and point away from the
surface; everything else is in world space unless a field says otherwise.
"""

from djpt.core.records.flags import (
    ALL_COMPONENTS,
    BSDFContext,
    BSDFFlags,
    DiscontinuityFlags,
    EmitterFlags,
    PhaseFunctionContext,
    PhaseFunctionFlags,
    RayFlags,
    SurfaceDetail,
    TransportMode,
    has_flag,
)
from djpt.core.records.interactions import (
    GRAZING,
    RAY_EPSILON,
    SHADOW_EPSILON,
    Interaction3f,
    Observer,
    PreliminaryIntersection3f,
    Reference,
    SceneView,
    SurfaceInteraction3f,
)
from djpt.core.records.rays import Ray3f
from djpt.core.records.record import Record
from djpt.core.records.samples import BSDFSample3f, DirectionSample3f, EmissionSample, PositionSample3f

__all__ = [
    "ALL_COMPONENTS",
    "GRAZING",
    "RAY_EPSILON",
    "SHADOW_EPSILON",
    "BSDFContext",
    "BSDFFlags",
    "BSDFSample3f",
    "DirectionSample3f",
    "DiscontinuityFlags",
    "EmissionSample",
    "EmitterFlags",
    "Interaction3f",
    "Observer",
    "PhaseFunctionContext",
    "PhaseFunctionFlags",
    "PositionSample3f",
    "PreliminaryIntersection3f",
    "Ray3f",
    "RayFlags",
    "Record",
    "Reference",
    "SceneView",
    "SurfaceDetail",
    "SurfaceInteraction3f",
    "TransportMode",
    "has_flag",
]

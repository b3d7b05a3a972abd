"""Parallel light from a surface."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import DirectionSample3f, EmissionSample, EmitterFlags, Observer, Ray3f
from djpt.description.registry import register_emitter
from djpt.emitters.area import SurfaceEmitter
from djpt.emitters.base import DeltaEmitter, beam
from djpt.emitters.extent import require_area
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, UInt32, Vector3f

__all__ = ["DirectionalArea"]


class DirectionalArea(DeltaEmitter, SurfaceEmitter):
    """Light that leaves the shape that the emitter is nested in along its normals, and in no other direction.

    Parameters: `radiance` (texture, default 1, not negative): what a unit of area sends out, in W m^-2 (Mitsuba's
    name for it is kept).

    No ray from a camera or surface point meets the surface head-on, so `eval` and `sample_direction` give 0, as in
    Mitsuba: only rays from lights (`sample_emission`) show it.
    """

    in_any_frame = True
    m_flags = int(EmitterFlags.Surface | EmitterFlags.DeltaDirection)
    spread, emitted = 0.0, 1.0

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        d = Vector3f(0, 0, 1)
        ds = DirectionSample3f.of(it.p + d, -d, Point2f(0), d, Float(1), Float(0), Float(0), Bool(False), UInt32(0))
        return ds, Color3f(0)

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        require_area(self.shape)
        ps = self.shape.draw_point(position_sample)
        weight = self.radiance.eval(ps, active) * self.shape.surface_area()
        return beam(Ray3f(ps.p, ps.n), weight, ps.pdf, Float(1), ps.uv, finite=True, delta=True)

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        require_area(self.shape)
        return dr.rcp(self.shape.surface_area()), Float(1)


register_emitter("directionalarea", DirectionalArea)

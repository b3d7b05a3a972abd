"""Parallel light from a surface."""

from __future__ import annotations

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import DirectionSample3f, EmissionSample, EmitterFlags, Observer, Ray3f, SurfaceInteraction3f
from djpt.description.allowed import LARGEST
from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_emitter
from djpt.emitters.base import Emitter, LightBounds
from djpt.emitters.extent import area_of, mean_of, normals_of, require_area
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, UInt32, Vector3f

__all__ = ["DirectionalArea"]


class DirectionalArea(Emitter):
    """Light that leaves the shape that the emitter is nested in along its normals, and in no other direction.

    Parameters: `radiance` (texture, default 1, not negative): what a unit of area sends out, in W m^-2 (Mitsuba's
    name for it is kept).

    No ray from a camera or surface point meets the surface head-on, so `eval` and `sample_direction` give 0, as in
    Mitsuba: only rays from lights (`sample_emission`) show it.
    """

    in_any_frame = True
    children = ("radiance", "shape")
    on_shape = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if "to_world" in props:
            raise SceneError(f"{props.node}: an area light has no 'to_world'; move the shape that carries it")
        self.radiance = props.texture("radiance", 1.0, low=0.0, high=LARGEST)

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.share, attribute="share")
        callback.put("radiance", self.radiance)

    # ---- on the host -------------------------------------------------------------------

    def flags(self, active: Bool | bool = True) -> int:
        return int(EmitterFlags.Surface | EmitterFlags.DeltaDirection)

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        self._scene = (center - radius, center + radius)

    def power(self) -> float:
        return mean_of(self.radiance) * area_of(self.shape, self._scene)

    def bounds(self) -> LightBounds:
        low, high = self.shape.world_box()
        return LightBounds(low, high, *normals_of(self.shape), 0.0, self.power())

    # ---- in kernels --------------------------------------------------------------------

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return Color3f(0)

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        d = Vector3f(0, 0, 1)
        ds = DirectionSample3f.of(it.p + d, -d, Point2f(0), d, Float(1), Float(0), Float(0), Bool(False), UInt32(0))
        return ds, Color3f(0)

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        return Float(0)

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        require_area(self.shape)
        ps = self.shape.draw_point(position_sample)
        return EmissionSample(
            ray=Ray3f(ps.p, ps.n),
            weight=self.radiance.eval(ps, active) * self.shape.surface_area(),
            n=ps.n,
            uv=ps.uv,
            cos=Float(1),
            pdf_position=ps.pdf,
            pdf_direction=Float(1),
            finite=Bool(True),
            delta=Bool(True),
        )

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        require_area(self.shape)
        return dr.rcp(self.shape.surface_area()), Float(1)


register_emitter("directionalarea", DirectionalArea)

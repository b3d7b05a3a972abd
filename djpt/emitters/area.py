"""Light from a shape's surface."""

from __future__ import annotations

import drjit as dr

from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.emitters.base import Emitter
from djpt.errors import SceneError
from djpt.records import DirectionSample3f, EmitterFlags, SurfaceInteraction3f
from djpt.types import Bool, Color3f, Float, Point2f, Point3f

__all__ = ["Area"]


class Area(Emitter):
    """Diffuse emission from the side of the normal of the shape that the emitter is nested in.

    Parameters: `radiance` (texture, W m^-2 sr^-1, default 1, not negative).
    """

    children = ("radiance", "shape")
    on_shape = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if "to_world" in props:
            raise SceneError(f"{props.node}: an area light has no 'to_world'; move the shape that carries it")
        self.radiance = props.texture("radiance", 1.0, low=0.0)

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.sampling_weight)
        callback.put("radiance", self.radiance)

    def flags(self) -> int:
        return int(EmitterFlags.Surface)

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return dr.select(si.wi.z > 0, self.radiance.eval(si, active), 0)

    def sample_direction(
        self, ref: Point3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        ds = self.shape.sample_direction(ref, sample)
        weight = dr.select(dr.dot(ds.d, ds.n) < 0, ds.weight, 0)
        return ds, self.radiance.eval(ds, active) * weight

    def pdf_direction(self, ref: Point3f, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        return dr.select(dr.dot(ds.d, ds.n) < 0, self.shape.pdf_direction(ref, ds), 0)

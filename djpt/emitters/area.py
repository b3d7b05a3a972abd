"""Light from a shape's surface."""

from __future__ import annotations

import math

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_emitter
from djpt.emitters.base import Emitter
from djpt.emitters.bounds import LightBounds
from djpt.emitters.extent import area_of, box_of, mean_of, normals_of
from djpt.errors import SceneError
from djpt.frame import Frame3f
from djpt.records import DirectionSample3f, EmitterFlags, PositionSample3f, Ray3f, SurfaceInteraction3f
from djpt.shapes.base import towards
from djpt.types import Bool, Color3f, Float, Point2f, Point3f
from djpt.warp import square_to_cosine_hemisphere

__all__ = ["Area"]


class Area(Emitter):
    """Diffuse emission from the side of the normal of the shape that the emitter is nested in.

    Parameters: `radiance` (texture, W m^-2 sr^-1, default 1, not negative).

    Radiance that varies is sampled by what it is, if the shape is known by its uv (`Shape.has_parameterization`):
    uv where the texture is bright, then the point there,

        pdf = p(uv) / norm(dp/du x dp/dv) dist^2 / cos.

    On other shapes, such as meshes, points are drawn as for constant radiance, and weighted by the texture.
    """

    children = ("radiance", "shape")
    on_shape = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if "to_world" in props:
            raise SceneError(f"{props.node}: an area light has no 'to_world'; move the shape that carries it")
        self.radiance = props.texture("radiance", 1.0, low=0.0)
        self.radiance.prepare_sampling()

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.sampling_weight)
        callback.put("radiance", self.radiance)

    def flags(self) -> int:
        return int(EmitterFlags.Surface)

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        self._scene = (center - radius, center + radius)

    def power(self) -> float:
        return math.pi * mean_of(self.radiance) * area_of(self.shape, self._scene)

    def bounds(self) -> LightBounds:
        return LightBounds(*box_of(self.shape), *normals_of(self.shape), math.pi / 2, self.power())

    @property
    def follows_texture(self) -> bool:
        """Are points drawn by the radiance, not by the shape?"""
        return not self.radiance.is_constant and self.shape.has_parameterization

    def _sample_texture(self, sample: Point2f) -> tuple[PositionSample3f, Float]:
        """A point where the texture is bright, and 1 / (its density per unit area)."""
        uv, pdf = self.radiance.sample_position(sample)
        ps = self.shape.eval_parameterization(uv)
        ps.pdf *= pdf
        return ps, dr.select(ps.pdf > 0, dr.rcp(ps.pdf), 0)

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return dr.select(si.wi.z > 0, self.radiance.eval(si, active), 0)

    def sample_direction(
        self, ref: Point3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        if self.follows_texture:
            ps, inverse_pdf = self._sample_texture(sample)
            ds = towards(ps, inverse_pdf, ref)
        else:
            ds = self.shape.sample_direction(ref, sample)
        weight = dr.select(dr.dot(ds.d, ds.n) < 0, ds.weight, 0)
        return ds, self.radiance.eval(ds, active) * weight

    def pdf_direction(self, ref: Point3f, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        if not self.follows_texture:
            return dr.select(dr.dot(ds.d, ds.n) < 0, self.shape.pdf_direction(ref, ds), 0)
        pdf = self.radiance.pdf_position(ds.uv) * self.shape.eval_parameterization(ds.uv).pdf
        pdf *= dr.square(ds.dist) * dr.rcp(self.shape.cosine(ds))
        return dr.select((dr.dot(ds.d, ds.n) < 0) & dr.isfinite(pdf), pdf, 0)

    def sample_ray(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        if not self.shape.has_area:
            raise SceneError(f"{self.shape.id}: no rays can be drawn from this shape, since its area isn't known")
        if self.follows_texture:
            ps, inverse_pdf = self._sample_texture(position_sample)
        else:
            ps, inverse_pdf = self.shape.sample_position(position_sample), self.shape.surface_area()
        d = Frame3f.from_normal(ps.n).to_world(square_to_cosine_hemisphere(direction_sample))
        # Cosine and density leave pi.
        return Ray3f(ps.p, d), self.radiance.eval(ps, active) * (math.pi * inverse_pdf)


register_emitter("area", Area)

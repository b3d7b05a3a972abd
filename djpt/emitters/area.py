"""Light from a shape's surface."""

from __future__ import annotations

import math
from typing import ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f
from djpt.core.records import (
    DirectionSample3f,
    EmissionSample,
    EmitterFlags,
    Observer,
    PositionSample3f,
    Ray3f,
    SurfaceInteraction3f,
)
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.plugin import TraversalCallback
from djpt.description.properties import LARGEST, Properties
from djpt.description.registry import register_emitter
from djpt.emitters.base import Emitter, LightBounds
from djpt.emitters.extent import area_of, mean_of, normals_of, require_area
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Vector3f
from djpt.shapes.base import towards

__all__ = ["Area", "SurfaceEmitter"]

INV_PI = 1 / math.pi


class SurfaceEmitter(Emitter):
    """Light that leaves the shape that the emitter is nested in, in proportion to a texture, `radiance`."""

    children = ("radiance", "shape")
    on_shape = True
    spread: ClassVar[float]
    """The largest angle between light and the shape's normals, in radians."""
    emitted: ClassVar[float]
    """The power that a unit of area emits, in units of `radiance`."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if "to_world" in props:
            raise SceneError(f"{props.node}: an area light has no 'to_world'; move the shape that carries it")
        self.radiance = props.texture("radiance", 1.0, low=0.0, high=LARGEST)

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.share, attribute="share")
        callback.put("radiance", self.radiance)

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        self._scene = (center - radius, center + radius)

    def power(self) -> float:
        return self.emitted * mean_of(self.radiance) * area_of(self.shape, self._scene)

    def bounds(self) -> LightBounds:
        low, high = self.shape.world_box()
        return LightBounds(low, high, *normals_of(self.shape), self.spread, self.power())


class Area(SurfaceEmitter):
    """Diffuse light from a shape: equal radiance in all directions on the side of its normal.

    The emitter is nested in the shape. Parameters: `radiance` (texture, W m^-2 sr^-1, default 1, not negative).

    Where radiance varies and every (u, v) is one point of the shape (`Shape.has_parameterization`), uv are drawn
    by the texture's brightness, with the density p, and give the point:

        pdf = p(uv) / norm(dp/du x dp/dv) dist^2 / cos    per unit solid angle.

    On other shapes, such as meshes, points are drawn as for constant radiance and weighted by the texture.
    """

    in_any_frame = True
    m_flags = int(EmitterFlags.Surface)
    spread, emitted = math.pi / 2, math.pi

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.radiance.prepare_sampling()

    @property
    def follows_texture(self) -> bool:
        """True if points are drawn by the radiance, not by the shape."""
        return not self.radiance.is_constant and self.shape.has_parameterization

    def _sample_texture(self, sample: Point2f) -> tuple[PositionSample3f, Float]:
        """Sample a point by the brightness of the texture; also 1 / (its density per unit area)."""
        uv, pdf = self.radiance.sample_position(sample)
        ps = self.shape.at_uv(uv)
        ps.pdf *= pdf
        return ps, dr.select(ps.pdf > 0, dr.rcp(ps.pdf), 0)

    def _pdf_texture(self, uv: Point2f, active: Bool | bool = True) -> Float:
        """The density of `_sample_texture` at `uv`, per unit area."""
        return self.radiance.pdf_position(uv, active) * self.shape.at_uv(uv).pdf

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return dr.select(si.wi.z > 0, self.radiance.eval(si, active), 0)

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        sample = Point2f(sample)
        if self.follows_texture:
            ps, inverse_pdf = self._sample_texture(sample)
            ds = towards(ps, inverse_pdf, it.p)
        else:
            ds = self.shape.draw_direction(it.p, sample)
        weight = dr.select(dr.dot(ds.d, ds.n) < 0, ds.weight, 0)
        return ds, self.radiance.eval(ds, active) * weight

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        if not self.follows_texture:
            return dr.select(dr.dot(ds.d, ds.n) < 0, self.shape.direction_density(it.p, ds), 0)
        cos = -dr.dot(ds.d, ds.n)
        pdf = self._pdf_texture(ds.uv)
        pdf *= dr.square(ds.dist) * dr.rcp(cos)
        return dr.select((cos > 0) & dr.isfinite(pdf), pdf, 0)

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        require_area(self.shape)
        if self.follows_texture:
            ps, inverse_pdf = self._sample_texture(position_sample)
        else:
            ps, inverse_pdf = self.shape.draw_point(position_sample), self.shape.surface_area()
        local = square_to_cosine_hemisphere(direction_sample)
        return EmissionSample(
            ray=Ray3f(ps.p, Frame3f.from_normal(ps.n).to_world(local)),
            # Cosine and density leave pi.
            weight=self.radiance.eval(ps, active) * (math.pi * inverse_pdf),
            n=ps.n,
            uv=ps.uv,
            cos=local.z,
            pdf_position=ps.pdf,
            pdf_direction=local.z * INV_PI,
            finite=Bool(True),
            delta=Bool(False),
        )

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        require_area(self.shape)
        position = self._pdf_texture(uv, active) if self.follows_texture else dr.rcp(self.shape.surface_area())
        cos = dr.dot(d, n)
        return position, dr.select(cos > 0, cos * INV_PI, 0)


register_emitter("area", Area)

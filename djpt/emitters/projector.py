"""Light that throws an image."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import drjit as dr

from djpt.core.numeric import as_array
from djpt.core.records import DirectionSample3f, EmissionSample, EmitterFlags, Observer, Ray3f
from djpt.description.plugin import ParamFlags
from djpt.description.properties import LARGEST, Allowed, Properties
from djpt.description.registry import register_emitter
from djpt.emitters.base import DeltaEmitter, LightBounds, beam
from djpt.emitters.extent import mean_of, number
from djpt.emitters.oriented import OnImage, OrientedEmitter
from djpt.emitters.point import towards_point
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Vector3f
from djpt.sensors.projective import horizontal_fov
from djpt.textures.bitmap import Bitmap

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Projector"]


class Projector(DeltaEmitter, OrientedEmitter):
    """The reverse of a pinhole camera: intensity pi scale irradiance(u, v) / cos^3 in the direction of (u, v).

    A screen across the local +z axis at distance z is so lit evenly where `irradiance` is constant: it receives
    pi scale irradiance / z^2. With t = tan(fov / 2), a direction (x, y, z) belongs to

        u = 1/2 - x / (2 t z),    v = 1/2 - aspect y / (2 t z);

    aspect is width / height of the bitmap, 1 for other textures.

    Parameters: `irradiance` (texture, default 1, not negative), `scale` (default 1, not negative), `fov`, `fov_axis`
    or `focal_length` (as for the `perspective` sensor), `to_world`. Derivatives by motion follow the sides of the beam.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {
        **OrientedEmitter.values,
        "scale": ParamFlags.Differentiable,
        # Half width and half height of the image at z = 1.
        **dict.fromkeys(("reach_x", "reach_y"), ParamFlags.NonDifferentiable),
    }
    allowed: ClassVar[Mapping[str, Allowed]] = {"scale": Allowed(0.0)}
    m_flags = int(EmitterFlags.DeltaPosition)
    children = ("irradiance",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.irradiance = props.texture("irradiance", 1.0, low=0.0, high=LARGEST)
        self.irradiance.prepare_sampling()
        self.scale = Float(props.float("scale", 1.0, low=0.0))
        self._reach = math.tan(math.radians(horizontal_fov(props, self._aspect())) / 2)
        self._measure()

    def parameters_changed(self, keys: Sequence[str]) -> None:
        super().parameters_changed(keys)
        if "irradiance" in keys:
            self._measure()

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self.irradiance = frame.rescaled(self.irradiance, 2)

    # ---- on the host -------------------------------------------------------------------

    def _aspect(self) -> float:
        if not isinstance(self.irradiance, Bitmap):
            return 1.0
        height, width, _ = self.irradiance.data.shape
        return width / height

    def _measure(self) -> None:
        """Compute the image's extent: a bitmap of another shape keeps the field of view along x."""
        self.reach_x, self.reach_y = as_float(self._reach), as_float(self._reach / self._aspect())

    def power(self) -> float:
        area = 4 * number(self.reach_x) * number(self.reach_y)
        return math.pi * area * number(self.scale) * mean_of(self.irradiance)

    def bounds(self) -> LightBounds:
        at, axis = as_array(self.position), as_array(self.forward)
        widest = math.atan(math.hypot(number(self.reach_x), number(self.reach_y)))
        return LightBounds(at, at, axis, 0.0, widest, self.power())

    # ---- in kernels --------------------------------------------------------------------

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        ds, falloff = towards_point(self.position, it.p)
        ds.uv, inv_z, lit = self._on_image(self.world_to_local(-ds.d))
        value = self.irradiance.eval(ds, lit & active) * (math.pi * self.scale * falloff * inv_z * dr.square(inv_z))
        return ds, dr.select(lit, value, 0)

    def _on_image(self, d: Vector3f) -> tuple[Point2f, Float, Bool]:
        """uv in a local direction of unit length, 1 / cos of the angle to the axis, and whether the image is there."""
        ahead = d.z > 0
        inv_z = dr.rcp(dr.select(ahead, d.z, 1))
        x, y = d.x * inv_z * dr.rcp(self.reach_x), d.y * inv_z * dr.rcp(self.reach_y)
        lit = ahead & (dr.abs(x) <= 1) & (dr.abs(y) <= 1)
        return Point2f(dr.fma(x, -0.5, 0.5), dr.fma(y, -0.5, 0.5)), inv_z, lit

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        # By the brightness of the image.
        uv, pdf = self.irradiance.sample_position(direction_sample, active)
        x, y = dr.fma(uv.x, -2, 1) * self.reach_x, dr.fma(uv.y, -2, 1) * self.reach_y
        d = dr.normalize(self.local_to_world(Vector3f(x, y, 1)))
        pdf = dr.detach(pdf)
        inverse_pdf = dr.select(pdf > 0, dr.rcp(pdf), 0)
        area = 4 * self.reach_x * self.reach_y
        weight = self.irradiance.eval(OnImage(uv), active) * (math.pi * self.scale * area * inverse_pdf)
        # dw = dA cos^3, on the plane at z = 1.
        length_squared = dr.fma(x, x, dr.fma(y, y, 1))
        pdf_direction = pdf * dr.rcp(area) * (length_squared * dr.sqrt(length_squared))
        return beam(Ray3f(self.position, d), weight, Float(1), pdf_direction, uv, finite=True, delta=True)

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        at, inv_z, lit = self._on_image(self.world_to_local(d))
        pdf = self.irradiance.pdf_position(at, lit & active)
        pdf *= inv_z * dr.square(inv_z) * dr.rcp(4 * self.reach_x * self.reach_y)
        return Float(1), dr.select(lit, pdf, 0)


register_emitter("projector", Projector)

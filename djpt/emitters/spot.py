"""Light from a point into a cone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import drjit as dr

from djpt.core.numeric import as_array
from djpt.core.records import DirectionSample3f, EmissionSample, EmitterFlags, Observer, Ray3f
from djpt.core.warp import square_to_uniform_cone, square_to_uniform_cone_pdf
from djpt.description.plugin import ParamFlags
from djpt.description.properties import LARGEST, Allowed, Properties
from djpt.description.registry import register_emitter
from djpt.emitters.base import DeltaEmitter, LightBounds, beam
from djpt.emitters.extent import mean_of, number
from djpt.emitters.oriented import OnImage, OrientedEmitter
from djpt.emitters.point import towards_point
from djpt.errors import ParameterError
from djpt.jit.frozen import recording
from djpt.jit.kernels import maximum, minimum
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Vector3f

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["SpotLight"]

RADIANS = math.pi / 180
SHARPEST = 1e-6
"""The cone's edge has at least this width, in radians."""


class SpotLight(DeltaEmitter, OrientedEmitter):
    """Light from a point into a cone: intensity falls off linearly in the angle theta to the local +z axis:

        I(theta) = intensity texture(u, v) clamp((cutoff - theta) / (cutoff - beam), 0, 1),
        (u, v) = 1/2 + (x, y) / (2 z tan(cutoff))   in the direction (x, y, z).

    Parameters: `intensity` (texture, W sr^-1, default 1, not negative, can't vary), `cutoff_angle` (degrees from the
    axis to the edge, in (0, 90], default 20), `beam_width` (degrees from the axis to where the falloff begins, at most
    `cutoff_angle`, default 3/4 of it), `texture` (its unit square is about the cone; not negative, default 1),
    `to_world`. Derivatives with respect to `cutoff_angle` leave out that edges in the texture move.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {
        **OrientedEmitter.values,
        **dict.fromkeys(("cutoff_angle", "beam_width"), ParamFlags.Differentiable),
    }
    allowed: ClassVar[Mapping[str, Allowed]] = {
        "cutoff_angle": Allowed(0.0, 90.0, low_open=True),
        "beam_width": Allowed(0.0, 90.0),
    }
    m_flags = int(EmitterFlags.DeltaPosition)
    children = ("intensity", "texture")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.intensity = props.texture("intensity", 1.0, low=0.0, high=LARGEST)
        if not self.intensity.is_constant:
            raise props.error("intensity", "can't vary: what varies over the cone is the 'texture'")
        self.texture = props.texture("texture", 1.0, low=0.0, high=LARGEST)
        cutoff = props.float("cutoff_angle", 20.0, low=0.0, high=90.0, low_open=True)
        self.cutoff_angle = Float(cutoff)
        self.beam_width = Float(props.float("beam_width", 0.75 * cutoff, low=0.0, high=cutoff))

    def parameters_changed(self, keys: Sequence[str]) -> None:
        super().parameters_changed(keys)
        if not recording():
            beam, cutoff = number(self.beam_width), number(self.cutoff_angle)
            if beam > cutoff:
                raise ParameterError(f"{self.id()}: beam_width {beam:g} must be at most cutoff_angle, {cutoff:g}")

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self.intensity = frame.rescaled(self.intensity, 2)

    # ---- on the host -------------------------------------------------------------------

    @property
    def edge_width(self) -> float:
        """The angle in degrees over which the intensity falls off to 0."""
        return number(self.cutoff_angle) - number(self.beam_width)

    def power(self) -> float:
        beam, cutoff = RADIANS * number(self.beam_width), RADIANS * number(self.cutoff_angle)
        # Of the integral of the falloff over the sphere, 2 pi (1 - (sin cutoff - sin beam) / (cutoff - beam)).
        slope = (math.sin(cutoff) - math.sin(beam)) / (cutoff - beam) if cutoff > beam else math.cos(cutoff)
        return 2 * math.pi * (1 - slope) * mean_of(self.intensity) * mean_of(self.texture)

    def bounds(self) -> LightBounds:
        at, axis = as_array(self.position), as_array(self.forward)
        return LightBounds(at, at, axis, 0.0, RADIANS * number(self.cutoff_angle), self.power())

    # ---- in kernels --------------------------------------------------------------------

    def intensity_towards(self, d: Vector3f, active: Bool | bool) -> Color3f:
        """The intensity I in a local direction of unit length."""
        cutoff, theta = RADIANS * self.cutoff_angle, dr.safe_acos(d.z)
        width = maximum(cutoff - RADIANS * self.beam_width, SHARPEST)
        falloff = minimum(maximum((cutoff - theta) * dr.rcp(width), 0), 1)
        value = self.intensity.eval(None, active) * falloff
        if self.texture.is_constant:
            return value * self.texture.eval(None, active)
        inside = falloff > 0
        scale = 0.5 * dr.rcp(dr.tan(cutoff) * dr.select(inside, d.z, 1))
        at = OnImage(Point2f(dr.fma(d.x, scale, 0.5), dr.fma(d.y, scale, 0.5)))
        return dr.select(inside, value * self.texture.eval(at, inside & active), 0)

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        ds, falloff = towards_point(self.position, it.p)
        return ds, self.intensity_towards(self.world_to_local(-ds.d), active) * falloff

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        # Uniform in the cone; as in Mitsuba, by the numbers that are for positions elsewhere.
        cos_cutoff = self._cos_cutoff()
        d = square_to_uniform_cone(position_sample, cos_cutoff)
        solid_angle = 2 * math.pi * (1 - cos_cutoff)
        weight = self.intensity_towards(d, active) * solid_angle
        ray = Ray3f(self.position, self.local_to_world(d))
        return beam(ray, weight, Float(1), dr.rcp(solid_angle), finite=True, delta=True)

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        return Float(1), square_to_uniform_cone_pdf(self.world_to_local(d), self._cos_cutoff())

    def _cos_cutoff(self) -> Float:
        """The cosine between the axis and the cone's edge, detached."""
        return dr.cos(RADIANS * dr.detach(self.cutoff_angle))


register_emitter("spot", SpotLight)

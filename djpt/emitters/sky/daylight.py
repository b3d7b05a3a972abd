"""The base of lights of the sky, and what a sky is at an instant: radiance, and the sampling of directions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import (
    DirectionSample3f,
    EmissionSample,
    EmitterFlags,
    Interaction3f,
    Observer,
    Ray3f,
    SurfaceInteraction3f,
)
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.description.plugin import HIDDEN, ParamFlags, TraversalCallback
from djpt.description.properties import Allowed, Properties
from djpt.emitters.base import InfiniteEmitter, beam
from djpt.emitters.extent import number
from djpt.emitters.oriented import OrientedEmitter
from djpt.emitters.sky.directions import SkyDirections
from djpt.emitters.sky.dome import WAVELENGTHS, SkyDome, SunDisc, squared_chord
from djpt.jit.kernels import as_float, maximum
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Vector3f

__all__ = ["LUMINANCE", "Daylight", "Instant"]

LUMINANCE = 1 / 106.7502593994140625
"""The inverse of the integral of the eye's sensitivity over wavelengths in nm: a spectrum of ones has luminance 1."""


@dataclass
class Instant:
    """The sky at an instant. Directions are those of the light's space, where z points up, of unit length."""

    dome: SkyDome
    disc: SunDisc
    directions: SkyDirections
    sky_fraction: Float
    """The probability with which `sample` chooses the sky, not the sun."""
    sky_scale: Float
    sun_scale: Float

    def is_day(self, local: Vector3f) -> Bool:
        """True where light arrives from a direction: it lies above the horizon, as does the sun."""
        return (local.z >= 0) & (self.disc.direction.z >= 0)

    def radiance(self, local: Vector3f, on_disc: Bool) -> Color3f:
        """The radiance from a direction, in W m^-2 sr^-1 nm^-1; `on_disc` is true within the sun's disc."""
        lit, cos_theta = self.is_day(local), maximum(local.z, Float(0))
        chord2 = squared_chord(self.disc.direction, local)
        sky = self.dome.radiance(cos_theta, chord2) * self.sky_scale
        sun = self.disc.radiance(cos_theta, chord2, on_disc) * self.sun_scale
        return dr.select(lit, (sky + dr.select(on_disc, sun, 0)) * LUMINANCE, 0)

    def pdf(self, local: Vector3f, on_disc: Bool) -> Float:
        """The density of `sample`, per unit solid angle."""
        density = dr.lerp(dr.select(on_disc, self.disc.pdf(), 0), self.directions.pdf(local), self.sky_fraction)
        return dr.select(self.is_day(local), density, 0)

    def sample(self, sample: Point2f) -> tuple[Vector3f, Float, Float, Color3f]:
        """Sample a direction, with its density per unit solid angle, 1 / density, and radiance."""
        to_sky = sample.x < self.sky_fraction
        rest = Point2f((sample.x - self.sky_fraction) / (1 - self.sky_fraction), sample.y)
        sky = self.directions.sample(Point2f(sample.x / self.sky_fraction, sample.y))
        local = dr.select(to_sky, sky, self.disc.sample(rest))
        on_disc = ~to_sky | self.disc.covers(local)
        pdf = self.pdf(local, on_disc)
        return local, pdf, dr.select(pdf > 0, dr.rcp(pdf), 0), self.radiance(local, on_disc)


class Daylight(InfiniteEmitter, OrientedEmitter):
    """The sky and the sun, which stands where a subclass says (`at`).

    In the light's space z points up, x to the south and y to the west, as in Mitsuba (a left-handed system). Radiance
    is in W m^-2 sr^-1 nm^-1: a scene of metres then has physical units. It isn't clamped: some colours of the sun and
    the sky have negative components in sRGB.

    One of the sun and the sky is chosen. Directions to the sun are uniform over its disc, those to the sky have the
    density of `djpt.emitters.sky.directions.SkyDirections`.

    Parameters: `turbidity` (1 to 10, default 3: a clear sky; 10 is hazy), `albedo` of the ground (texture in [0, 1]
    that can't vary, default 0.3), `sun_scale`, `sky_scale` (default 1, not negative), `sun_aperture` (the angle of the
    disc in degrees, in (0, 180), default 0.5358; its power stays the same), `complex_sun` (default false; true darkens
    the edge of the disc), `to_world` (a rotation or reflection, default identity).
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {
        **dict.fromkeys((*OrientedEmitter.values, "center", "radius"), HIDDEN),
        **dict.fromkeys(("sky_scale", "sun_scale"), ParamFlags.Differentiable),
    }
    motions: ClassVar[tuple[str, ...]] = ()
    can_move = False
    motion_flags = HIDDEN
    turbidity_flags: ClassVar[ParamFlags] = HIDDEN
    """The flags of `turbidity`."""
    m_flags = int(EmitterFlags.Infinite | EmitterFlags.SpatiallyVarying)
    children: ClassVar[tuple[str, ...]] = ("disc",)
    allowed: ClassVar[Mapping[str, Allowed]] = {
        **dict.fromkeys(("sky_scale", "sun_scale"), Allowed(0.0)),
        "turbidity": Allowed(1.0, 10.0),
    }
    irradiance: Any
    """On the host: the luminance of the irradiance of the ground."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.turbidity = as_float(props.float("turbidity", 3.0, low=1.0, high=10.0))
        self.sky_scale = as_float(props.float("sky_scale", 1.0, low=0.0))
        self.sun_scale = as_float(props.float("sun_scale", 1.0, low=0.0))
        self.albedo = props.texture("albedo", 0.3, low=0.0, high=1.0)
        if not self.albedo.is_constant:
            raise props.error("albedo", "can't vary: it applies to all of the ground")
        aperture = props.float("sun_aperture", 0.5358, low=0.0, high=180.0, low_open=True, high_open=True)
        self.disc = SunDisc(aperture, props.boolean("complex_sun", False))

    # ---- parameters --------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.share, attribute="share")
        callback.put("to_world", self.placing, self.motion_flags)
        callback.put("turbidity", self.turbidity, self.turbidity_flags)
        for name in ("sky_scale", "sun_scale"):
            callback.put(name, getattr(self, name), self.values[name])
        callback.put("albedo", self.albedo)

    # ---- on the host -------------------------------------------------------------------

    def power(self) -> float:
        return number(self.irradiance) * WAVELENGTHS * LUMINANCE * math.pi * number(self.radius) ** 2

    # ---- in kernels --------------------------------------------------------------------

    def at(self, time: Float) -> Instant:
        """The sky at a ray's time."""
        raise NotImplementedError

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        now, local = self.at(si.time), self.world_to_local(-si.wi)
        return now.radiance(local, now.disc.covers(local))

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        time = it.time if isinstance(it, Interaction3f) else Float(0)
        local, pdf, weight, radiance = self.at(time).sample(sample)
        return self.towards(it, self.local_to_world(local), Point2f(0), pdf, weight), radiance * weight

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        now, local = self.at(ds.time), self.world_to_local(ds.d)
        return now.pdf(local, now.disc.covers(local))

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        return self.emission_at(Float(0), position_sample, direction_sample)

    def emission_at(self, time: Float, position_sample: Point2f, direction_sample: Point2f) -> EmissionSample:
        """Sample a ray that leaves the sky at a time: see `sample_emission`."""
        local, pdf, weight, radiance = self.at(time).sample(direction_sample)
        # From a disk as wide as the scene, in front of it.
        at = square_to_uniform_disk_concentric(position_sample)
        d = self.local_to_world(-local)
        across = Frame3f.from_normal(d).to_world(Vector3f(at.x, at.y, 0))
        area = math.pi * dr.square(self.radius)
        ray = Ray3f(dr.fma(across - d, self.radius, self.center), d)
        return beam(ray, radiance * (weight * area), dr.rcp(area), pdf)

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        now, local = self.at(Float(0)), self.world_to_local(-d)
        return dr.rcp(math.pi * dr.square(self.radius)), now.pdf(local, now.disc.covers(local))

"""The sky and the sun at an instant: radiance, and the sampling of directions."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from djpt.emitters.sky.angles import squared_chord
from djpt.emitters.sky.directions import SkyDirections
from djpt.emitters.sky.disc import SunDisc
from djpt.emitters.sky.dome import SkyDome
from djpt.jit.kernels import maximum
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f

__all__ = ["LUMINANCE", "Instant"]

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
        """True where light comes from a direction: it is above the horizon, and so is the sun."""
        return (local.z >= 0) & (self.disc.direction.z >= 0)

    def radiance(self, local: Vector3f, on_disc: Bool) -> Color3f:
        """The radiance from a direction, in W m^-2 sr^-1 nm^-1; `on_disc` tells whether the sun is there."""
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

"""Directions of the sky, sampled by a density that resembles its radiance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr

from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.emitters.sky.tables import table
from djpt.jit.kernels import maximum
from djpt.jit.types import Float, Point2f, UInt32, Vector3f

__all__ = ["FITTED", "SkyDirections"]

INV_SQRT_TWO = math.sqrt(0.5)
FITTED = 5
"""The parameters that were fitted: those after the azimuth, up to `spread_phi`."""
VALUES = ("azimuth", "glow", "horizon", "mean_z", "spread_z", "spread_phi", "low_z", "high_z", "low_phi", "high_phi")


class SkyDirections(Plugin):
    """A density of directions above the horizon: a glow about the sun, and light from near the horizon.

    With the fraction `glow` a truncated normal distribution of (z, phi), phi being the azimuth from the sun; else
    uniform in azimuth with the density 1 / (2 pi h (1 + z^2 (1 / h^2 - 1))^1.5), where h is `horizon`: for h = 1
    uniform, and brighter at the horizon the smaller h is. Since the area of the sphere is dz dphi, both are densities
    per solid angle. Parameters were fitted to the sky for each elevation of the sun and turbidity.

    After N. Vitsas, K. Vardis and G. Papaioannou, "Sampling Clear Sky Models using Truncated Gaussian Mixtures", EGSR
    2021.

    A child of the plugin that it serves; nothing of it shows in `traverse`.
    """

    in_any_frame = True
    kind = "distribution"
    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(VALUES, ParamFlags.NonDifferentiable)
    children = ()
    statics = ()

    azimuth: Any
    glow: Any
    horizon: Any
    mean_z: Any
    spread_z: Any
    spread_phi: Any
    low_z: Any
    """The normal distribution function at z = 0, .."""
    high_z: Any
    """.. at z = 1, .."""
    low_phi: Any
    """.. at phi = -pi .."""
    high_phi: Any
    """.. and at phi = pi."""

    def traverse(self, callback: TraversalCallback) -> None:
        """Report nothing: there is nothing to edit."""

    def set(self, turbidity: Float, elevation: Float, azimuth: Float) -> None:
        """Take the state of the atmosphere, and the sun's elevation and azimuth in radians."""
        with dr.suspend_grad():
            least, most = math.radians(2), math.radians(88)
            # 30 elevations; beyond the first and the last the sky is sampled as there.
            fitted = table("density").at((elevation - least) * (29 / (most - least))).at(turbidity - 1).numbers
            self._take(azimuth, [dr.gather(Float, fitted, UInt32(k)) for k in range(FITTED)])
            # Copies: what is made opaque here must not be a variable of the caller's.
            values = {name: Float(dr.detach(getattr(self, name))) for name in VALUES}
            dr.make_opaque(values)
        vars(self).update(values)

    @staticmethod
    def of(azimuth: Float, fitted: Sequence[Float]) -> SkyDirections:
        """The density with parameters of one's own, after the table's `density`, and the sun at an azimuth."""
        directions = SkyDirections()
        directions._take(azimuth, fitted)
        return directions

    def _take(self, azimuth: Float, fitted: Sequence[Float]) -> None:
        self.azimuth = azimuth
        self.glow, self.horizon, self.mean_z, self.spread_z, self.spread_phi = fitted[:FITTED]
        self.low_z = normal_distribution(-self.mean_z, self.spread_z)
        self.high_z = normal_distribution(1 - self.mean_z, self.spread_z)
        self.low_phi = normal_distribution(Float(-math.pi), self.spread_phi)
        self.high_phi = normal_distribution(Float(math.pi), self.spread_phi)

    # ---- in kernels --------------------------------------------------------------------

    def sample(self, sample: Point2f) -> Vector3f:
        """A direction with the density `pdf`, of unit length."""
        glows = sample.x < self.glow
        x = dr.select(glows, sample.x / self.glow, (sample.x - self.glow) / (1 - self.glow))
        # What is uniform on a hemisphere, flattened.
        flat = self.horizon * x * dr.rsqrt(dr.fma(dr.square(x), dr.square(self.horizon) - 1, 1))
        z = dr.fma(quantile(dr.lerp(self.low_z, self.high_z, x)), self.spread_z, self.mean_z)
        phi = quantile(dr.lerp(self.low_phi, self.high_phi, sample.y)) * self.spread_phi
        z = maximum(dr.select(glows, z, flat), Float(0))
        phi = dr.select(glows, phi, (sample.y - 0.5) * (2 * math.pi))
        sin_phi, cos_phi = dr.sincos(phi + self.azimuth)
        sin_theta = dr.safe_sqrt(dr.fma(-z, z, 1))
        return Vector3f(sin_theta * cos_phi, sin_theta * sin_phi, z)

    def pdf(self, d: Vector3f) -> Float:
        """The density at a direction, per unit solid angle; 0 below the horizon."""
        phi = dr.atan2(d.y, d.x) - self.azimuth
        phi = phi - dr.select(phi > math.pi, 2 * math.pi, dr.select(phi < -math.pi, -2 * math.pi, 0))
        base = dr.fma(dr.square(d.z), dr.rcp(dr.square(self.horizon)) - 1, 1)
        flat = (0.5 / math.pi) * dr.rcp(self.horizon * base * dr.sqrt(base))
        x, y = (d.z - self.mean_z) / self.spread_z, phi / self.spread_phi
        inside = (self.high_z - self.low_z) * (self.high_phi - self.low_phi) * self.spread_z * self.spread_phi
        normal = (0.5 / math.pi) * dr.exp(-0.5 * dr.fma(x, x, dr.square(y))) / inside
        return dr.select((d.z >= 0) & (d.z <= 1), dr.lerp(flat, normal, self.glow), 0)


def normal_distribution(x: Float, spread: Float) -> Float:
    """The distribution function of the normal density with the mean 0 and a standard deviation."""
    return 0.5 * (1 + dr.erf(INV_SQRT_TWO * x / spread))


def quantile(share: Float) -> Float:
    """The inverse of `normal_distribution` for the standard deviation 1, finite at 0 and 1."""
    share = dr.clip(share, 2.0**-24, 1 - 2.0**-24)
    return math.sqrt(2) * dr.erfinv(2 * share - 1)

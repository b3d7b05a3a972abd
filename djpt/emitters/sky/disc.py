"""The sun: its disc in the sky, and its radiance."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.dispatch.tables import entry_at
from djpt.emitters.sky.dome import squared_chord, squared_sine
from djpt.emitters.sky.tables import Grid, table
from djpt.jit.kernels import as_float, minimum
from djpt.jit.types import Bool, Color3f, Float, Point2f, TensorXf, UInt32, Vector3f

__all__ = ["WAVELENGTHS", "SunDisc", "irradiances"]

HIDDEN = ParamFlags.NonDifferentiable
APERTURE = 0.5358
"""The angle in degrees that the sun has in the tables."""
TRUE_HEIGHT = 1 - math.cos(math.radians(APERTURE) / 2)
PARTS, PACKETS, COSINES = 45, 18, 6
WAVELENGTHS = 467.069280386
"""The factor between averages over the wavelengths of the sun's spectrum and the colours of the sky."""


class SunDisc(Plugin):
    """A disc about the sun's direction, of constant radiance, or with limb darkening by the angle to its centre.

    L. Hosek and A. Wilkie, "Adding a Solar-Radiance Function to the Hosek-Wilkie Skylight Model", IEEE CG&A 33(3),
    2013: polynomials in the elevation of the direction, of degree 3 in each of 45 parts of the sky, and in the cosine
    on the disc, of degree 5. A disc of another size is as bright as a whole, see `set`.

    A child of the plugin that it serves; nothing of it shows in `traverse`.
    """

    in_any_frame = True
    kind = "sun"
    values: ClassVar[Mapping[str, ParamFlags]] = {
        **dict.fromkeys(("direction", "color"), ParamFlags.Differentiable),
        **dict.fromkeys(("height", "brightness"), HIDDEN),
    }
    tables: ClassVar[Mapping[str, ParamFlags]] = {"polynomials": HIDDEN}
    children = ()
    statics = ("darkening",)

    direction: Any
    """The direction towards the centre, of unit length."""
    color: Any
    """The radiance, averaged over the disc."""
    polynomials: Any
    """The coefficients of the radiance: colours, then powers of elevation, then powers of the cosine."""

    def __init__(self, aperture: float, darkening: bool) -> None:
        """Take the angle that the disc subtends, in degrees, and whether its edge is darker."""
        height = 1 - math.cos(math.radians(aperture) / 2)
        self.darkening = darkening
        self.height = as_float(height)
        """The height of the cap of the unit sphere that the disc covers."""
        self.dilution = TRUE_HEIGHT / height
        """On the host: the solid angle of the sun over that of the disc."""
        self.brightness = as_float(WAVELENGTHS * self.dilution)
        self.polynomials = TensorXf([0.0, 0, 0, 0], (1, 1, 4))

    def traverse(self, callback: TraversalCallback) -> None:
        """Report nothing: there is nothing to edit."""

    def set(self, turbidity: Float, direction: Vector3f, irradiance: Color3f) -> None:
        """Take the state of the atmosphere, the direction of the sun, and its irradiance by the tables.

        A disc of another size sends the same power.
        """
        self.direction, self.color = direction, self._mean_radiance(irradiance)
        dr.make_opaque(self.direction, self.color)
        if self.darkening:
            numbers = table("sun").at(turbidity - 1).numbers
            dr.make_opaque(numbers)
            self.polynomials = TensorXf(dr.detach(numbers), (PARTS, PACKETS, 4))

    # ---- in kernels --------------------------------------------------------------------

    def moved(self, direction: Vector3f, irradiance: Color3f) -> SunDisc:
        """The disc in another direction, with another irradiance by the tables."""
        disc = copy.copy(self)
        disc.direction, disc.color = direction, self._mean_radiance(irradiance)
        return disc

    def _mean_radiance(self, irradiance: Color3f) -> Color3f:
        return irradiance * (self.brightness / (2 * math.pi * TRUE_HEIGHT))

    def covers(self, d: Vector3f) -> Bool:
        """True where a unit vector points to the disc."""
        return squared_chord(self.direction, d) <= 2 * self.height

    def pdf(self) -> Float:
        """The density of `sample` on the disc, per unit solid angle."""
        return dr.rcp(2 * math.pi * self.height)

    def sample(self, sample: Point2f) -> Vector3f:
        """A uniform direction towards the disc."""
        at = square_to_uniform_disk_concentric(sample)
        below = self.height * dr.squared_norm(at)
        scale = dr.safe_sqrt(self.height * (2 - below))
        centre = Frame3f.from_normal(dr.detach(self.direction))
        return centre.to_world(Vector3f(at.x * scale, at.y * scale, 1 - below))

    def radiance(self, cos_theta: Float, chord2: Float, active: Bool | bool) -> Color3f:
        """The radiance on the disc at an angle theta to the zenith, by the squared distance to the centre."""
        if not self.darkening:
            return self.color
        elevation = dr.asin(minimum(cos_theta, Float(1)))
        part = minimum(dr.floor(dr.cbrt(elevation * (2 / math.pi)) * PARTS), Float(PARTS - 1))
        x = elevation - (math.pi / 2) * (part * (1 / PARTS)) ** 3
        # sin^2 of the radius of the disc is height (2 - height).
        cosine = dr.safe_sqrt(1 - squared_sine(chord2) * dr.rcp(self.height * (2 - self.height)))
        packets = [entry_at(self.polynomials, UInt32(part) * PACKETS + k, active) for k in range(PACKETS)]
        numbers = [packet[i] for packet in packets for i in range(4)]
        by_elevation = [horner(numbers[k : k + COSINES], cosine) for k in range(0, len(numbers), COSINES)]
        return Color3f(*(horner(by_elevation[k : k + 4], x) for k in (0, 4, 8))) * self.brightness


def horner(coefficients: list[Float], x: Float) -> Float:
    """The polynomial with these coefficients, that of x^0 first."""
    result = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        result = dr.fma(result, x, coefficient)
    return result


def irradiances(turbidity: Float, elevation: Float) -> tuple[Color3f, Float, Float]:
    """The sun's irradiance, its luminance and that of the sky, at an elevation of the sun in radians."""
    found: Grid = table("irradiance").at(turbidity - 1).at((elevation * (180 / math.pi) - 2) * (1 / 3))
    return (
        dr.gather(Color3f, found.numbers, UInt32(0)),
        dr.gather(Float, found.numbers, UInt32(3)),
        dr.gather(Float, found.numbers, UInt32(4)),
    )

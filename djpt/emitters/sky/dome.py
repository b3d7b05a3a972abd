"""The radiance of the sky and of the sun's disc, and the sampling of the disc."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.description.plugin import HIDDEN, ParamFlags, Plugin, TraversalCallback
from djpt.dispatch.tables import entry_at
from djpt.emitters.sky.tables import Grid, bezier_weights, table
from djpt.jit.kernels import as_float, maximum, minimum
from djpt.jit.types import Bool, Color3f, Float, Point2f, TensorXf, UInt32, Vector3f

__all__ = ["WAVELENGTHS", "SkyDome", "SunDisc", "atmosphere", "irradiances", "squared_chord"]


def squared_chord(a: Vector3f, b: Vector3f) -> Float:
    """The squared distance of two unit vectors, which the functions below take: 2 - 2 cos."""
    return dr.squared_norm(a - b)


def cosine(chord2: Float) -> Float:
    """The cosine of the angle between them."""
    return dr.fma(chord2, -0.5, 1)


def squared_sine(chord2: Float) -> Float:
    """The squared sine of the angle between them."""
    return chord2 * dr.fma(chord2, -0.25, 1)


def angle(chord2: Float) -> Float:
    """The angle between them, in radians."""
    return 2 * dr.asin(minimum(0.5 * dr.sqrt(chord2), Float(1)))


QUANTITIES = ("A", "B", "C", "D", "E", "F", "G", "I", "H", "mean")
"""The order of the table."""
POINTS = 6
"""The control points of each quantity's curve."""


class SkyDome(Plugin):
    """The radiance of a clear or hazy sky at the angles theta to the zenith and gamma to the sun:

        mean (1 + A exp(B / (cos theta + 0.01))) (C + D exp(E gamma) + F cos^2 gamma + G chi(gamma) + I sqrt(cos theta))
        chi(gamma) = (1 + cos^2 gamma) / (1 + H^2 - 2 H cos gamma)^1.5.

    L. Hosek and A. Wilkie, "An Analytic Model for Full Spectral Sky-Dome Radiance", ACM TOG 31(4), 2012. The letters
    are colours, interpolated between tables: linearly in turbidity and in the ground's albedo, and by a curve of
    degree 5 in the cube root of the sun's elevation.

    A child of the plugin that it serves; nothing of it shows in `traverse`.
    """

    in_any_frame = True
    kind = "sky"
    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(QUANTITIES, ParamFlags.Differentiable)
    children = ()
    statics = ()

    A: Any
    B: Any
    C: Any
    D: Any
    E: Any
    F: Any
    G: Any
    H: Any
    I: Any  # noqa: E741  the model's name
    mean: Any

    def traverse(self, callback: TraversalCallback) -> None:
        """Report nothing: there is nothing to edit."""

    def set(self, turbidity: Float, albedo: Color3f, elevation: Float) -> None:
        """Take the state of the atmosphere, the colour of the ground, and the sun's elevation in radians."""
        quantities = atmosphere(turbidity, albedo).curve(curve_position(elevation)).numbers
        dr.eval(quantities)
        colours = [dr.gather(Color3f, quantities, UInt32(index)) for index in range(len(QUANTITIES))]
        dr.make_opaque(colours)
        self._take(colours)

    @staticmethod
    def of(controls: Any, elevation: Float, active: Bool | bool = True) -> SkyDome:
        """The sky at an elevation of the sun per lane.

        `controls` is the table of an `atmosphere` as entries, one colour for each control point and quantity.
        """
        dome, position, count = SkyDome(), curve_position(elevation), len(QUANTITIES)
        weights = bezier_weights(POINTS, position)
        colours = [
            sum((entry_at(controls, UInt32(k * count + q), active) * weights[k] for k in range(POINTS)), Color3f(0))
            for q in range(count)
        ]
        dome._take(colours)
        return dome

    def _take(self, colours: Sequence[Any]) -> None:
        vars(self).update(zip(QUANTITIES, colours, strict=True))

    def radiance(self, cos_theta: Float, chord2: Float) -> Color3f:
        """The radiance in a direction above the horizon, given the squared distance between it and the sun's."""
        cos_gamma = cosine(chord2)
        cos2_gamma = dr.square(cos_gamma)
        horizon = 1 + self.A * dr.exp(self.B / (cos_theta + 0.01))
        base = 1 + dr.square(self.H) - 2 * self.H * cos_gamma
        chi = (1 + cos2_gamma) / (base * dr.sqrt(base))
        about_sun = (
            self.C
            + self.D * dr.exp(self.E * angle(chord2))
            + self.F * cos2_gamma
            + self.G * chi
            + self.I * dr.safe_sqrt(cos_theta)
        )
        return self.mean * horizon * about_sun


def atmosphere(turbidity: Float, albedo: Color3f) -> Grid:
    """The curves of all quantities in one state of the atmosphere: control points, quantities, colours."""
    grid = table("sky").at(turbidity - 1)
    return grid.at(Float(dr.tile(dr.ravel(albedo), math.prod(grid.shape[1:]) // 3)))


def curve_position(elevation: Float) -> Float:
    """The position of an elevation of the sun, in radians, on the curves: in [0, 1)."""
    # The slope of the cube root at 0 is infinite.
    share = minimum(maximum(elevation * (2 / math.pi), Float(1e-12)), Float(1))
    return minimum(dr.cbrt(share), Float(1 - 2**-24))


APERTURE = 0.5358
"""The angle in degrees that the sun has in the tables."""
TRUE_HEIGHT = 1 - math.cos(math.radians(APERTURE) / 2)
EDGE = 0.5
"""The share of the disc, from its edge inwards, that stands for the edge in derivatives by the sun's direction."""
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
    tables: ClassVar[Mapping[str, ParamFlags]] = {"polynomials": ParamFlags.Differentiable}
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
            self.polynomials = TensorXf(numbers, (PARTS, PACKETS, 4))

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
        """The radiance on the disc, per lane.

        If `chord2` has gradients, the edge of the disc moves. With s, the share of the disc that lies farther from the
        centre than a point, the edge is at s = 0, and the derivative has the term L delta(s) ds. Points of the disc are
        uniform in s, so a kernel of the width `EDGE` replaces delta; its first moment is 0, and its error of second
        order.

        Args:
            cos_theta: Cosine of the angle to the zenith.
            chord2: Squared distance to the centre of the disc, on the unit sphere.
            active: Lanes that count.
        """
        value = self._radiance(cos_theta, chord2, active)
        if not dr.grad_enabled(chord2):
            return value
        whole = 2 * self.height
        edge = self._radiance(cos_theta, whole, active) if self.darkening else value
        share = 1 - chord2 / whole
        here = dr.detach(share)
        kernel = dr.select(here < EDGE, (4 - 6 / EDGE * here) / EDGE, 0)
        attached: Any = dr.replace_grad(value, value + dr.detach(edge) * (kernel * share))  # type: ignore[func-returns-value]
        return Color3f(attached)

    def _radiance(self, cos_theta: Float, chord2: Float, active: Bool | bool) -> Color3f:
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

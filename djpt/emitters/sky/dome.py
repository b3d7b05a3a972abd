"""The radiance of the sky."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr

from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.dispatch.tables import entry_at
from djpt.emitters.sky.tables import Grid, bezier_weights, table
from djpt.jit.kernels import maximum, minimum
from djpt.jit.types import Bool, Color3f, Float, UInt32, Vector3f

__all__ = ["SkyDome", "angle", "atmosphere", "cosine", "squared_chord", "squared_sine"]


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

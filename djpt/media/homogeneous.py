"""Media that are the same everywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr

from djpt.core.records import Ray3f, has_flag
from djpt.core.records.flags import PhaseFunctionFlags
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.plugin import ParamFlags, Plugin
from djpt.description.properties import Properties
from djpt.description.registry import register_medium
from djpt.errors import SceneError
from djpt.jit.kernels import maximum, minimum
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.media.base import MeasuredMedium
from djpt.media.flight import FAR, Flight, of_channel
from djpt.media.translucent import translucent
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Homogeneous"]

THIN = 0.05
"""Up to this optical depth four terms of the series of exp are exact in single precision."""

DENSEST = 1e18
"""The largest extinction; denser media are clamped to it, so that squares and inverses stay finite."""


class Homogeneous(MeasuredMedium):
    """Fog: sigma_t is the same everywhere, and the transmittance is exp(-sigma_t t).

    Distances are sampled by t = -log(1 - u) / sigma_t, with the sigma_t of one channel: that of the path, or one that
    is drawn for the flight; then its density accounts for all channels that could have been drawn.

    Parameters: `sigma_t` (extinction per unit length: a number or rgb, >= 0, default 1), `scale` (a factor of it,
    default 1), `albedo` (the scattered fraction: a number, rgb or volume in [0, 1], default 0.75), or in place of
    `sigma_t` and `albedo` a `material` (a name of `djpt.media.translucent.MATERIALS`, such as `whole_milk`, per mm), or
    a `color` in [0, 1] (that of a large body of the medium, if light is scattered evenly) with a `radius` (1 / sigma_t,
    a number or rgb > 0, default 1) and a `boundary_eta` (the index of the boundary behind which it is to have that
    colour, 1 to 4, default 1: none); `asymmetry` (in (-1, 1), in place of a phase function: `sigma_t` and `albedo` are
    those of a medium whose phase function has this mean cosine, and become those of one that looks the same deep below
    its surface, and scatters evenly: `djpt.media.translucent.similar`);
    `has_spectral_extinction` (default true; false: `sigma_t` is grey, and a colour's first channel counts), a phase
    function, `sample_emitters` and `emission` (the same everywhere).
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {"scale": ParamFlags.Differentiable}
    statics: ClassVar[Sequence[str]] = ("m_sample_emitters", "m_has_spectral_extinction")
    m_is_homogeneous = True
    is_tracked = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if "asymmetry" in props and not has_flag(self.phase.flags(), PhaseFunctionFlags.Isotropic):
            raise props.error("asymmetry", f"takes the place of a phase function, found '{self.phase.id()}'")
        if not self.sigma_t.is_constant:
            raise SceneError(f"{props.node}: 'sigma_t' must be the same everywhere; a 'heterogeneous' medium varies")
        if self.emission is not None and not self.emission.is_constant:
            raise SceneError(f"{props.node}: 'emission' must be the same everywhere; a 'heterogeneous' medium varies")

    def defaults(self, props: Properties) -> tuple[Any, Any]:
        return translucent(props) or super().defaults(props)

    def move_into(self, frame: Frame) -> None:
        super().move_into(frame)

    def of_extinction(self) -> Sequence[Plugin]:
        return []

    # ---- coefficients ------------------------------------------------------------------

    def extinction(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        """sigma_t, for light that comes from `mi.wi`."""
        sigma_t = self.sigma_t.eval(mi, active)
        if not self.m_has_spectral_extinction:
            sigma_t = Color3f(sigma_t.x)
        return dr.minimum(self.effective(sigma_t, mi, active), DENSEST)

    def get_majorant(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        return dr.select(active, self.extinction(mi, active), 0)

    def get_scattering_coefficients(
        self, mi: MediumInteraction3f, active: Bool | bool = True
    ) -> tuple[Color3f, Color3f, Color3f]:
        sigma_t = dr.select(active, self.extinction(mi, active), 0)
        return sigma_t * self.albedo.eval(mi, active), Color3f(0), sigma_t

    def intersect_aabb(self, ray: Ray3f) -> tuple[Bool, Float, Float]:
        return Bool(True), Float(0), Float(dr.inf)

    # ---- flights -------------------------------------------------------------------------

    def reach(
        self, ray: Ray3f, channel: UInt32 | None, throughput: Color3f, stream: SampleStream, active: Bool
    ) -> Float:
        sigma_t = self.extinction(MediumInteraction3f.on(ray, Float(0)), active)
        return self.drawn(self.rates(sigma_t, channel), channel, throughput, stream, active)[0]

    def rates(self, sigma_t: Color3f, channel: UInt32 | None) -> Color3f:
        """The rates of collisions at which channels draw distances: sigma_t.

        If one `channel` draws all distances of a path, and has no extinction here, it would never find what scatters
        in the others: it draws by the largest.
        """
        if channel is None or not self.has_spectral_extinction():
            return sigma_t
        return dr.select(sigma_t > 0, sigma_t, dr.max(sigma_t))

    def drawn(
        self, rates: Color3f, channel: UInt32 | None, throughput: Color3f, stream: SampleStream, active: Bool
    ) -> tuple[Float, Color3f | None]:
        """A distance, and the probabilities of the channels that one was drawn from; None if none was."""
        shares = None
        if not self.has_spectral_extinction():
            channel = None
        elif channel is None:
            shares = channel_probabilities(rates, dr.detach(throughput))
            channel = channel_drawn(shares, stream.next_1d(active))
        return -dr.log(1 - stream.next_1d(active)) * dr.rcp(of_channel(rates, channel)), shares

    def fly(
        self,
        ray: Ray3f,
        length: Float,
        channel: UInt32 | None,
        throughput: Color3f,
        stream: SampleStream,
        active: Bool,
    ) -> Flight:
        sigma_t = self.extinction(MediumInteraction3f.on(ray, Float(0)), active)
        fixed = self.rates(dr.detach(sigma_t), channel)
        differentiated = dr.grad_enabled(sigma_t)
        if differentiated:
            # Derivatives by a thin medium are those of scattering that is hardly ever sampled, or never.
            fixed = dr.maximum(fixed, dr.rcp(minimum(maximum(length, 1 / FAR), FAR)))
        coloured = self.has_spectral_extinction()
        t, shares = self.drawn(fixed, channel, throughput, stream, active)
        scattered = active & (t < length)
        # Mitsuba draws a number here that decides whether the collision is real.
        stream.next_1d(scattered)
        albedo = self.albedo.eval(MediumInteraction3f.on(ray, t), scattered)
        value, pdf = dr.select(scattered, albedo, 1), Color3f(1)
        if coloured or differentiated:
            flown = minimum(dr.select(scattered, t, length), FAR)
            value = value * (dr.exp(-flown * sigma_t) * dr.select(scattered, sigma_t, 1))
            pdf = dr.exp(-flown * fixed) * dr.select(scattered, fixed, 1)
        if shares is not None:
            value, pdf = value * dr.rcp(dr.dot(shares, pdf)), Color3f(1)
        elif not coloured:
            value, pdf = value * dr.rcp(pdf), Color3f(1)
        emitted = self.glow(ray, sigma_t, minimum(length, FAR)) if self.emits() else Color3f(0)
        return Flight(t, scattered, value, pdf, emitted)

    def glow(self, ray: Ray3f, sigma_t: Color3f, length: Float) -> Color3f:
        """The light of a whole segment: emission (1 - exp(-sigma_t length)) / sigma_t."""
        x = sigma_t * length
        thin = x < THIN
        # The difference from 1 loses its digits where little is absorbed.
        series = length * (1 - x * (1 / 2 - x * (1 / 6 - x * (1 / 24))))
        reached = dr.select(thin, series, (1 - dr.exp(-x)) * dr.rcp(dr.select(thin, 1, sigma_t)))
        return self.emission_at(MediumInteraction3f.on(ray, Float(0))) * reached

    def passing_weight(self, ray: Ray3f, t: Float, throughput: Color3f, active: Bool | bool = True) -> Color3f:
        if not self.has_spectral_extinction():
            return Color3f(1)
        sigma_t = self.extinction(MediumInteraction3f.on(ray, Float(0)), active)
        left = dr.exp(-minimum(t, FAR) * sigma_t)
        probability = dr.dot(channel_probabilities(sigma_t, dr.detach(throughput)), left)
        return dr.select(probability > 0, left * dr.rcp(probability), 0)

    def transmittance(self, ray: Ray3f, length: Float, stream: SampleStream | None, active: Bool) -> Color3f:
        sigma_t = self.extinction(MediumInteraction3f.on(ray, Float(0)), active)
        return dr.exp(-minimum(length, FAR) * sigma_t)


def channel_probabilities(sigma_t: Color3f, throughput: Color3f) -> Color3f:
    """The probability with which each channel samples a flight; the sum is 1.

    Light of a dense channel comes from near and is scattered often, and there is less of it: relative to that, its
    noise would be the largest. So a channel counts by what is left in it, `throughput`, and more where it is dense;
    one without matter counts as well, since its light goes furthest.
    """
    importance = throughput * (sigma_t + dr.mean(sigma_t))
    total = dr.sum(importance)
    return dr.select(total > 0, importance * dr.rcp(total), 1 / 3)


def channel_drawn(shares: Color3f, u: Float) -> UInt32:
    """The channel that a uniform number selects."""
    last: UInt32 = dr.select(u < shares.x + shares.y, UInt32(1), UInt32(2))
    return dr.select(u < shares.x, UInt32(0), last)


register_medium("homogeneous", Homogeneous)

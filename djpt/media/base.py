"""The contract of media."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import lookup
from djpt.kernels import minimum
from djpt.records import Ray3f, SurfaceInteraction3f
from djpt.records.media import MediumInteraction3f
from djpt.samplers.base import SampleStream
from djpt.types import Bool, Color3f, Float, UInt32

__all__ = ["FAR", "Flight", "Medium", "of_channel"]

FAR = 1e30
"""The length of a ray without an end: times a coefficient of 0 it is 0, unlike infinity."""


@dataclass
class Flight:
    """A segment of a path in a medium, as long as it was sampled."""

    t: Float
    """Where light is scattered; unspecified where it isn't."""
    scattered: Bool
    """True where the segment ends in the medium, else the light has passed it."""
    value: Color3f
    """The transmittance of what was flown, times the scattering coefficient where light is scattered."""
    pdf: Color3f
    """The density of such a flight if the distance had been sampled by each channel's coefficient; detached.

    Factors that `value` and `pdf` share are left out of both.
    """

    @staticmethod
    def none() -> Flight:
        """A segment without a medium."""
        return Flight(Float(dr.inf), Bool(False), Color3f(1), Color3f(1))


class Medium(Plugin):
    """Matter between surfaces, which absorbs and scatters light.

    Lengths are in units of the world, coefficients per unit of length. Per length light meets matter sigma_t times,
    and is scattered sigma_s times = albedo sigma_t.

    A class says how large the coefficients are, by `get_majorant`, `get_scattering_coefficients` and
    `intersect_aabb`, as in Mitsuba. All methods below "in kernels" run once per class, with per-lane values (see
    `djpt.dispatch.ensemble`).

    Parameters of all media: a nested phase function (any key; default `isotropic`), `sample_emitters` (default true:
    light sampling at points in the medium).
    """

    kind: ClassVar[str] = "medium"

    m_sample_emitters: bool = True
    m_is_homogeneous: bool = False
    m_has_spectral_extinction: bool = True
    phase: Any = None
    """The phase function, a plugin of kind `phase`; None if nothing is scattered."""

    def __init__(self, props: Properties | None = None) -> None:
        super().__init__(props)
        if props is None:
            return
        self.phase = props.child("phase") or lookup("phase", "isotropic")(
            Properties("isotropic", f"{props.node}.phase_function", {}, f"{props.id()}.phase_function")
        )
        self.m_sample_emitters = props.boolean("sample_emitters", True)

    def traverse(self, callback: TraversalCallback) -> None:
        if self.phase is not None:
            callback.put("phase_function", self.phase)

    # ---- what is known when kernels are traced ---------------------------------------

    def phase_function(self) -> Any:
        """The phase function."""
        return self.phase

    def use_emitter_sampling(self) -> bool:
        """Whether emitters are sampled from points in the medium."""
        return self.m_sample_emitters

    def is_homogeneous(self) -> bool:
        """Whether the medium is the same everywhere."""
        return self.m_is_homogeneous

    def has_spectral_extinction(self) -> bool:
        """Whether the extinction may differ between the channels."""
        return self.m_has_spectral_extinction

    # ---- in kernels: coefficients ------------------------------------------------------

    def get_majorant(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        """A coefficient that sigma_t never exceeds: of `mi` only `wi` is known."""
        raise NotImplementedError

    def get_scattering_coefficients(
        self, mi: MediumInteraction3f, active: Bool | bool = True
    ) -> tuple[Color3f, Color3f, Color3f]:
        """sigma_s, sigma_n = majorant - sigma_t, and sigma_t at a point."""
        raise NotImplementedError

    def intersect_aabb(self, ray: Ray3f) -> tuple[Bool, Float, Float]:
        """Whether a ray meets the box around the medium, and where it enters and leaves it."""
        raise NotImplementedError

    # ---- in kernels: collisions, as scripts ask for them ---------------------------------

    def sample_interaction(
        self, ray: Ray3f, sample: Float, channel: UInt32, active: Bool | bool = True
    ) -> MediumInteraction3f:
        """Sample a collision, null collisions included, by the majorant of a channel.

        t = t_0 - log(1 - sample) / majorant, where the ray enters the medium's box at t_0; infinite if that lies beyond
        the ray's end.
        """
        mei = MediumInteraction3f.on(ray, Float(dr.inf))
        meets, mint, maxt = self.intersect_aabb(ray)
        active = Bool(active) & meets & (dr.isfinite(mint) | dr.isfinite(maxt))
        mint = dr.select(active, dr.maximum(mint, 0), Float(0))
        maxt = minimum(dr.select(active, maxt, dr.inf), ray.maxt)
        mei.combined_extinction = self.get_majorant(mei, active)
        t = mint - dr.log(1 - sample) * dr.rcp(of_channel(mei.combined_extinction, channel))
        valid = active & (t <= maxt)
        mei.t, mei.p, mei.mint = dr.select(valid, t, dr.inf), ray(t), mint
        mei.sigma_s, mei.sigma_n, mei.sigma_t = self.get_scattering_coefficients(mei, valid)
        return mei

    def transmittance_eval_pdf(
        self, mi: MediumInteraction3f, si: SurfaceInteraction3f, active: Bool | bool = True
    ) -> tuple[Color3f, Color3f]:
        """The transmittance up to a sampled collision or, if it is closer, a surface; and the density of coming there.

        For the majorant, so null collisions included; the density is of the distance, or of having passed it.
        """
        length = minimum(mi.t, si.t) - mi.mint
        passed = dr.exp(-length * mi.combined_extinction)
        return passed, dr.select(si.t < mi.t, passed, passed * mi.combined_extinction)

    # ---- in kernels: flights, as integrators ask for them ----------------------------------

    def fly(self, ray: Ray3f, length: Float, channel: UInt32 | None, stream: SampleStream, active: Bool) -> Flight:
        """Sample how far light gets on a segment of a ray with a unit direction.

        Where `active`, numbers are drawn from `stream`. `channel` is the one that samples distances; None if the
        extinction of no medium differs between channels.
        """
        raise NotImplementedError

    def transmittance(self, ray: Ray3f, length: Float, stream: SampleStream | None, active: Bool) -> Color3f:
        """The share of light that is left after a segment of a ray with a unit direction, or an estimate of it.

        Where `active`, numbers are drawn from `stream`, which only an estimate needs.
        """
        raise NotImplementedError


def of_channel(color: Color3f, channel: UInt32 | None) -> Float:
    """The component of a channel; of a grey, which needs no channel, the first."""
    if channel is None:
        return color.x
    return dr.select(channel == 0, color.x, dr.select(channel == 1, color.y, color.z))

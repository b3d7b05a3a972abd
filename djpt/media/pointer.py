"""Per-lane media."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.core.records.interactions import MediumInteraction3f
from djpt.dispatch.family import Pointer
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.media.base import Medium
from djpt.phase.pointer import PhaseFunctionPtr

__all__ = ["MediumPtr"]


class MediumPtr(Pointer[Medium]):
    """The medium of each lane, or none. Methods as in `djpt.media.base.Medium`; numbers are 0 where there is none."""

    def phase_function(self) -> PhaseFunctionPtr:
        """The phase functions of the media."""
        return self.related(PhaseFunctionPtr, lambda medium: medium.phase_function())

    def use_emitter_sampling(self) -> Bool:
        """True where emitters are sampled from points in the medium."""
        return self.holds(lambda medium: medium.use_emitter_sampling())

    def is_homogeneous(self) -> Bool:
        """True where the medium is the same everywhere."""
        return self.holds(lambda medium: medium.is_homogeneous())

    def has_spectral_extinction(self) -> Bool:
        """True where the extinction may differ between the channels."""
        return self.holds(lambda medium: medium.has_spectral_extinction())

    def get_majorant(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        """The majorant."""
        value = self._ask(lambda medium: medium.get_majorant(mi, active), Color3f(0))
        return dr.select(active, value, 0)

    def get_scattering_coefficients(
        self, mi: MediumInteraction3f, active: Bool | bool = True
    ) -> tuple[Color3f, Color3f, Color3f]:
        """sigma_s, sigma_n and sigma_t."""
        nothing = (Color3f(0), Color3f(0), Color3f(0))
        found = self._ask(lambda medium: medium.get_scattering_coefficients(mi, active), nothing)
        return dr.select(active, found, nothing)

    def intersect_aabb(self, ray: Ray3f) -> tuple[Bool, Float, Float]:
        """The intersection of a ray with the medium's box: True if any, and the distances of entry and exit."""
        nothing = (Bool(False), Float(0), Float(dr.inf))
        return self._ask(lambda medium: medium.intersect_aabb(ray), nothing)

    def sample_interaction(
        self, ray: Ray3f, sample: Float, channel: UInt32, active: Bool | bool = True
    ) -> MediumInteraction3f:
        """Sample a collision along a ray; none where there is no medium."""
        mei: MediumInteraction3f = self.ensemble.call(
            self.index, self.lookup, lambda medium: medium.sample_interaction(ray, sample, channel, active), None
        )
        mei.t = dr.select(self.is_valid() & active, mei.t, dr.inf)
        mei.medium = self
        return mei

    def transmittance_eval_pdf(
        self, mi: MediumInteraction3f, si: SurfaceInteraction3f, active: Bool | bool = True
    ) -> tuple[Color3f, Color3f]:
        """The transmittance up to a collision or a surface, and the density of having got there."""
        nothing = (Color3f(0), Color3f(0))
        found = self._ask(lambda medium: medium.transmittance_eval_pdf(mi, si, active), nothing)
        return dr.select(active, found, nothing)

    def _ask(self, method: Any, otherwise: Any) -> Any:
        return self.ensemble.call(self.index, self.lookup, method, otherwise)

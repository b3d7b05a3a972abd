"""Matter that absorbs and doesn't scatter: bodies of coloured glass."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr

from djpt.core.records import Ray3f
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.plugin import Plugin
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.materials.base import BSDF
from djpt.media.base import Medium
from djpt.media.flight import Flight
from djpt.samplers.base import SampleStream

__all__ = ["AbsorbingBody"]


class AbsorbingBody(Medium):
    """The interior of shapes whose BSDF `absorbs`. Its values are the BSDF's."""

    children = ("bsdf",)
    m_is_homogeneous = True
    is_tracked = False
    m_sample_emitters = False
    m_has_spectral_extinction = False  # no distance is sampled by a channel
    bsdf: BSDF

    def __init__(self, bsdf: BSDF) -> None:
        super().__init__()
        self.set_id(f"{bsdf.id()}.absorption")
        self.bsdf = bsdf

    def of_extinction(self) -> Sequence[Plugin]:
        return []

    def get_majorant(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        return dr.select(active, -dr.log(self.bsdf.transmittance(Float(1))), 0)

    def get_scattering_coefficients(
        self, mi: MediumInteraction3f, active: Bool | bool = True
    ) -> tuple[Color3f, Color3f, Color3f]:
        return Color3f(0), Color3f(0), self.get_majorant(mi, active)

    def intersect_aabb(self, ray: Ray3f) -> tuple[Bool, Float, Float]:
        return Bool(True), Float(0), Float(dr.inf)

    def fly(
        self,
        ray: Ray3f,
        length: Float,
        channel: UInt32 | None,
        throughput: Color3f,
        stream: SampleStream,
        active: Bool,
    ) -> Flight:
        return Flight(Float(dr.inf), Bool(False), self.transmittance(ray, length, None, active), Color3f(1), Color3f(0))

    def transmittance(self, ray: Ray3f, length: Float, stream: SampleStream | None, active: Bool) -> Color3f:
        # Rays that meet nothing are infinitely long: whatever they are in has no end.
        return self.bsdf.transmittance(dr.select(length < dr.inf, length, 0))

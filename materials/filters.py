"""Filters of polarised light, for light that isn't polarised: they let a fraction of it pass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.jit.types import Bool, Color3f, Float
from djpt.materials.base import DeltaBSDF

__all__ = ["Filter"]


class Filter(DeltaBSDF):
    """A sheet that all light passes straight through, less what it absorbs: wo = -wi, weight share * transmittance.

    djpt's light has no polarisation, as in Mitsuba's unpolarised variants.

    Parameters: `transmittance` (texture in [0, 1], default 1) of an ideal filter's light.
    """

    children: ClassVar[Sequence[str]] = ("passed",)

    share: ClassVar[float] = 1.0
    """The fraction of unpolarised light that an ideal filter lets through."""
    lobe: ClassVar[int] = int(BSDFFlags.Null | BSDFFlags.FrontSide | BSDFFlags.BackSide)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.passed = props.texture("transmittance", 1.0, low=0.0, high=1.0)

    def traverse(self, callback: TraversalCallback) -> None:
        for name in self.children:
            callback.put("transmittance" if name == "passed" else name, getattr(self, name))

    def components(self) -> tuple[int, ...]:
        return (self.lobe,)

    def bounce(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, sample1: Float, active: Bool | bool
    ) -> tuple[BSDFSample3f, Color3f]:
        return BSDFSample3f.of(-si.wi, 1, BSDFFlags.Null), self.eval_null_transmission(si, active)

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.passed.eval(si, active) * self.share

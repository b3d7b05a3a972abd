"""Points within participating media."""

from __future__ import annotations

from typing import Any

from djpt.frame import Frame3f
from djpt.records.interactions import Interaction3f
from djpt.types import Color3f, Float, Vector3f

__all__ = ["MediumInteraction3f"]


class MediumInteraction3f(Interaction3f):
    """A point in a medium, where light is scattered or absorbed: ``MediumInteraction3f()``, ``(mi)``, or keywords."""

    title = "MediumInteraction"

    sh_frame: Frame3f
    """A frame whose third axis is `wi`; phase functions sample in it."""
    wi: Vector3f
    """Direction back along the ray, in world space."""
    sigma_s: Color3f
    """Scattering coefficient, per unit length."""
    sigma_n: Color3f
    """What the majorant exceeds the extinction by, per unit length."""
    sigma_t: Color3f
    """Extinction coefficient, per unit length."""
    combined_extinction: Color3f
    """The majorant of the extinction, per unit length."""
    mint: Float
    """Where the ray was inside the medium first."""

    def default(self, name: str) -> Any:
        return Frame3f.from_normal(self.wi) if name == "sh_frame" else super().default(name)

    @property
    def medium(self) -> None:
        """None: there are no media that scatter."""

    def to_local(self, v: Vector3f) -> Vector3f:
        """World direction to `sh_frame`."""
        return self.sh_frame.to_local(v)

    def to_world(self, v: Vector3f) -> Vector3f:
        """`sh_frame` to world."""
        return self.sh_frame.to_world(v)

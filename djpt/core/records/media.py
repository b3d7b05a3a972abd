"""Points in media."""

from __future__ import annotations

from typing import Any

from djpt.core.frame import Frame3f
from djpt.core.records.points import Interaction3f
from djpt.core.records.rays import Ray3f
from djpt.core.records.scene_ref import only
from djpt.jit.types import Color3f, Float, Point3f, Vector3f

__all__ = ["MediumInteraction3f"]


class MediumInteraction3f(Interaction3f):
    """A point in a medium, where light may be scattered.

    ``MediumInteraction3f()``, ``MediumInteraction3f(mei)``, or its fields by keywords.
    """

    title = "MediumInteraction"

    sh_frame: Frame3f
    """A frame about `wi`; made when it is first read."""
    wi: Vector3f
    """Direction back along the ray, in world space."""
    sigma_s: Color3f
    """Scattering coefficient."""
    sigma_n: Color3f
    """Coefficient of null collisions: majorant - sigma_t."""
    sigma_t: Color3f
    """Extinction coefficient: absorption and scattering."""
    combined_extinction: Color3f
    """The majorant."""
    mint: Float
    """Distance at which the ray enters the medium's box."""
    pointers: tuple[Any, ...]
    """The medium, a pointer, or nothing: see `medium`."""

    @staticmethod
    def on(ray: Ray3f, t: Float, p: Point3f | None = None) -> MediumInteraction3f:
        """The point of a ray at `t`; `p` is that point if it is known."""
        mei: MediumInteraction3f = MediumInteraction3f.holding(t=t, p=ray(t) if p is None else p, wi=-ray.d)
        mei.arrived_with(ray)
        return mei

    def default(self, name: str) -> Any:
        return Frame3f.from_normal(self.wi) if name == "sh_frame" else super().default(name)

    @property
    def medium(self) -> Any:
        """The medium, a `djpt.media.pointer.MediumPtr`; None in a record that no medium has made."""
        return only(self.pointers)

    @medium.setter
    def medium(self, medium: Any) -> None:
        self.pointers = () if medium is None else (medium,)

    def to_local(self, v: Vector3f) -> Vector3f:
        """World direction to `sh_frame`."""
        return self.sh_frame.to_local(v)

    def to_world(self, v: Vector3f) -> Vector3f:
        """`sh_frame` to world."""
        return self.sh_frame.to_world(v)

"""Records that the renderer itself has no use for."""

from __future__ import annotations

from djpt.frame import Frame3f
from djpt.records import Interaction3f
from djpt.types import Color3f, Float, Vector3f

__all__ = ["MediumInteraction3f"]


class MediumInteraction3f(Interaction3f):
    """A point in a medium. djpt has no media that scatter: scripts may fill one in, no query returns one."""

    title = "MediumInteraction"

    sh_frame: Frame3f
    wi: Vector3f
    sigma_s: Color3f
    sigma_n: Color3f
    sigma_t: Color3f
    combined_extinction: Color3f
    mint: Float

    @property
    def medium(self) -> None:
        """None: there are no media that scatter."""

    def to_local(self, v: Vector3f) -> Vector3f:
        """World direction to `sh_frame`."""
        return self.sh_frame.to_local(v)

    def to_world(self, v: Vector3f) -> Vector3f:
        """`sh_frame` to world."""
        return self.sh_frame.to_world(v)

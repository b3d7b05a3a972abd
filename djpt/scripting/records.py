"""Records that the renderer itself has no use for."""

from __future__ import annotations

from typing import Any

from djpt.frame import Frame3f
from djpt.records import Interaction3f, Ray3f
from djpt.types import Color3f, Float, Point2f, Point3f, Vector2f, Vector3f

__all__ = ["MediumInteraction3f", "Ray2f", "RayDifferential3f"]


class Ray2f(Ray3f):
    """o + t d in the plane, for 0 < t < maxt; made like a `Ray3f`."""

    o: Point2f  # type: ignore[assignment]
    d: Vector2f  # type: ignore[assignment]


class RayDifferential3f(Ray3f):
    """A ray with the rays through the neighbouring pixels: `o_x`, `d_x` to the right, `o_y`, `d_y` below.

    Made as ``RayDifferential3f()``, ``RayDifferential3f(ray)`` or ``RayDifferential3f(o, d, time=0, wavelengths=[])``,
    without differentials: assign them, and set `has_differentials`.
    """

    o_x: Point3f
    o_y: Point3f
    d_x: Vector3f
    d_y: Vector3f

    def __init__(self, o: Any = None, d: Any = None, time: Any = None, wavelengths: Any = None, **fields: Any) -> None:
        own = {name: fields.pop(name) for name in ("o_x", "o_y", "d_x", "d_y") if name in fields}
        super().__init__(o, d, time=time, wavelengths=wavelengths, **fields)
        for name, value in own.items():
            setattr(self, name, value)
        self.has_differentials = getattr(o, "has_differentials", False)
        """Whether the differentials mean anything."""

    def scale_differential(self, amount: Float | float) -> None:
        """Move the neighbouring rays closer to this one (`amount` < 1), as for several samples per pixel."""
        self.o_x, self.o_y = ((o - self.o) * amount + self.o for o in (self.o_x, self.o_y))
        self.d_x, self.d_y = ((d - self.d) * amount + self.d for d in (self.d_x, self.d_y))


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

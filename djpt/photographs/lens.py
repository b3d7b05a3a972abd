"""Lenses: what of a camera doesn't depend on its place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from djpt.errors import SceneError
from djpt.photographs.fields import integer, number

__all__ = ["FISHEYE", "LARGEST_SIDE", "PERSPECTIVE", "AllAround", "Lens"]

LARGEST_SIDE = 2**16
"""The most columns or rows of a photograph."""

PERSPECTIVE = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
"""The coefficients of Brown and Conrady's model, in OpenCV's form: see `djpt.sensors.distorted`."""

FISHEYE = ("k1", "k2", "k3", "k4")
"""Those of OpenCV's fisheye model: see `djpt.sensors.fisheye`."""


@dataclass(frozen=True)
class Lens:
    """The size of a picture, and where in it directions are shown.

    A direction with the ideal image (x, y) in focal lengths, x to the right and y down, is shown at the pixel
    (cx + fx x', cy + fy y') with (x', y') the distorted image. Pixels count from the upper left corner: the centre of
    the first one is (0.5, 0.5).

    Raises:
        SceneError: a number isn't finite, or no camera has it.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    fisheye: bool = False
    """Whether the distance from the centre grows with the angle, not with its tangent."""
    coefficients: Mapping[str, float] = field(default_factory=dict)
    """Those of the distortion that aren't 0, by the names in `PERSPECTIVE` or `FISHEYE`."""

    def __post_init__(self) -> None:
        integer(self.width, "the width", 1, LARGEST_SIDE)
        integer(self.height, "the height", 1, LARGEST_SIDE)
        for name in ("fx", "fy", "cx", "cy"):
            number(getattr(self, name), name)
        for name, value in self.coefficients.items():
            number(value, name)
            if name not in (FISHEYE if self.fisheye else PERSPECTIVE):
                kind = "fisheye" if self.fisheye else "perspective"
                raise SceneError(f"a {kind} camera has no coefficient '{name}'")
        if not (self.fx > 0 and self.fy > 0):
            raise SceneError(f"focal lengths must be greater than 0, found {self.fx:g} and {self.fy:g}")

    def resized(self, width: int, height: int) -> Lens:
        """The lens of the same picture with another number of pixels."""
        x, y = width / self.width, height / self.height
        return Lens(width, height, self.fx * x, self.fy * y, self.cx * x, self.cy * y, self.fisheye, self.coefficients)

    def entries(self) -> dict[str, Any]:
        """The entries of a sensor, all but `film` and `to_world`.

        A `perspective` camera without distortion whose pixels are square is described as Mitsuba does it, too: by
        `fov` and the offsets of the principal point.
        """
        pixels = {"fx": self.fx, "fy": self.fy, "cx": self.cx, "cy": self.cy}
        if self.fisheye:
            return {"type": "fisheye", **pixels, **dict.fromkeys(FISHEYE, 0.0), **self.coefficients}
        if self.coefficients or self.fx != self.fy:
            return {"type": "perspective", **pixels, **self.coefficients}
        return {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(self.width / (2 * self.fx))),
            "principal_point_offset_x": 0.5 - self.cx / self.width,
            "principal_point_offset_y": 0.5 - self.cy / self.height,
        }


@dataclass(frozen=True)
class AllAround:
    """An equirectangular picture: columns are azimuths over a full turn, rows elevations from 90 to -90 degrees.

    The middle of the picture shows what is ahead.

    Raises:
        SceneError: the size isn't one.
    """

    width: int
    height: int

    def __post_init__(self) -> None:
        integer(self.width, "the width", 1, LARGEST_SIDE)
        integer(self.height, "the height", 1, LARGEST_SIDE)

    def resized(self, width: int, height: int) -> AllAround:
        """The same picture with another number of pixels."""
        return AllAround(width, height)

    def entries(self) -> dict[str, Any]:
        """The entries of a sensor, all but `film` and `to_world`."""
        return {"type": "panorama"}

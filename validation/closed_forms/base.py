"""Closed forms, and the parts of their scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from djpt.core.transforms import ScalarTransform4f as T

__all__ = ["ALBEDO", "ClosedForm", "area", "camera", "floor"]

ALBEDO = 0.6
"""The reflectance of floors."""

Keys = dict[str, Any]


@dataclass(frozen=True)
class ClosedForm:
    """A scene all of whose pixels have the same radiance, which a formula gives.

    * `name`: for tables and command lines.
    * `formula`: in words of the field, ASCII.
    * `source`: where the formula comes from.
    * `scene`: makes the scene's dict, without an integrator.
    * `radiance`: what the formula gives, the same in all channels.
    * `depth`: the number of edges of the longest path, for integrators to be told.
    * `integrators`: the names of the integrators that find all of this light.
    * `exact`: the relative error that an approximation of the scene causes, such as a floor that isn't endless.
    """

    name: str
    formula: str
    source: str
    scene: Callable[[], Keys]
    radiance: float
    depth: int
    integrators: tuple[str, ...]
    exact: float = 1e-4


def camera(target: Any, origin: Any, up: Any = (0, 1, 0), size: int = 8, fov: float = 1e-3) -> Keys:
    """A camera of narrow view: all its pixels see one point."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    return {"type": "perspective", "fov": fov, "to_world": T().look_at(origin, target, up), "film": film}


def area(radiance: float) -> Keys:
    """The emitter of a lamp."""
    return {"type": "area", "radiance": radiance}


def floor(**lights: Keys) -> Keys:
    """The origin of a large diffuse floor z = 0, seen from the side, under some lights."""
    plane = {"type": "rectangle", "to_world": T().scale(1000.0), "bsdf": {"type": "diffuse", "reflectance": ALBEDO}}
    return {"type": "scene", "sensor": camera((0, 0, 0), (3, 3, 2.0), up=(0, 0, 1)), "floor": plane, **lights}

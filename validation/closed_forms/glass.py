"""Panes, slabs, mirrors and metals: Fresnel's equations."""

from __future__ import annotations

import math
from typing import Any

from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation.closed_forms.base import ClosedForm, area, camera

__all__ = ["ABOVE", "BELOW", "GLASS", "dielectric", "pane"]

FOLLOWING = ("path", "prb", "path_naive", "prb_basic", "whitted", "distributed", "volpath", "volpathmis", "bdpt")
ABOVE, BELOW, ANGLE = 2.0, 5.0, 50.0


def dielectric(angle: float, ior: float) -> float:
    """Reflectance of unpolarised light at an interface; `angle` in degrees, outside."""
    outside, inside = math.cos(math.radians(angle)), math.sqrt(1 - (math.sin(math.radians(angle)) / ior) ** 2)
    perpendicular = (outside - ior * inside) / (outside + ior * inside)
    parallel = (ior * outside - inside) / (ior * outside + inside)
    return (perpendicular**2 + parallel**2) / 2


def pane(angle: float, **shape: Any) -> dict[str, Any]:
    """A pane z < 0 between a sky of radiance ABOVE and a black floor that shines with BELOW.

    It is seen from above, `angle` degrees off its normal.
    """
    a = math.radians(angle)
    return {
        "type": "scene",
        "sensor": camera((0, 0, 0), (3 * math.sin(a), 0, 3 * math.cos(a))),
        "sky": {"type": "constant", "radiance": ABOVE},
        "pane": shape,
        "floor": {
            "type": "rectangle",
            "to_world": T().translate([0, 0, -1]).scale(20.0),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": area(BELOW),
        },
    }


def slab() -> dict[str, Any]:
    """A slab of glass."""
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return pane(ANGLE, type="cube", to_world=T().translate([0, 0, -0.1]).scale([20, 20, 0.1]), bsdf=glass)


def metal() -> dict[str, Any]:
    """A flat piece of metal under the sky, seen from above."""
    return pane(0.0, type="rectangle", to_world=T().scale(20.0), bsdf={"type": "conductor", "eta": 0.2, "k": 3.9})


def water() -> dict[str, Any]:
    """Water over a black floor that shines, seen from above at ANGLE."""
    glass = {"type": "dielectric", "int_ior": 1.33, "ext_ior": 1.0}
    return pane(ANGLE, type="rectangle", to_world=T().scale(20.0), bsdf=glass)


W = dielectric(ANGLE, 1.33)
R = dielectric(ANGLE, 1.5)
THIN = 2 * R / (1 + R)
DEPTH = 16
UP = R + (1 - R) ** 2 * R * sum(R ** (2 * k) for k in range(99) if 4 + 2 * k <= DEPTH)
DOWN = (1 - R) ** 2 * sum(R ** (2 * k) for k in range(99) if 3 + 2 * k <= DEPTH)

GLASS = (
    ClosedForm(
        "thin pane",
        "L = R' e_above + (1 - R') e_below, R' = 2 R / (1 + R)",
        "A. Fresnel (1823); G. G. Stokes (1862) for the reflections inside",
        lambda: pane(
            ANGLE,
            type="rectangle",
            to_world=T().scale(20.0),
            bsdf={"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0},
        ),
        ABOVE * THIN + BELOW * (1 - THIN),
        2,
        FOLLOWING,
    ),
    ClosedForm(
        "slab of glass",
        "L = e_above (R + T^2 R (1 + R^2 + ..)) + e_below T^2 (1 + R^2 + ..)",
        "A. Fresnel (1823)",
        slab,
        ABOVE * UP + BELOW * DOWN,
        DEPTH,
        FOLLOWING,
    ),
    ClosedForm(
        "lamp under water",
        "L = R e_above + (1 - R) e_below / eta^2",
        "basic radiance, R. Clausius (1864); F. Nicodemus (1963)",
        water,
        ABOVE * W + BELOW * (1 - W) / 1.33**2,
        2,
        FOLLOWING,
    ),
    ClosedForm(
        "metal",
        "L = e ((eta - 1)^2 + k^2) / ((eta + 1)^2 + k^2)",
        "A.-L. Cauchy (1836); Born and Wolf, Principles of Optics, 14.2",
        metal,
        ABOVE * ((0.2 - 1) ** 2 + 3.9**2) / ((0.2 + 1) ** 2 + 3.9**2),
        2,
        FOLLOWING,
    ),
)
"""Closed forms of specular reflection and refraction."""

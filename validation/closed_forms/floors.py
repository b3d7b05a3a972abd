"""Light on a diffuse floor: inverse squares and form factors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation.closed_forms.base import ALBEDO, ClosedForm, area, camera, floor

__all__ = ["FLOORS", "parallel_rectangle"]

SAMPLING_LIGHTS = ("path", "prb", "direct", "path_nee", "distributed", "volpath", "volpathmis", "bdpt")
BY_CHANCE = ("path_naive", "prb_basic")
"""Integrators that find lamps by directions of BSDFs alone, and so no points and no parallel light."""

HOWELL = "J. Howell, A Catalog of Radiation Heat Transfer Configuration Factors"
RADIANCE = 4.0


def parallel_rectangle(a: float, b: float, c: float) -> float:
    """Form factor of a small patch to a rectangle a x b in a parallel plane at distance c, one corner above it."""
    x, y = a / c, b / c
    p, q = math.sqrt(1 + x * x), math.sqrt(1 + y * y)
    return (x / p * math.atan(y / p) + y / q * math.atan(x / q)) / (2 * math.pi)


def perpendicular_rectangle(a: float, b: float, c: float) -> float:
    """Form factor of a small patch to a rectangle at distance c, upright, of height a from the patch's plane, width b.

    The patch lies in front of one of its lower corners.
    """
    x, y = a / b, c / b
    return (math.atan(1 / y) - y / math.hypot(x, y) * math.atan(1 / math.hypot(x, y))) / (2 * math.pi)


def disk_overhead(radius: float, height: float) -> float:
    """Form factor of a small patch to a disk whose axis goes through it."""
    return radius**2 / (radius**2 + height**2)


def half_a_sky() -> dict[str, Any]:
    """A black endless wall hides half of the sky from the foot of it."""
    black = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": 0.0}}
    turned = T().translate([-1e-3, 0, 0]).rotate([0, 1, 0], 90).scale(1000.0)
    wall = {"type": "rectangle", "to_world": turned, "bsdf": black}
    return floor(sky={"type": "constant", "radiance": RADIANCE}, wall=wall)


def painted() -> dict[str, Any]:
    """A rectangle with a dark half below a bright one, under a sky; the camera sees the bright half, where v > 1/2."""
    paint = {
        "type": "bitmap",
        "data": np.array([[0.2], [0.8]], np.float32)[..., None].repeat(3, axis=2),
        "raw": True,
        "filter_type": "nearest",
    }
    return {
        "type": "scene",
        "sensor": camera((0, 0.5, 0), (0, 0.5, 3.0)),
        "sky": {"type": "constant", "radiance": RADIANCE},
        "picture": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": paint}},
    }


FLOORS = (
    ClosedForm(
        "point light",
        "L = rho / pi I cos / r^2",
        "inverse square law; J. H. Lambert, Photometria (1760)",
        lambda: floor(light={"type": "point", "position": [1.0, 0, 1.0], "intensity": 3.0}),
        ALBEDO / math.pi * 3.0 / math.sqrt(2) / 2,
        2,
        (*SAMPLING_LIGHTS, "whitted"),
    ),
    ClosedForm(
        "sunlight",
        "L = rho / pi E cos",
        "J. H. Lambert, Photometria (1760)",
        lambda: floor(sun={"type": "directional", "direction": [math.sqrt(0.75), 0, -0.5], "irradiance": 2.0}),
        ALBEDO / math.pi * 2.0 * 0.5,
        2,
        (*SAMPLING_LIGHTS, "whitted"),
    ),
    ClosedForm(
        "two lights",
        "L = rho / pi (I_1 cos_1 / r_1^2 + I_2 cos_2 / r_2^2)",
        "light adds up",
        lambda: floor(
            near={"type": "point", "position": [0, 0, 1.0], "intensity": 1.0},
            far={"type": "point", "position": [0, 0, 2.0], "intensity": 12.0},
        ),
        ALBEDO / math.pi * (1.0 + 12.0 / 4),
        2,
        tuple(name for name in SAMPLING_LIGHTS if name != "distributed"),
    ),
    ClosedForm(
        "half a sky",
        "L = rho e / 2",
        "form factor 1/2 of a half space seen edge-on",
        half_a_sky,
        ALBEDO * RADIANCE / 2,
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
        1e-3,
    ),
    ClosedForm(
        "painted floor",
        "L = rho(u, v) e",
        "texture coordinates: the rows of a bitmap begin at v = 0",
        painted,
        0.8 * RADIANCE,
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
        3e-4,
    ),
    ClosedForm(
        "white sky",
        "L = rho e",
        "form factor 1 of all that is above",
        lambda: floor(sky={"type": "constant", "radiance": RADIANCE}),
        ALBEDO * RADIANCE,
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
        3e-4,
    ),
    ClosedForm(
        "spherical lamp",
        "L = rho e (r / d)^2 cos",
        f"{HOWELL}, B-5",
        lambda: floor(lamp={"type": "sphere", "center": [1.5, 0, 1.0], "radius": 0.6, "emitter": area(RADIANCE)}),
        ALBEDO * RADIANCE * 0.6**2 / 3.25 / math.sqrt(3.25),
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
    ),
    ClosedForm(
        "disk overhead",
        "L = rho e r^2 / (r^2 + h^2)",
        f"{HOWELL}, B-12",
        lambda: floor(
            lamp={
                "type": "disk",
                "to_world": T().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(0.7),
                "emitter": area(RADIANCE),
            }
        ),
        ALBEDO * RADIANCE * disk_overhead(0.7, 1.0),
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
    ),
    ClosedForm(
        "rectangle overhead",
        "L = rho e F, corner over the point",
        f"{HOWELL}, B-3",
        lambda: floor(
            lamp={
                "type": "rectangle",
                "to_world": T().translate([0.75, 0.4, 0.7]).rotate([1, 0, 0], 180).scale([0.75, 0.4, 1]),
                "emitter": area(RADIANCE),
            }
        ),
        ALBEDO * RADIANCE * parallel_rectangle(1.5, 0.8, 0.7),
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
    ),
    ClosedForm(
        "upright rectangle",
        "L = rho e F, standing on the floor",
        f"{HOWELL}, B-4",
        lambda: floor(
            lamp={
                "type": "rectangle",
                "to_world": T().translate([-0.8, 0.6, 0.5]).rotate([0, 1, 0], 90).scale([0.5, 0.6, 1]),
                "emitter": area(RADIANCE),
            }
        ),
        ALBEDO * RADIANCE * perpendicular_rectangle(1.0, 1.2, 0.8),
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
    ),
)
"""Closed forms of direct light."""

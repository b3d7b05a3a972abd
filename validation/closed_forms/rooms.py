"""Rooms whose walls all shine, or reflect each other: geometric series."""

from __future__ import annotations

from typing import Any

from djpt.core.transforms import ScalarTransform4f as T
from djpt.scenes import furnace
from djpt.validation.closed_forms.base import ClosedForm, area, camera

__all__ = ["ROOMS"]

FINDING_ALL = ("path", "prb", "path_naive", "prb_basic", "path_nee", "distributed", "volpath", "volpathmis", "bdpt")
DEPTH = 5
GREY = 0.7


def shining_sphere() -> dict[str, Any]:
    """The inside of a diffuse sphere that shines with radiance 1."""
    shell = {
        "type": "sphere",
        "radius": 2.0,
        "flip_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": GREY},
        "emitter": area(1.0),
    }
    return {"type": "scene", "sensor": camera((0, 0, 0), (0.3, 0.2, 1), fov=60.0), "shell": shell}


def shining_box() -> dict[str, Any]:
    """The built-in furnace, small."""
    scene = furnace(GREY, 1.0)
    scene["sensor"]["film"].update(width=8, height=8)
    del scene["integrator"]
    return scene


def facing_plates() -> dict[str, Any]:
    """Two endless parallel plates, of which the upper one shines with radiance 1; the camera sees the lower one."""
    half = {"type": "diffuse", "reflectance": 0.5}
    return {
        "type": "scene",
        "sensor": camera((0, 0, 0), (0.3, 0.3, 0.5), up=(0, 0, 1)),
        "lower": {"type": "rectangle", "to_world": T().scale(20000.0), "bsdf": half},
        "upper": {
            "type": "rectangle",
            "to_world": T().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(20000.0),
            "bsdf": half,
            "emitter": area(1.0),
        },
    }


SERIES = sum(GREY**k for k in range(DEPTH))

ROOMS = (
    ClosedForm(
        "shining sphere",
        "L = e (1 + rho + .. + rho^(n - 1))",
        "geometric series; the furnace of P. Shirley and others",
        shining_sphere,
        SERIES,
        DEPTH,
        FINDING_ALL,
        3e-4,
    ),
    ClosedForm(
        "shining box",
        "L = e (1 + rho + .. + rho^(n - 1))",
        "geometric series",
        shining_box,
        SERIES,
        DEPTH,
        # In the corners of the box the variance of `path_nee` is infinite.
        tuple(name for name in FINDING_ALL if name != "path_nee"),
        3e-4,
    ),
    ClosedForm(
        "facing plates",
        "L = e (rho + rho^3 + ..)",
        "radiosity of two endless parallel planes",
        facing_plates,
        0.5 + 0.5**3 + 0.5**5,
        7,
        ("path", "prb", "path_naive", "prb_basic"),
        1e-3,
    ),
)
"""Closed forms of light that is reflected many times."""

"""Matter that absorbs and scatters: Beer's law, furnaces, single scattering."""

from __future__ import annotations

import math
from typing import Any

from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation.closed_forms.base import ClosedForm, camera

__all__ = ["MATTER"]

FOLLOWING_MEDIA = ("volpath", "volpathmis", "prbvolpath")
MANY = 1000
"""Edges that no path of note has."""


def body(medium: dict[str, Any], **others: Any) -> dict[str, Any]:
    """A unit ball of a medium, seen along a diameter."""
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}
    return {"type": "scene", "sensor": camera((0, 0, 0), (0, 0, 4), fov=0.01), "ball": ball, **others}


def henyey_greenstein(g: float, cosine: float) -> float:
    """The density of turning by an angle."""
    return (1 - g**2) / (4 * math.pi * (1 + g**2 - 2 * g * cosine) ** 1.5)


def slab_in_sunlight() -> dict[str, Any]:
    """A slab of optical thickness 1 in perpendicular light of irradiance 1, seen from 50 degrees."""
    angle = math.radians(50.0)
    medium = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.6, "phase": {"type": "hg", "g": 0.5}}
    return {
        "type": "scene",
        "sensor": camera((0, 0, 0), (4 * math.sin(angle), 0.0, 4 * math.cos(angle)), fov=0.01),
        "sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0},
        "slab": {
            "type": "cube",
            "to_world": T().scale([50, 50, 1]),
            "bsdf": {"type": "null"},
            "interior": medium,
        },
    }


FOG = {"type": "homogeneous", "sigma_t": 3.0, "albedo": 1.0, "phase": {"type": "hg", "g": 0.6}}
SKY = {"type": "constant", "radiance": 1.0}
MU = math.cos(math.radians(50.0))
BACK = 0.6 * henyey_greenstein(0.5, -MU) / (1 + MU) * (1 - math.exp(-2 * 0.5 * (1 + 1 / MU)))

MATTER = (
    ClosedForm(
        "absorbing ball",
        "L = e exp(-2 sigma_t)",
        "A. Beer (1852)",
        lambda: body({"type": "homogeneous", "sigma_t": 0.6, "albedo": 0.0}, sky=SKY),
        math.exp(-1.2),
        MANY,
        FOLLOWING_MEDIA,
        3e-4,
    ),
    ClosedForm(
        "white ball of fog",
        "L = e: what absorbs nothing can't be seen",
        "furnace; S. Chandrasekhar, Radiative Transfer (1960)",
        lambda: body(
            {"type": "homogeneous", "sigma_t": 3.0, "albedo": 1.0, "phase": {"type": "hg", "g": 0.6}}, sky=SKY
        ),
        1.0,
        MANY,
        FOLLOWING_MEDIA,
        5e-4,
    ),
    ClosedForm(
        "slab in sunlight",
        "L = albedo p(cos) / (1 + mu) (1 - exp(-tau (1 + 1 / mu)))",
        "single scattering; S. Chandrasekhar, Radiative Transfer (1960)",
        slab_in_sunlight,
        BACK,
        2,
        FOLLOWING_MEDIA,
        5e-4,
    ),
)
"""Closed forms of media."""

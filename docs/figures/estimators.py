"""Integrators, and light by the number of its bounces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import djpt
from djpt.scenes.gallery import sheet
from places import IMAGES, LADDER

__all__ = ["bounces", "ladder"]


@dataclass(frozen=True)
class Step:
    """The room of `benchmarks/ladder.py` by one algorithm."""

    title: str
    subtitle: str
    integrator: dict[str, Any]

    def scene(self, size: int) -> dict[str, Any]:
        """The description of the panel's scene."""
        return {**LADDER["room"](size), "integrator": self.integrator}


def ladder() -> None:
    """From ray casting to path tracing, step by step at 16 samples per pixel: three strips and two halves of one."""
    spp = 16
    strips = {
        "rays": ["raycast", "whitted", "distributed"],
        "paths": ["path_naive, uniform", "path_naive, cosine", "path_nee"],
        "strategies": ["direct, light samples", "direct, BSDF samples", "direct, both"],
        "ends": ["path", "ptracer"],
    }
    for strip, names in strips.items():
        panels = [Step(*(name + ", ").split(", ")[:2], LADDER["STEPS"][name]) for name in names]
        picture = sheet(panels, size=240, spp=spp, columns=3)
        if strip == "ends":
            last = Step("path", "4096 samples per pixel", LADDER["STEPS"]["path"])
            picture = np.concatenate([picture, sheet([last], size=240, spp=4096)[:, 12:]], axis=1)
        djpt.write(IMAGES / f"ladder_{strip}.png", picture)


def bounces() -> None:
    """The terms of the Neumann series from left to right; below, their sums so far."""
    size, terms = 150, 6
    integrator = {"type": "path", "max_depth": terms, "bounces": True}
    scene = djpt.load_dict({**LADDER["room"](size), "integrator": integrator})
    series = np.array(djpt.render(scene, spp=4096))[..., 3:].reshape(size, size, terms, 3)
    rows = [np.moveaxis(row, 2, 0) for row in (series, np.cumsum(series, axis=2))]
    framed = [np.pad(row, ((0, 0), (0, 4), (0, 4), (0, 0)), constant_values=1.0) for row in rows]
    djpt.write(IMAGES / "bounces.png", np.concatenate([np.concatenate(row, axis=1) for row in framed]))

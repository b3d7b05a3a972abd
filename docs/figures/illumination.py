"""Lights."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import djpt
from djpt import ScalarTransform4f as T
from djpt.scenes.gallery import sheet
from places import IMAGES

__all__ = ["lights"]


@dataclass(frozen=True)
class LightPanel:
    """The stage under one kind of light."""

    title: str
    subtitle: str
    lights: dict[str, Any]
    integrator: dict[str, Any] = field(default_factory=lambda: {"type": "path", "max_depth": 6})

    def scene(self, size: int) -> dict[str, Any]:
        """The description of the panel's scene."""
        return {**djpt.scenes.stage(self.lights, size), "integrator": self.integrator}


def lights() -> None:
    """The stage under one of each light."""
    near, far = [-2.4, -3.0, 4.0], [-5.0, -6.0, 9.0]

    def towards(origin: list[float]) -> T:
        return T().look_at(origin=origin, target=[0, 0, 0.6], up=[0, 0, 1])

    def bitmap(data: np.ndarray) -> dict[str, Any]:
        return {"type": "bitmap", "data": data.astype(np.float32)}

    dim = {"type": "constant", "radiance": 0.03}
    hues = 0.5 + 0.5 * np.cos(2 * np.pi * (np.arange(6)[:, None] / 6 + [0, 1 / 3, 2 / 3]))
    spiral = np.sqrt(np.arange(40) / 40) * np.exp(2.4j * np.arange(40))
    rainbow = np.tile(hues, (6, 1, 1))
    cross = np.full((9, 9, 3), 1.0)
    cross[4] = cross[:, 4] = 0.15
    window = {"type": "rectangle", "to_world": towards(near).scale(0.8)}
    beam = {"type": "disk", "to_world": towards([-1.6, -2.2, 3.0]).scale(0.45)}
    sky = djpt.scenes.sky(256)
    up = T().rotate([1, 0, 0], 90).rotate([0, 1, 0], 115)
    shown = [
        LightPanel("area", "a rectangle", {"lamp": {**window, "emitter": {"type": "area", "radiance": 25.0}}}),
        LightPanel(
            "area",
            "radiance: a bitmap",
            {"lamp": {**window, "emitter": {"type": "area", "radiance": bitmap(55 * rainbow)}}},
        ),
        LightPanel("point", "no size: hard shadows", {"lamp": {"type": "point", "position": near, "intensity": 65.0}}),
        LightPanel(
            "spot",
            "cutoff_angle 12",
            {"lamp": {"type": "spot", "to_world": towards(near), "intensity": 90.0, "cutoff_angle": 12}, "dim": dim},
        ),
        LightPanel(
            "projector",
            "irradiance: a bitmap",
            {
                "lamp": {
                    "type": "projector",
                    "to_world": towards([0.3, -6, 2.5]),
                    "irradiance": bitmap(cross),
                    "scale": 70,
                    "fov": 28,
                },
                "dim": dim,
            },
        ),
        LightPanel(
            "directional",
            "from far away",
            {
                "lamp": {
                    "type": "directional",
                    "to_world": towards(far),
                    "irradiance": {"type": "rgb", "value": [3.0, 2.6, 2.0]},
                },
                "dim": dim,
            },
        ),
        LightPanel(
            "directionalarea",
            "a beam, by ptracer",
            {"lamp": {**beam, "emitter": {"type": "directionalarea", "radiance": 6.0}}},
            {"type": "ptracer", "max_depth": 6},
        ),
        LightPanel("constant", "the same from all around", {"sky": {"type": "constant", "radiance": 0.9}}),
        LightPanel("envmap", "a clear day", {"sky": {"type": "envmap", "data": sky, "to_world": up, "scale": 0.16}}),
        LightPanel(
            "many points",
            "emitter_choice: tree",
            {
                f"lamp{i}": {
                    "type": "point",
                    "position": [2.2 * spiral.real[i], 1.2 * spiral.imag[i] - 0.6, 2],
                    "intensity": {"type": "rgb", "value": (0.6 * hues[i % 6]).tolist()},
                }
                for i in range(40)
            },
            {"type": "path", "max_depth": 6, "emitter_choice": "tree"},
        ),
    ]
    djpt.write(IMAGES / "lights.png", sheet(shown, size=220, spp=1024, columns=5))

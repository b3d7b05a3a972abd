"""Cameras with lenses that aren't ideal, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import numpy as np

import djpt
from djpt.jit.types import Float
from tests.cameras.test_sensors import LOOK

__all__ = ["LENS", "VIEW", "WIDE", "slopes_and_shifted"]

WIDE: dict[str, dict[str, Any]] = {
    "equidistant": {"type": "fisheye", "to_world": LOOK, "fov": 170},
    "equisolid": {"type": "fisheye", "projection": "equisolid", "fov": 200, "fov_axis": "diagonal", "to_world": LOOK},
    "stereographic": {"type": "fisheye", "projection": "stereographic", "fov": 160, "to_world": LOOK},
    "orthographic fisheye": {
        "type": "fisheye", "projection": "orthographic", "fov": 140, "fov_axis": "diagonal", "to_world": LOOK,
        "principal_point_offset_x": 0.02,
    },
    "fisheye in pixels": {
        "type": "fisheye", "fx": 18, "fy": 17.5, "cx": 19, "cy": 15.5, "k1": 0.03, "k2": -0.008, "k3": 0.001,
        "to_world": LOOK,
    },
    "panorama": {"type": "panorama", "to_world": LOOK, "elevation_from": -70, "elevation_to": 80, "azimuth_to": 120},
    "panorama behind": {"type": "panorama", "azimuth_from": 90, "azimuth_to": 300, "near_clip": 0.3},
    "distorted": {"type": "perspective", "fov": 60, "k1": -0.2, "k2": 0.05, "to_world": LOOK},
    "distorted in pixels": {
        "type": "perspective", "fx": 30, "fy": 28, "cx": 18.7, "cy": 16.1, "k1": 0.1, "k2": -0.05, "k3": 0.01,
        "p1": 0.01, "p2": -0.02, "to_world": LOOK, "near_clip": 0.4,
    },
    "rational": {"type": "perspective", "fov": 60, "k1": 0.3, "k4": 0.2, "k5": 0.05, "k6": 0.01},
    "left eye": {
        "type": "panorama", "eye": "left", "eye_distance": 0.6, "to_world": LOOK, "azimuth_to": 120, "near_clip": 0.3,
        "elevation_from": -80, "elevation_to": 85,
    },
    "right eye": {"type": "panorama", "eye": "right", "eye_distance": 0.3, "elevation_from": -70, "elevation_to": 80},
}  # fmt: skip

LENS = {"type": "thinlens", "aperture_radius": 0.4, "focus_distance": 3.5, "fov": 50, "to_world": LOOK}
VIEW: dict[str, dict[str, Any]] = {
    "blades": {**LENS, "aperture_blades": 5, "aperture_rotation": 20},
    "roundness": {**LENS, "aperture_blades": 6, "aperture_roundness": 0.4},
    "shift": {**LENS, "principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1},
    "tilt": {**LENS, "tilt": 40, "swing": -25},
    "all of it": {
        **LENS, "aperture_blades": 7, "aperture_rotation": -10, "aperture_roundness": 0.7, "tilt": -30, "swing": 50,
        "principal_point_offset_x": 0.1, "near_clip": 0.5,
    },
}  # fmt: skip
"""Lenses with blades, tilt and shift."""


def slopes_and_shifted(
    sensor: Any, key: str, value: float, h: float, answers: Callable[[Any], Sequence[Any]], at: float | None = None
) -> tuple[list[np.ndarray], list[list[np.ndarray]]]:
    """The derivatives of a sensor's `answers` by a parameter, and the answers `h` above and below a value of it.

    The derivatives are those at the value, or `at` another one. The parameter has the value afterwards.
    """
    params = djpt.traverse(sensor)
    attached = Float(value if at is None else at)
    dr.enable_grad(attached)
    params[key] = attached
    params.update()
    outputs = answers(sensor.attached())
    dr.forward(attached)
    slopes = [np.array(dr.grad(x)) for x in outputs]
    shifted = []
    for sign in (1, -1):
        params[key] = value + sign * h
        params.update()
        shifted.append([np.array(x, np.float64) for x in answers(sensor)])
    params[key] = value
    params.update()
    return slopes, shifted
